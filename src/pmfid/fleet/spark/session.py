"""Which Spark does the work: the session that runs already, one that is set up, or one of this machine alone."""

from __future__ import annotations

import os
import shutil
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING
from unittest import mock

from pmfid.errors import UsageError

if TYPE_CHECKING:
    from pyspark.sql import SparkSession

#: Any of these says that somebody has set up a Spark, or runs within one: its settings stay.
SET_UP = ("SPARK_REMOTE", "SPARK_HOME", "SPARK_CONF_DIR", "PYSPARK_GATEWAY_PORT", "PYSPARK_SUBMIT_ARGS")
#: The limit of a container on Linux [bytes].
CONTAINER = Path("/sys/fs/cgroup/memory.max")
LOOPBACK = "127.0.0.1"
NO_PYSPARK = "the engine spark needs PySpark 4.2 or later: pip install 'pmfid[spark]'"
NO_JAVA = (
    "Spark needs a Java runtime, 17 or later, and finds none: apt install openjdk-17-jre-headless, or set JAVA_HOME"
)
#: Of a session on this machine: nobody else can reach it, and it prints errors alone.
QUIET = {
    "spark.driver.bindAddress": LOOPBACK,
    "spark.driver.host": LOOPBACK,
    "spark.ui.enabled": "false",
    "spark.ui.showConsoleProgress": "false",
    "spark.sql.session.timeZone": "UTC",
    # each of the processes of Python has one core of the machine, and would start a thread for all
    "spark.executorEnv.POLARS_MAX_THREADS": "1",
    "spark.executorEnv.OMP_NUM_THREADS": "1",
    "spark.executorEnv.OPENBLAS_NUM_THREADS": "1",
}


def running() -> SparkSession | None:
    """The session that runs already. Raises UsageError where PySpark is missing."""
    return _spark().getActiveSession()


def session_of(master: str | None = None, settings: Mapping[str, str] | None = None) -> SparkSession:
    """The session that runs already, as on Databricks; else one that is set up by the environment or by `master`; else
    one of this machine, with all its processors, that nobody else can reach.

    master: as Spark has it, "local[2]", "spark://host:7077", "yarn", "sc://host" (Spark Connect). settings: of Spark;
    of a session that runs already those that can still be changed. Raises UsageError where PySpark or Java is missing,
    and where a session runs elsewhere than on `master`.
    """
    found, settings = running(), dict(settings or {})
    if found is not None:
        return _take_session(found, master, settings)
    remote = (master or os.environ.get("SPARK_REMOTE", "")).startswith("sc://")
    if not remote and not _java():
        raise UsageError(NO_JAVA)
    if not is_own(master):
        builder = _spark().builder.appName("pmfid").config(map=settings)
        place = builder if master is None else builder.remote(master) if remote else builder.master(master)
        return place.getOrCreate()
    options = f"-Dlog4j2.configurationFile={Path(__file__).with_name('log4j2.properties').as_uri()}"
    builder = _spark().builder.appName("pmfid").master(master or "local[*]")
    with _own_environment():
        made = builder.config(map=QUIET | {"spark.driver.extraJavaOptions": options} | settings).getOrCreate()
    warnings.filterwarnings("ignore", "PySpark does not yet fully support pandas", FutureWarning)
    return made


def is_own(master: str | None) -> bool:
    """Whether a session there is one of this machine alone, which nobody has set up."""
    return master.startswith("local") if master is not None else not any(name in os.environ for name in SET_UP)


def memory() -> int:
    """Of this machine, or of the container that this process runs in [bytes]."""
    found = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    with suppress(OSError, ValueError):  # there is no container, or it has no limit
        found = min(found, int(CONTAINER.read_text()))
    return found


def _take_session(found: SparkSession, master: str | None, settings: Mapping[str, str]) -> SparkSession:
    there = found.conf.get("spark.master", None)
    if master is not None and there is not None and there != master:
        raise UsageError(f"a Spark session runs already, on {there}; leave out the master {master}, or stop it first")
    for name, value in settings.items():
        if found.conf.isModifiable(name):
            found.conf.set(name, value)
    return found


def _spark() -> type[SparkSession]:
    try:
        from pyspark.sql import SparkSession
    except ImportError:
        raise UsageError(NO_PYSPARK) from None
    found: type[SparkSession] = SparkSession
    return found


def _java() -> bool:
    home = os.environ.get("JAVA_HOME")
    return shutil.which("java", path=f"{home}/bin" if home else None) is not None


@contextmanager
def _own_environment() -> Iterator[None]:
    """Spark starts the Python that this one is, and asks no name server who this machine is."""
    own = {"PYSPARK_PYTHON": sys.executable, "SPARK_LOCAL_IP": LOOPBACK}
    with mock.patch.dict(os.environ, {name: value for name, value in own.items() if name not in os.environ}):
        yield
