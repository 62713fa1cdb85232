"""Simulated ages of edges, against instants by a formula."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from pmfid import Drive, EdgeFit, Encoder, MotionFit, NotIdentifiableError, UsageError, sample_edges
from pmfid.config.axis import load_axis
from pmfid.edge_times import Lattice, Trajectory, read_edge_times
from pmfid.estimators.edges import read_edges
from pmfid.fit.likelihood import Gaussian
from pmfid.pipeline.identify import identify, kind_of
from pmfid.records.edge_ages import Coarser
from pmfid.records.record import read_record
from pmfid.simulation import CART, capture_edges, prbs, quantize, simulate_drive
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


def test_a_sample_at_a_whole_tick_is_read_at_this_tick() -> None:
    """The product of sample number and period may be a rounding below it."""
    dt, tick = 0.00667, 1e-6
    times = dt * np.arange(3000)
    path = Trajectory(times, times, np.ones(3000))
    _, ages = read_edge_times(path, Lattice(0.01, 0.000305, np.zeros(1)), tick=tick)
    late = ages - (times + 0.000305) % 0.01
    assert np.nanmin(late) > -1e-10
    assert np.nanmax(late) < 1.0001 * tick


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


TRUTH = np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction])


@pytest.mark.parametrize(("turn", "off"), [(16, 0.0), (16, 0.03), (64, 0.1)])
def test_sixteen_lines_give_a_mass_to_a_millionth(turn: int, off: float) -> None:
    u, counts, ages, encoder = swing(turn, off=off)
    fit = EdgeFit(Drive(CART.input_gain), encoder, 0.01, 20.0, lines=turn, tick=1e-6).fit(u, counts, ages)
    np.testing.assert_allclose(fit.theta, TRUTH, rtol=1e-5)
    assert np.all(np.abs(fit.theta - TRUTH) < 3 * fit.theta_std)
    assert np.all(fit.theta_std < 2e-5 * TRUTH)
    assert fit.status == 0
    assert bool(fit.notes) == (off > 0)


def test_the_worst_line_is_named() -> None:
    u = prbs(2000, clock=10, amplitude=4.0, rng=np.random.default_rng(2))
    step = 0.0931 / 16
    errors = np.where(np.arange(16) == 7, 0.03 * step, 0.0)
    motion = simulate_drive(CART, np.repeat(u, EVERY), DT)
    counts, ages = capture_edges(motion, step, every=EVERY, line_errors=errors)
    fit = EdgeFit(Drive(CART.input_gain), Encoder(step), 0.01, 20.0, lines=16).fit(u, counts, ages)
    assert fit.notes == ("the position error is largest at encoder line 7 of 16: +2.8 % of a step",)


def test_instants_that_all_come_late_move_nothing() -> None:
    u, counts, ages, encoder = swing(16)
    rng = np.random.default_rng(3)
    late = np.maximum(ages - 2e-5 * np.abs(rng.standard_normal(ages.size)), 0.0)
    fit = EdgeFit(Drive(CART.input_gain), encoder, 0.01, 20.0, lines=16).fit(u, counts, late)
    np.testing.assert_allclose(fit.theta, TRUTH, rtol=1e-4)
    assert np.all(np.abs(fit.theta - TRUTH) < 3.5 * fit.theta_std)


@pytest.mark.parametrize("asymmetry", [0.002, 0.2])
def test_a_load_that_the_model_lacks_is_named_and_moves_nothing(asymmetry: float) -> None:
    u, counts, ages, encoder = swing(16, asymmetry=asymmetry)
    method = EdgeFit(Drive(CART.input_gain), encoder, 0.01, 20.0, lines=16, tick=1e-6)
    fitted, _ = method.examine_edges(u, counts, ages)
    assert [one.name for one in fitted.problem.candidates] == ["offset"]
    np.testing.assert_allclose(fitted.theta, TRUTH / (1 + asymmetry / 8), rtol=1e-5)  # modulo the gain of both levels


def test_a_load_that_wanders_is_in_the_intervals() -> None:
    rng = np.random.default_rng(21)
    u = prbs(2000, clock=10, amplitude=4.0, rng=rng)
    walk = np.cumsum(rng.standard_normal(u.size * EVERY)) / np.sqrt(u.size * EVERY)
    motion = simulate_drive(CART, np.repeat(u, EVERY) + 0.3 * CART.coulomb_friction / CART.input_gain * walk, DT)
    counts, ages = capture_edges(motion, 0.0931 / 64, every=EVERY, tick=1e-6)
    method = EdgeFit(Drive(CART.input_gain), Encoder(0.0931 / 64), 0.01, 20.0, lines=64, tick=1e-6)
    fitted, _ = method.examine_edges(u, counts, ages)
    assert isinstance(fitted.likelihood, Gaussian)
    assert fitted.likelihood.wanders
    assert abs(fitted.theta[0] - TRUTH[0]) < 0.002
    assert np.all(np.abs(fitted.theta - TRUTH) < 1.5 * fitted.half)


def test_a_timer_may_go_on_without_an_edge() -> None:
    counts = np.array([3, 3, 4, 4, 4, 3])
    found, plain = (
        read_edges(0.01 * np.arange(6), counts, ages)
        for ages in ([0.05, 0.06, 0.004, 0.014, -1.0, 0.002], [np.nan, np.nan, 0.004, np.nan, np.nan, 0.002])
    )
    assert np.array_equal(found.instants, plain.instants)
    assert found.lines.tolist() == plain.lines.tolist() == [4, 4]


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
    coarser = kind.read([tmp_path / "log.csv"], axis, Coarser(2 * encoder.resolution))
    assert coarser.ages is None
    assert any("are not used, because the position is quantised again" in note for note in coarser.notes)


@pytest.mark.parametrize("seed", [3, 4])
def test_edges_that_are_dense_for_their_scatter_give_way_to_the_counts(seed: int) -> None:
    u, counts, ages, encoder = swing(512)
    rng = np.random.default_rng(seed)
    late = np.maximum(ages - 5e-5 * rng.exponential(size=ages.size), 0.0)
    fit = EdgeFit(Drive(CART.input_gain), encoder, 0.01, 20.0, lines=512).fit(u, counts, late)
    plain = MotionFit(Drive(CART.input_gain), encoder, 0.01, 20.0).fit(u, counts)
    assert np.array_equal(fit.theta, plain.theta)
    assert "the counts alone are more precise" in fit.notes[0]


def test_a_timer_that_saturates_gives_way_to_the_counts() -> None:
    u, counts, ages, encoder = swing(16)
    fit = EdgeFit(Drive(CART.input_gain), encoder, 0.01, 20.0, lines=16).fit(u, counts, np.minimum(ages, 0.005))
    assert np.all(np.abs(fit.theta - TRUTH) < 4 * fit.theta_std)
    assert fit.theta_std[0] < 1e-2 * TRUTH[0]


def test_a_missed_and_a_doubled_edge_cost_nothing() -> None:
    u, counts, ages, encoder = swing(16, off=0.01)
    moved = np.flatnonzero(np.diff(counts) != 0) + 1
    counts = counts.copy()
    for k, times in ((moved[200], -1), (moved[500], 1)):
        counts[k:] += times * np.sign(counts[k] - counts[k - 1])
    fit = EdgeFit(Drive(CART.input_gain), encoder, 0.01, 20.0, lines=16, tick=1e-6).fit(u, counts, ages)
    np.testing.assert_allclose(fit.theta, TRUTH, rtol=1e-5)


def test_a_list_of_edges_gives_the_columns_of_a_capture() -> None:
    u = np.repeat(prbs(300, clock=10, amplitude=4.0, rng=np.random.default_rng(2)), EVERY)
    counts, ages = capture_edges(simulate_drive(CART, u, DT), 0.0058, every=EVERY)
    (moved,) = np.nonzero(np.isfinite(ages))
    assert np.all(np.abs(np.diff(counts)) <= 1)
    found, old = sample_edges(moved * EVERY * DT - ages[moved], counts[moved], EVERY * DT, counts.size)
    assert np.array_equal(found[moved[0] :], counts[moved[0] :])
    np.testing.assert_allclose(old, ages, atol=1e-12)
    later = sample_edges(moved * EVERY * DT - ages[moved], counts[moved], EVERY * DT, 50, start=100 * EVERY * DT)
    np.testing.assert_allclose(later[1][1:], ages[101:150], atol=1e-12)
    several = sample_edges([0.001, 0.002, 0.003], [1, 2, 3], 0.01, 2)
    assert (several[0].tolist(), several[1][1]) == ([1, 3], pytest.approx(0.007))


def test_ages_in_ticks_need_the_period_of_the_timer(tmp_path: Path) -> None:
    u = np.repeat(prbs(300, clock=10, amplitude=4.0, rng=np.random.default_rng(2)), EVERY)
    counts, ages = capture_edges(simulate_drive(CART, u, DT), 0.0058, every=EVERY, tick=1e-6)
    text = """[record]
input = "u"
output = "n"
output_kind = "counts"
dt = 0.01
[encoder]
resolution = 0.0058
edge_age = "age"
%s
[model]
kind = "drive"
input_gain = 2.0
"""
    table = pl.DataFrame({"u": u[::EVERY], "n": counts, "age [ticks]": np.round(1e6 * ages)})
    table.write_csv(tmp_path / "run.csv")
    (tmp_path / "axis.toml").write_text(text % "tick = 1e-6")
    record = read_record(tmp_path / "run.csv", load_axis(tmp_path / "axis.toml"))
    assert record.ages is not None
    np.testing.assert_allclose(record.ages, ages, atol=1e-12)
    (tmp_path / "axis.toml").write_text(text % "")
    with pytest.raises(UsageError, match="give the period of the timer"):
        read_record(tmp_path / "run.csv", load_axis(tmp_path / "axis.toml"))
