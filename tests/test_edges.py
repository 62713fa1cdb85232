"""Simulated ages of edges, against instants by a formula."""

from pathlib import Path
from unittest import mock

import numpy as np
import polars as pl
import pytest

from pmfid import Drive, EdgeFit, Encoder, NotIdentifiableError, sample_edges
from pmfid.config.axis import load_axis
from pmfid.pipeline.identify import identify, kind_of
from pmfid.simulation import CART, capture_edges, prbs, quantize, simulate_drive
from tests.conftest import TRUTH
from tests.refusals import refused

DT, EVERY, RESOLUTION = 1e-3, 10, 1e-4
FORCE = 3.0 * CART.input_gain - CART.coulomb_friction


def find_instant(place: float) -> float:
    """Instant [s] at which the cart, from rest under 3 V, passes a place, by Newton's method."""
    settling, speed = CART.mass / CART.viscous_friction, FORCE / CART.viscous_friction
    t = place / speed + settling
    for _ in range(50):
        gone = np.exp(-t / settling)
        t -= (speed * (t - settling * (1.0 - gone)) - place) / (speed * (1.0 - gone))
    return t


def test_ages_agree_with_the_formula() -> None:
    motion = simulate_drive(CART, np.full(501, 3.0), DT)
    counts, ages = capture_edges(motion, RESOLUTION, every=EVERY)
    assert np.array_equal(counts, quantize(motion.x[::EVERY], RESOLUTION))
    moved = np.flatnonzero(np.diff(counts)) + 1
    assert moved.size > 40
    expected = [k * EVERY * DT - find_instant(counts[k] * RESOLUTION) for k in moved]
    np.testing.assert_allclose(ages[moved], expected, rtol=0.0, atol=1e-9)


def swing(
    turn: int, tick: float = 1e-6, off: float = 0.0, asymmetry: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray, Encoder]:
    """Return input, counts and ages of 20 s of the cart on a wheel with `turn` lines."""
    rng = np.random.default_rng(11)
    u = prbs(2000, clock=10, amplitude=4.0, rng=rng)
    driven = u + asymmetry * (u > 0)
    motion = simulate_drive(CART, np.repeat(driven, EVERY), DT)
    step = 0.0931 / turn
    errors = off * step * rng.uniform(-1.0, 1.0, turn)
    counts, ages = capture_edges(motion, step, 0.3 * step, every=EVERY, tick=tick, line_errors=errors)
    return u, counts, ages, Encoder(step)


@pytest.mark.parametrize(("turn", "off"), [(16, 0.0), (16, 0.03), (64, 0.1)])
def test_sixteen_lines_give_a_mass_to_a_millionth(turn: int, off: float) -> None:
    u, counts, ages, encoder = swing(turn, off=off)
    fit = EdgeFit(Drive(CART.input_gain), encoder, 0.01, 20.0, lines=turn, tick=1e-6).fit(u, counts, ages)
    np.testing.assert_allclose(fit.theta, TRUTH, rtol=1e-5)
    assert np.all(np.abs(fit.theta - TRUTH) < 3 * fit.theta_std)
    assert np.all(fit.theta_std < 2e-5 * TRUTH)
    assert fit.status == 0
    assert bool(fit.notes) == (off > 0)


@pytest.mark.parametrize("asymmetry", [0.002, 0.2])
def test_a_load_that_the_model_lacks_is_named_and_moves_nothing(asymmetry: float) -> None:
    u, counts, ages, encoder = swing(16, asymmetry=asymmetry)
    method = EdgeFit(Drive(CART.input_gain), encoder, 0.01, 20.0, lines=16, tick=1e-6)
    fitted, _ = method.examine_edges(u, counts, ages)
    assert [one.name for one in fitted.problem.candidates] == ["offset"]
    np.testing.assert_allclose(fitted.theta, TRUTH / (1 + asymmetry / 8), rtol=1e-5)  # modulo the gain of both levels


def test_ages_that_cannot_be_are_refused() -> None:
    u, counts, ages, encoder = swing(16)
    method = EdgeFit(Drive(CART.input_gain), encoder, 0.01, 20.0, lines=16)
    refused(
        ("needs the age of the last edge", lambda: method.fit(u, counts)),
        ("ages must have the shape of counts", lambda: method.fit(u, counts, ages[1:])),
        (r"the age in row \d+ is 5 s", lambda: method.fit(u, counts, np.where(np.isfinite(ages), 5.0, np.nan))),
    )
    refused(
        ("the record has 0 edges", lambda: method.fit(u, counts, np.full(counts.size, np.nan))),
        kind=NotIdentifiableError,
    )
    refused(
        ("lists", lambda: sample_edges([], [], 0.01, 3)),
        ("lists", lambda: sample_edges([0.1], [1, 2], 0.01, 3)),
        ("sort the edges", lambda: sample_edges([0.2, 0.1], [1, 2], 0.01, 3)),
        ("edge 1 is not finite", lambda: sample_edges([0.2, np.nan], [1, 2], 0.01, 3)),
    )
    still = simulate_drive(CART, np.zeros(5), DT)
    refused(
        ("every", lambda: capture_edges(still, RESOLUTION, every=0)),
        *(("tick", lambda tick=tick: capture_edges(still, RESOLUTION, tick=tick)) for tick in (-1e-6, np.nan)),
        kind=ValueError,
    )


@pytest.mark.parametrize("asymmetry", [0.0, 0.2])
def test_a_record_with_ages_is_identified_by_them(tmp_path: Path, asymmetry: float) -> None:
    u, counts, ages, encoder = swing(16, off=0.01, asymmetry=asymmetry)
    table = {"t": 0.01 * np.arange(u.size), "u": u, "counts": counts, "age_us": pl.Series(1e6 * ages).fill_nan(None)}
    pl.DataFrame(table).write_csv(tmp_path / "log.csv")
    (tmp_path / "axis.toml").write_text(
        f'[record]\ninput = "u"\noutput = "counts"\noutput_kind = "counts"\ntime = "t"\n[encoder]\nresolution = '
        f'{encoder.resolution!r}\nedge_age = "age_us"\nlines = 16\ntick = 1e-6\n'
        f"[model]\ninput_gain = {CART.input_gain}\n",
        encoding="utf-8",
    )
    axis = load_axis(tmp_path / "axis.toml")
    kind = kind_of(axis)
    result = identify(kind.read([tmp_path / "log.csv"], axis), axis)
    assert result.estimator.method == "edges"
    assert np.all(np.abs(result.theta - TRUTH) < (1e-5 if asymmetry == 0 else 0.1) * TRUTH)
    assert bool(result.status) == (asymmetry > 0)


def test_edges_that_are_all_next_to_a_sample_are_refused() -> None:
    u, counts, ages, encoder = swing(16)
    method = EdgeFit(Drive(CART.input_gain), encoder, 0.01, 20.0, lines=16, tick=1e-6)
    with mock.patch("pmfid.fit.edges.TRUNCATED", np.inf):
        refused(("passes the edges", lambda: method.fit(u, counts, ages)), kind=NotIdentifiableError)
