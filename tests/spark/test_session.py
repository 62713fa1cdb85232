"""Taking or making a Spark session, and the message if no session is possible."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from pmfid.fleet import spark as sessions
from tests.refusals import refused

if TYPE_CHECKING:
    from pyspark.sql import SparkSession


def test_without_pyspark_the_remedy_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyspark", None)
    monkeypatch.setitem(sys.modules, "pyspark.sql", None)
    refused((r"pip install 'pmfid\[spark\]'", sessions.session_of))


def test_without_java_the_remedy_is_said(tmp_path: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sessions, "running", lambda: None)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("JAVA_HOME", raising=False)
    refused(("apt install openjdk-17-jre-headless", sessions.session_of))


def test_what_is_set_up_is_left_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in sessions.SET_UP:
        monkeypatch.delenv(name, raising=False)
    assert sessions.is_own(None)
    assert sessions.is_own("local[2]")
    assert not sessions.is_own("spark://host:7077")
    monkeypatch.setenv("SPARK_CONF_DIR", "/etc/spark")
    assert not sessions.is_own(None)


def test_a_session_that_runs_is_taken(spark: SparkSession) -> None:
    assert sessions.session_of() is spark
    assert sessions.session_of("local[2]") is spark
    refused((r"is already running on local\[2\]", lambda: sessions.session_of("spark://host:7077")))


def test_settings_that_can_change_are_set(spark: SparkSession) -> None:
    before = spark.conf.get("spark.sql.shuffle.partitions")
    sessions.session_of(None, {"spark.sql.shuffle.partitions": "3", "spark.driver.memory": "3g"})
    assert spark.conf.get("spark.sql.shuffle.partitions") == "3"
    assert spark.conf.get("spark.driver.memory") == "1g"
    spark.conf.set("spark.sql.shuffle.partitions", str(before))


def test_nobody_else_can_reach_it(spark: SparkSession) -> None:
    """The driver listens only on the loopback, without a web page."""
    assert spark.sparkContext.uiWebUrl is None
    children = set(subprocess.run(["pgrep", "-P", str(os.getpid())], capture_output=True, text=True).stdout.split())
    listening = [line for child in children for line in _listening(child)]
    assert len(listening) >= 2
    assert all(address.endswith("0100007F") for address in listening), listening


def _listening(process: str) -> list[str]:
    """Return the local addresses, in the kernel's notation, of the listening sockets of a process."""
    folder, found = f"/proc/{process}/fd", []
    own = {os.readlink(f"{folder}/{name}") for name in os.listdir(folder)}
    for table in ("tcp", "tcp6"):
        with open(f"/proc/net/{table}", encoding="ascii") as lines:
            rows = [line.split() for line in lines][1:]
        found += [row[1].partition(":")[0] for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in own]
    return found
