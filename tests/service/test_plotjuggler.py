"""Datagrams for PlotJuggler: JSON, bounded, and nobody needs to listen."""

from __future__ import annotations

import json
import math
import socket
from dataclasses import replace
from pathlib import Path

import numpy as np

from pmfid.service.sinks.plotjuggler import PlotJugglerSection
from tests.service.feed import Host, block, kindred, notice


def test_each_row_is_a_datagram_that_plotjuggler_reads(tmp_path: Path) -> None:
    host = Host(tmp_path)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(20)
        outlet = PlotJugglerSection(port=listener.getsockname()[1]).outlet("plots", host)
        outlet.start()
        rows = block(kindred(2), 5)
        outlet.rows(replace(rows, std=np.array([[0.5, np.inf], [0.5, 0.25]]), time=np.array([2.5, math.nan])))
        outlet.notice(notice(1, "gap"))
        got = [json.loads(listener.recv(65536)) for _ in range(2)]
        assert outlet.close(20)
    assert got[0] == {
        "timestamp": 2.5,
        "x0": {
            "u": 2.5,
            "counts": 35,
            "innovation": 0.125,
            "mass": 5.0,
            "mass_std": 0.5,
            "friction": 5.25,
            "status": 2,
            "state": "watching",
        },
    }
    assert got[1].keys() == {"x1"}, "without a time that is one, the time of its arrival counts"


def test_a_row_too_large_for_a_datagram_is_dropped_and_counted(tmp_path: Path) -> None:
    host = Host(tmp_path)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        outlet = PlotJugglerSection(port=listener.getsockname()[1], largest=200).outlet("plots", host)
        outlet.start()
        outlet.rows(block(kindred(3, names=tuple(f"parameter_{k}" for k in range(10)))))
        assert outlet.close(20)
    assert host.count("pmfid_refused_total", sink="plots") == 3


def test_nobody_listens_and_nothing_is_an_error(tmp_path: Path) -> None:
    host = Host(tmp_path)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    outlet = PlotJugglerSection(port=port).outlet("plots", host)
    outlet.start()
    outlet.rows(block(kindred(3), 1, samples=20))
    assert outlet.close(20)
    assert host.told == []
    assert host.count("pmfid_sink_rows_total", sink="plots") == 60
