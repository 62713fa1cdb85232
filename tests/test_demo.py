"""The demo: its table tells the story of the paper, its files and pictures are there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pmfid
from examples.demo import INCREMENTS, METHODS, RECORD, error_table, estimate_mass, main, rms_error, simulate_run
from pmfid.simulation import CART, CART_LOADED


@pytest.fixture(scope="module")
def errors() -> dict[tuple[str, int], float]:
    runs = {n: simulate_run(n) for n in (4096, 256, 64)}
    return {(method, n): rms_error(estimate_mass(method, run)["mass"]) for n, run in runs.items() for method in METHODS}


def test_rls_goes_off_and_bcrls_does_not(errors: dict[tuple[str, int], float]) -> None:
    assert errors["RLS", 4096] < 1
    assert errors["RLS", 256] > 25
    assert errors["BCRLS", 256] < 1


def test_riv_and_edge_times_go_beyond(errors: dict[tuple[str, int], float]) -> None:
    assert errors["riv", 64] < errors["BCRLS", 64] / 1.5
    assert errors["edge times", 64] < 0.05


def test_the_error_is_that_of_both_loads() -> None:
    mass = np.r_[np.full(1500, 1.1 * CART.mass), np.full(1500, CART_LOADED.mass)]
    assert rms_error(mass) == pytest.approx(10 / np.sqrt(2))


def test_the_command_prints_one_table_and_writes_its_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["--out", str(tmp_path), "--images", str(tmp_path / "images")])
    text = capsys.readouterr().out
    assert max(map(len, text.partition("\npicture:")[0].splitlines())) <= 80
    assert [line.split()[0] for line in text.splitlines()[2 : 2 + len(INCREMENTS)]] == [str(n) for n in INCREMENTS]
    assert (tmp_path / "images" / "first.png").stat().st_size > 10_000
    assert (tmp_path / "images" / "demo.png").read_bytes() == (tmp_path / "demo.png").read_bytes()
    t, u, counts = np.loadtxt(tmp_path / "cart.csv", delimiter=",", skiprows=1, unpack=True)
    estimator = pmfid.BCRLS(
        pmfid.Drive(2.0), pmfid.Encoder(22.75e-6 * 4096 / RECORD), t[1] - t[0], 50.0, forgetting=0.99
    )
    assert estimator.run(u, counts.astype(int))["mass"][-1] == pytest.approx(1.44, rel=0.02)


def test_small_errors_are_not_printed_as_zero() -> None:
    table = error_table({(method, n): 0.001 for method in METHODS for n in INCREMENTS})
    assert list(table.columns[1].cells) == ["< 0.01"] * len(INCREMENTS)
