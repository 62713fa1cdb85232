"""One Spark session with two cores for all tests of this folder; they skip if PySpark or Java is missing."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from typing import TYPE_CHECKING
from unittest.mock import patch

import pytest

if TYPE_CHECKING:
    from pyspark.sql import SparkSession

HERE = os.path.dirname(__file__)
#: Only this machine can reach the session. Its Python processes have one thread each.
SETTINGS = {
    "spark.driver.bindAddress": "127.0.0.1",
    "spark.driver.host": "127.0.0.1",
    "spark.driver.memory": "1g",
    "spark.executorEnv.POLARS_MAX_THREADS": "1",
    "spark.sql.session.timeZone": "UTC",
    "spark.sql.shuffle.partitions": "4",
    "spark.ui.enabled": "false",
}
MISSING = (
    "PySpark is not installed: make spark"
    if find_spec("pyspark") is None
    else "there is no Java runtime: make spark INSTALL_TOOLS=1"
    if shutil.which("java") is None and "JAVA_HOME" not in os.environ
    else ""
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Ignore PySpark's warnings: it leaves sockets and processes to the collector, and warns of an unused pandas 3."""
    for item in items:
        if str(item.path).startswith(HERE):
            item.add_marker(pytest.mark.filterwarnings("ignore::ResourceWarning"))
            item.add_marker(pytest.mark.filterwarnings("ignore:PySpark does not yet fully support pandas"))
            item.add_marker(pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"))


@pytest.fixture(scope="session")
def spark() -> Iterator[SparkSession]:
    """Return a session local[2] within this process."""
    if MISSING:
        pytest.skip(MISSING)
    from pyspark.sql import SparkSession

    builder = SparkSession.builder.master("local[2]")
    with patch.dict(os.environ, PYSPARK_PYTHON=sys.executable, SPARK_LOCAL_IP="127.0.0.1"):
        session = builder.config(map=SETTINGS).getOrCreate()
    yield session
    session.stop()
