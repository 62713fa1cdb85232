"""A user's own equation, in Python and TOML, and the load on a spring."""

import re

import numpy as np
import pytest

import pmfid
from pmfid import Equation, EquationModel, Term
from pmfid.config.axis import load_axis
from pmfid.errors import UsageError
from pmfid.estimators.registry import ESTIMATORS, methods_for
from pmfid.pipeline.identify import identify
from pmfid.records.record import Record
from pmfid.simulation import (
    CART,
    CART_DT,
    Machine,
    control_machine,
    drive_machine,
    prbs,
    resolution_of,
    stop_and_go,
)
from studies.paper.truth import CartRecord
from tests.conftest import TRUTH, cart_run

pytestmark = pytest.mark.usefixtures("without_judgement")

CUTOFF, STIFFNESS = 20.0, 40.0
OWN = Equation(
    unknown=(
        Term("output", 2, "inertia", "kg m2"),
        Term("output", 1, "drag", "N m s"),
        Term("direction", 0, "dry_friction", "N m"),
    ),
    known=(Term("input", coefficient=CART.input_gain),),
)
INPUT = Term("input", coefficient=CART.input_gain)


def wrong_record(plant: Machine, scenario: str, seed: int, increments: int, samples: int = 3000) -> CartRecord:
    """Return the scenario "prbs" or "stop-and-go" of a plant."""
    rng = np.random.default_rng(seed)
    resolution = resolution_of(increments)
    phase = resolution * rng.random()
    if scenario == "prbs":
        u = prbs(samples, clock=10, amplitude=3.0, rng=rng)
        run = drive_machine(plant, u, CART_DT, resolution, phase=phase)
    else:
        reference = stop_and_go(samples, CART_DT, stroke=0.2, move_time=0.8, dwell_time=0.5)
        run = control_machine(plant, reference, CART_DT, resolution, kp=200.0, kd=5.0, u_max=6.0, phase=phase)
    return CartRecord(run.u, run.counts, resolution)


def estimates(cls, model, run):
    estimator = cls(model, run.encoder, CART_DT, CUTOFF)
    if isinstance(estimator, pmfid.estimators.recursive.RecursiveEstimator):
        return estimator.run(run.u, run.counts).theta[-1]
    return estimator.fit(run.u, run.counts).theta


@pytest.mark.parametrize("method", sorted(methods_for(pmfid.Drive(1.0))))
def test_the_same_terms_give_the_numbers_of_the_drive(method):
    run = cart_run(2, increments=1024, samples=1500)
    cls = ESTIMATORS[method]
    own, drive = (estimates(cls, model, run) for model in (EquationModel(OWN), pmfid.Drive(CART.input_gain)))
    np.testing.assert_allclose(own, drive, rtol=2e-5 if method == "fit" else 0)  # a fifth of the standard error


@pytest.mark.parametrize("method", ["iv", "riv", "fit"])
def test_what_cannot_be_simulated_is_refused_with_the_remedy(method):
    equation = Equation(OWN.unknown[1:], (INPUT, Term("output", 2, coefficient=-CART.mass)))
    with pytest.raises(UsageError, match=rf"{method} needs a simulated motion.*use ls, bcls, rls or bcrls"):
        ESTIMATORS[method](EquationModel(equation), pmfid.Encoder(1e-5), CART_DT, CUTOFF)


@pytest.mark.parametrize(
    ("method", "motion"),
    [
        ("iv", "prbs"),
        ("iv", "stop-and-go"),
        ("fit", "stop-and-go"),
        pytest.param("fit", "prbs", marks=pytest.mark.long),
    ],
)
def test_a_load_on_a_spring(method, motion):
    """Ten steps of Runge and Kutta per sample simulate the plant, without the kernel."""
    record = wrong_record(Machine(CART, stiffness=STIFFNESS), motion, 3, 4096)
    drive = pmfid.Drive(CART.input_gain, spring=True)
    fit = ESTIMATORS[method](drive, pmfid.Encoder(record.resolution), CART_DT, CUTOFF).fit(record.u, record.counts)
    assert fit.names == ("mass", "viscous_friction", "coulomb_friction", "offset", "stiffness")
    np.testing.assert_allclose(fit.theta[[0, 1, 2, 4]], [*TRUTH, STIFFNESS], rtol=0.005)
    assert abs(fit["offset"]) < 0.01


TOML = """
[record]
input = "u"
output = "counts"
output_kind = "counts"
dt = 0.01
[encoder]
resolution = 1e-5
[model]
kind = "equation"
unknown = [
  { signal = "output", derivative = 2, name = "inertia", unit = "kg m2" },
  { signal = "output", derivative = 1, name = "drag", unit = "N m s" },
  { signal = "direction", name = "dry_friction", unit = "N m" },
]
known = [{ signal = "input", coefficient = 2.0 }]
[estimator]
cutoff = 20.0
"""


def axis_of(tmp_path, text):
    path = tmp_path / "axis.toml"
    path.write_text(text)
    return load_axis(path)


@pytest.mark.parametrize("known", ["", ', { signal = "output", derivative = 2, coefficient = -1.07 }'])
def test_from_toml_to_a_result(tmp_path, known):
    text = TOML.replace("coefficient = 2.0 }", "coefficient = 2.0 }" + known)
    if known:
        text = re.sub(r".*inertia.*\n", "", text)
    run = cart_run(2, increments=4096)
    record = Record(run.u, run.counts, CART_DT, run.encoder.resolution, (), "run")
    result = identify(record, axis_of(tmp_path, text))
    truth = dict(zip(("inertia", "drag", "dry_friction"), TRUTH, strict=True))
    parameters = result.to_dict()["parameters"]
    assert result.to_dict()["model"] == "equation"
    for name, entry in parameters.items():
        assert entry["value"] == pytest.approx(truth[name], rel=0.01)
    assert ("inertia" in parameters) == (not known)


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ('signal = "direction"', 'signal = "sign"', ("unknown, term 3: signal = 'sign'", "'direction'", "write terms")),
        ('name = "drag", ', "", ("unknown, term 2: name is missing", "write terms")),
        ("derivative = 1", "derivative = 5", ("must be 0 to 2, got 5",)),
        ('kind = "equation"', 'kind = "drive"\ninput_gain = 2.0', ("belong to kind", "drop the lists")),
        ('kind = "equation"', 'kind = "equation"\ninput_gain = 2.0', ("input_gain belongs to kind", 'list "unknown"')),
        ('unit = "N m" }', 'unit = "N m", gain = 2 }', ("unknown, term 3: gain = 2", "write terms")),
        ("coefficient = 2.0", "coefficient = 0.0", ("coefficient of a term must be finite and not 0",)),
    ],
)
def test_a_wrong_term_in_toml_is_named_with_the_remedy(tmp_path, old, new, parts):
    assert old in TOML
    with pytest.raises(UsageError) as caught:
        axis_of(tmp_path, TOML.replace(old, new))
    for part in parts:
        assert part in str(caught.value)
    assert "\n" not in str(caught.value)
