"""The search for the terms of a drive: the terms that it names or leaves out, and its messages in doubt."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pytest

import pmfid
from pmfid.diagnostics.term_fits import Bench
from pmfid.diagnostics.term_trials import Trial, carry_parameters
from pmfid.diagnostics.terms import Candidate, FittedCandidate, Terms, is_unclear, propose_candidates, search
from pmfid.estimators.adequacy import PeriodicForce, gain_elsewhere, setting, weigh
from pmfid.estimators.motion import rms
from pmfid.estimators.output_error import IntervalML
from pmfid.models.equation import Equation
from pmfid.pipeline.terms import TermSearch
from pmfid.report.terms import friction_figure, write_terms
from pmfid.simulation import DriveParameters, Machine, drive_machine, prbs, stop_and_go
from pmfid.simulation.drive import control_machine

DT, CUTOFF, SAMPLES = 0.002, 80.0, 3000
DRIVE = DriveParameters(3e-3, 8e-3, 0.04, 0.5)
STEP = 2 * np.pi / 1024
GAIN = DRIVE.input_gain


@dataclass(frozen=True)
class Made:
    """A record, and the machine that made it."""

    machine: Machine
    u: np.ndarray
    counts: np.ndarray


def made(motion: str = "prbs", seed: int = 11, samples: int = SAMPLES, **lacking: float) -> Made:
    """Return a record of a rotary axis from no study, under a binary input or a position control."""
    machine, rng = Machine(DRIVE, **lacking), np.random.default_rng(seed)
    phase = STEP * rng.random()
    if motion == "prbs":
        run = drive_machine(machine, prbs(samples, clock=25, amplitude=0.7, rng=rng), DT, STEP, phase=phase)
    else:
        reference = stop_and_go(samples, DT, 4.1, 0.5, 0.3)
        run = control_machine(machine, reference, DT, STEP, kp=1.0, kd=0.04, u_max=3.0, phase=phase)
    return Made(machine, run.u, run.counts)


def searched(record: Made, **settings: object) -> TermSearch:
    known = {"model": pmfid.Drive(GAIN), "dt": DT, "cutoff": CUTOFF, "encoder": pmfid.Encoder(STEP), "scan": False}
    return pmfid.search_terms(record.u, record.counts, **(known | settings))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def directional() -> TermSearch:
    return searched(made(samples=2000, asymmetry=0.15))


def test_a_search_shows_itself(directional: TermSearch) -> None:
    lines = repr(directional).splitlines()
    assert lines[0] == f"record, 2000 samples. {directional.sentence}"
    assert len(lines) < 12
    assert [line.split(":")[0].strip() for line in lines[1 : 1 + len(directional.models)]] == [
        model.label for model in directional.models
    ]
    assert directional._repr_html_().count("<tr>") == 1 + len(directional.models)
    assert json.loads(json.dumps(directional.to_dict(), allow_nan=False)) == directional.to_dict()
    frame = directional.to_frame()
    assert frame.columns == ["model", "parameter", "value", "std"]
    assert frame.height == sum(model.trial.theta.size for model in directional.models)
    assert directional.plot().axes[0].get_ylabel() == "friction [N]"


@pytest.fixture(scope="module")
def plain() -> TermSearch:
    return searched(made())


# --- named terms ------------------------------------------------------------------------------------------------------


def test_nothing_is_named_where_nothing_is_missing(plain: TermSearch) -> None:
    assert plain.added == {}
    assert len(plain.models) == 1
    assert "unmodelled" not in plain.status
    assert plain.lines == ("[model]", 'kind = "drive"', "input_gain = 0.5")
    assert "The search adds no term" in plain.sentence


def test_directional_friction_is_named_with_its_size(directional: TermSearch) -> None:
    assert directional.added == {"friction": "directional"}
    found = dict(zip(directional.model.equation.names, directional.chosen.trial.theta, strict=True))
    assert found["coulomb_friction_forward"] == pytest.approx(1.15 * DRIVE.coulomb_friction, rel=0.02)
    assert found["viscous_friction_backward"] == pytest.approx(0.85 * DRIVE.viscous_friction, rel=0.02)
    assert 'friction = "directional"' in directional.lines


@pytest.mark.parametrize(
    ("motion", "lacking", "wanted"),
    [
        ("prbs", {"quadratic": 3e-4}, {"quadratic": True}),
        ("prbs", {"dead_time": 1e-3}, {"dead_time": "estimate"}),
        pytest.param(
            "stop-and-go", {"stribeck": 0.02, "stribeck_speed": 0.6}, {"stribeck": "estimate"}, marks=pytest.mark.long
        ),
        pytest.param("stop-and-go", {"dead_time": 1e-3}, {"dead_time": "estimate"}, marks=pytest.mark.long),
        pytest.param("stop-and-go", {"stiffness": 0.01}, {"spring": True}, marks=pytest.mark.long),
    ],
)
def test_one_term_is_named(motion: str, lacking: dict[str, float], wanted: dict[str, object]) -> None:
    found = searched(made(motion, **lacking))
    assert found.added == wanted
    first, last = found.models[0], found.chosen
    assert last.trial.log_likelihood > first.trial.log_likelihood
    assert last.error <= 1.02 * first.error
    assert last.trial.theta[0] == pytest.approx(DRIVE.mass, rel=0.01)


@pytest.mark.long
def test_a_dead_time_and_stribeck_friction_are_distinguished() -> None:
    """At a reversal, each of two effects imitates the other effect."""
    found = searched(made(samples=2000, stribeck=0.02, stribeck_speed=0.6, dead_time=1e-3))
    assert set(found.added) == {"stribeck", "dead_time"}
    late = dict(zip(found.model.equation.names, found.chosen.trial.theta, strict=False))["dead_time"]
    assert late == pytest.approx(1e-3, rel=0.1)


def test_gravity_is_looked_for_where_a_turn_is_given() -> None:
    record = made(gravity=0.02, gravity_angle=0.4)
    assert searched(record, turn=2 * np.pi).added == {"gravity": 2 * np.pi}
    assert "gravity" not in searched(record).added


@pytest.mark.long
def test_the_pitch_of_a_cogging_force_is_found() -> None:
    record = made(cogging=0.012, cogging_pitch=1.3, cogging_phase=1.0)
    found = searched(record, scan=True)
    assert found.added["cogging"] == pytest.approx(1.3, rel=0.01)
    assert set(found.added) == {"cogging"}


# --- messages ---------------------------------------------------------------------------------------------------------


def test_the_share_of_the_friction_falls(directional: TermSearch) -> None:
    first, last = (model.unexplained[0] for model in directional.models)
    assert 0.05 < first < 0.3
    assert last < 0.2 * first
    assert f"adding directional friction leaves {100 * last:.2g} %" in directional.sentence


def test_what_would_not_be_seen_is_reported_with_its_size(directional: TermSearch) -> None:
    """The chosen model includes the direction, and all other effects are reported."""
    said = [one.says for one in directional.hidden]
    assert any("Stribeck" in one for one in said)
    assert not any("direction" in one for one in said)
    assert all(one.size > 0 for one in directional.hidden)


@pytest.mark.long
def test_a_coarser_encoder_sees_less() -> None:
    record = made()
    coarse = searched(replace(record, counts=record.counts // 16), encoder=pmfid.Encoder(16 * STEP))
    fine = {one.says: one.size for one in searched(record).hidden}
    assert coarse.added == {}
    assert all(one.size > fine[one.says] for one in coarse.hidden)


def test_every_change_is_a_line_that_the_cure_names(plain: TermSearch) -> None:
    names = {field.name for field in fields(pmfid.Drive)}
    best = plain.chosen.trial.best
    forces = weigh(
        best, [PeriodicForce("cogging", 0.5), PeriodicForce("gravity", 6.0), PeriodicForce("friction_period", 2.0)]
    ).forces
    changes = [(candidate, change) for candidate in forces for change in candidate.changes]
    keys = {next(iter(change)) for _, change in changes}
    # `judge` distinguishes a lag from a dead time, if the model has one of them
    assert keys == names - {"input_gain", "lag", "axis"}, "a field of a drive that no force asks for is never searched"
    for candidate, change in changes:
        key, value = next(iter(change.items()))
        assert setting(key, value) in candidate.cure


# --- the parts --------------------------------------------------------------------------------------------------------


def moved(change: dict[str, object], theta: list[float], **before: object) -> dict[str, float]:
    old, new = pmfid.Drive(GAIN, **before).equation, pmfid.Drive(GAIN, **(before | change)).equation  # type: ignore[arg-type]
    return dict(zip(names_of(new), carry_parameters(old, np.array(theta), new).tolist(), strict=True))


def names_of(equation: Equation) -> list[str]:
    return [*equation.names, *(name for name, _ in equation.further)]


def test_a_model_goes_on_from_the_parameters_of_another() -> None:
    found = moved({"friction": "directional", "offset": False}, [2.0, 3.0, 1.0, 0.2], offset=True)
    assert found["viscous_friction_backward"] == 3.0
    assert found["coulomb_friction_forward"] == pytest.approx(1.2)
    assert found["coulomb_friction_backward"] == pytest.approx(0.8)
    back = moved({"friction": "symmetric", "offset": True}, [2.0, 3.0, 5.0, 1.2, 0.8], friction="directional")
    assert back == pytest.approx({"mass": 2, "viscous_friction": 4, "coulomb_friction": 1, "offset": 0.2})
    shaped = moved({"quadratic": True}, [2.0, 3.0, 1.0, 0.5, 0.1], stribeck="estimate")
    assert (shaped["stribeck_friction"], shaped["stribeck_speed"], shaped["quadratic_friction"]) == (0.5, 0.1, 0.0)


def test_a_friction_that_drives_is_not_proposed() -> None:
    """Unmodelled quadratic friction looks like negative Stribeck friction, which no machine has."""
    record = made(quadratic=3e-4)
    method = IntervalML(pmfid.Drive(GAIN), pmfid.Encoder(STEP), DT, CUTOFF)
    trial = Bench(method, record.u, record.counts).first(method.model)  # type: ignore[arg-type]
    found = trial.weigh_forces()
    below = [k for k in found.missed if found.forces[k].positive and found.size[k] < 0]
    assert all(found.size[k] > 0 for k in found.missed if found.forces[k].name == "curved")
    keys = {candidate.key for candidate in propose_candidates(trial, found)}
    assert "quadratic" in keys
    negative = {found.forces[k].name for k in below} - {found.forces[k].name for k in found.missed if found.size[k] > 0}
    assert not keys & negative


@pytest.mark.long
def test_a_term_that_another_has_made_superfluous_is_dropped() -> None:
    """A spring at a shifted zero looks like a load at first."""
    record = made("stop-and-go", stiffness=0.01)
    method = IntervalML(pmfid.Drive(GAIN), pmfid.Encoder(STEP), DT, CUTOFF)
    found: Terms = search(Bench(method, record.u, record.counts), pmfid.Drive(GAIN), scan=False)
    assert found.added == {"spring": True}
    assert rms(found.chosen.difference(found.chosen.best.q)) < 0.5


@pytest.mark.long
def test_another_record_may_be_what_is_to_be_predicted() -> None:
    record, second = made(asymmetry=0.15), made(seed=12, asymmetry=0.15)
    found = searched(record, other=(second.u, second.counts))
    assert found.added == {"friction": "directional"}
    assert found.models[1].error < 0.1 * found.models[0].error


# --- unclear cases ----------------------------------------------------------------------------------------------------


def test_a_short_record_is_refused_with_the_length_it_needs() -> None:
    record = made(samples=600)
    with pytest.raises(pmfid.NotIdentifiableError, match=r"too few.*record at least (\d+) \(") as error:
        searched(record)
    needed = int(str(error.value).partition("at least ")[2].partition(" ")[0])
    assert searched(made(samples=needed)).samples == needed


def test_an_axis_that_rests_is_refused() -> None:
    record = made()
    with pytest.raises(pmfid.NotIdentifiableError, match="does not move"):
        searched(replace(record, counts=np.zeros_like(record.counts)))


def test_no_drive_is_refused() -> None:
    equation = pmfid.EquationModel(pmfid.Drive(GAIN).equation)
    with pytest.raises(pmfid.UsageError, match='set kind = "drive"'):
        searched(made(), model=equation)


@pytest.mark.parametrize("periods", [{"turn": 0.0}, {"pitch": -1.0}, {"friction_period": np.nan}])
def test_a_period_that_is_none_is_refused(periods: dict[str, float]) -> None:
    with pytest.raises(pmfid.UsageError, match="must be a length above 0"):
        searched(made(samples=1800), **periods)


def test_noise_of_the_position_names_nothing() -> None:
    record = made()
    noisy = record.counts + np.random.default_rng(3).integers(-3, 4, record.counts.size)
    found = searched(replace(record, counts=noisy))
    assert found.added == {}


def test_the_figure_has_a_curve_for_each_model(directional: TermSearch) -> None:
    (axes,) = friction_figure(directional).axes
    labels = axes.get_legend_handles_labels()[1]
    assert sorted(labels) == sorted(["the record", *(model.label for model in directional.models)])


def test_a_search_without_terms_is_written_as_well(plain: TermSearch, tmp_path: Path) -> None:
    write_terms(tmp_path, plain)
    assert json.loads((tmp_path / "terms.json").read_text())["added"] == {}


# --- the rules --------------------------------------------------------------------------------------------------------


def test_a_force_that_acts_in_one_part_alone_is_seen_nowhere_else() -> None:
    """The search once promised an infinite gain."""
    scores, informations = np.zeros((600, 2)), np.zeros((600, 2))
    scores[:100, 0], informations[:100, 0] = 3.0, 1.0
    scores[:, 1], informations[:, 1] = 0.5, 1.0
    alone, everywhere = gain_elsewhere(scores, informations)
    assert alone == 0.0
    assert everywhere == pytest.approx(600 * 0.25)


def test_a_pitch_that_is_hardly_better_than_another_is_not_believed(plain: TermSearch) -> None:
    whole = plain.chosen.trial
    partly = replace(whole, best=replace(whole.best, noise=0.3))

    def step(pitch: float, gain: float, trial: Trial = partly) -> FittedCandidate:
        candidate = Candidate({"cogging": pitch}, "", 8.0, 2.0, 100.0, 50.0)
        return FittedCandidate(candidate, trial, gain, 20.0, np.inf, "")

    best, near, far = step(0.5, 100.0), step(0.6, 80.0), step(0.6, 20.0)
    assert is_unclear(best, [best, near])
    assert not is_unclear(best, [best, far])
    assert not is_unclear(best, [best])
    # a model that explains every count needs no distance to worse models
    assert not is_unclear(step(0.5, 100.0, whole), [step(0.5, 100.0, whole), near])
