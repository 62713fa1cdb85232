"""Each fault of a log is found alone, described by the same sentence everywhere, and mended by its remedy."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from click.testing import CliRunner

import pmfid
from pmfid.cli.main import main
from pmfid.config.axis import Axis
from pmfid.diagnostics.matter import OF_LOG
from pmfid.errors import NotIdentifiableError, PmfidError
from pmfid.findings import Finding, codes
from pmfid.pipeline.checks import check_record
from pmfid.pipeline.checks.view import long_stops, sudden
from pmfid.pipeline.identify import check, identify
from pmfid.pipeline.result import Result
from pmfid.records.record import Record, record_of
from pmfid.report.result import write_result
from pmfid.simulation import DriveParameters, Machine, control_machine, make_scenario
from studies.check_logs import FAULTS, Logged, clean, faulty
from studies.friction_axes import BENCHES
from tests.command import run_command
from tests.conftest import long_unless

#: Small machines, whose logs are fast to make and to read.
AXES = {name: BENCHES[name] for name in ("cart", "slide")}
SEED = 2
#: A fault whose file cannot be read, one that the judge of an estimate finds, and one that is a note before the fit.
UNREADABLE, JUDGED, NOTED = "counts as position", "dead time", "saturated input"
SEEN = [fault for fault in FAULTS if fault not in (UNREADABLE, JUDGED, NOTED)]
#: One fault of each severity, of the log and of the model.
SAID = ("reversed sign", "clipped counter", "sample rate too high")


@cache
def log_of(fault: str) -> Logged:
    return faulty(fault, SEED, AXES)


@cache
def found_in(fault: str) -> tuple[Finding, ...]:
    log = log_of(fault)
    if fault == JUDGED:
        return check(log.record(), log.configuration)
    return check_record(log.record(), log.configuration)


def plainly(record: Record, axis: Axis) -> Result | NotIdentifiableError:
    """Return the least-squares result or its error; the judge's only finding is an incomplete model."""
    doubt = Finding("unmodelled", "the model lacks something")
    ways = {"fit_again": mock.Mock(return_value=None), "_check_sizes": mock.Mock(return_value=[doubt])}
    options = axis.estimator.model_copy(update={"method": "ls", "cutoff": axis.estimator.cutoff or 1 / (5 * record.dt)})
    try:
        with mock.patch.multiple("pmfid.diagnostics.verdict", **ways):
            return identify(record, axis.model_copy(update={"estimator": options}))
    except NotIdentifiableError as error:
        return error


# --- found ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fault", SEEN)
def test_the_fault_is_named_with_its_remedy(fault: str) -> None:
    found = found_in(fault)
    assert FAULTS[fault][1] & {finding.code for finding in found}
    assert all(finding.remedy for finding in found)


@pytest.mark.parametrize("seed", long_unless((0, 1).__contains__, range(6)))
def test_a_clean_log_has_no_fault(seed: int) -> None:
    log = clean(seed, AXES)
    assert check_record(log.record(), log.configuration) == ()


def test_a_rest_between_motions_is_no_clipped_counter() -> None:
    """At a coarse encoder, the longest span leaves few rows between the rests."""
    counts = make_scenario("stop-and-go", seed=3, increments=512, duration=30.0).counts
    assert sudden(counts, long_stops(counts)) == set()


# --- one sentence -----------------------------------------------------------------------------------------------------


def written(log: Logged, folder: Path) -> tuple[Path, Path]:
    """Write the log as a file with its AXIS.toml."""
    names = list(log.columns)
    rows = np.column_stack([log.columns[name] for name in names])
    np.savetxt(folder / "log.csv", rows, "%.17g", delimiter=",", header=",".join(names), comments="")
    lines = []
    for section, part in log.configuration:
        given = {key: getattr(part, key) for key in part.model_fields_set}
        lines += [f"[{section}]", *(f"{key} = {json.dumps(value)}" for key, value in given.items())] if given else []
    (folder / "axis.toml").write_text("\n".join(lines), encoding="utf-8")
    return folder / "log.csv", folder / "axis.toml"


@pytest.mark.parametrize("fault", long_unless(SAID.__contains__, SEEN))
def test_the_same_sentence_everywhere(fault: str, tmp_path: Path) -> None:
    log, sentences = log_of(fault), [finding.text for finding in found_in(fault)]
    record, axis = written(log, tmp_path)
    command = ["check", str(record), "--config", str(axis)]
    terminal, as_json = (CliRunner().invoke(main, [*command, *more]) for more in ([], ["--json"]))
    wrong = any(finding.severity == "wrong" for finding in found_in(fault))
    assert terminal.exit_code == as_json.exit_code == (3 if wrong else 1)
    said = pmfid.check(log.columns, axis=log.configuration)
    doubts = [line for one in said if one.severity != "note" for line in one.lines]  # the terminal folds some notes
    assert terminal.stdout.splitlines()[1 : 1 + len(doubts)] == doubts
    assert json.loads(as_json.stdout)["findings"] == [finding.to_json() for finding in said]
    if set(codes(found_in(fault))) <= OF_LOG:  # effects on the model are also reported
        assert {one.sentence for one in found_in(fault)} <= {one.sentence for one in said}
    else:
        assert said == found_in(fault)
    result = plainly(log.record(), log.configuration)
    if isinstance(result, NotIdentifiableError):
        assert str(result) == sentences[0]  # the check reports all other faults
        return
    assert [note for note in result.notes if note in sentences] == sentences
    shown = result.to_dict()
    assert [finding.to_json() for finding in found_in(fault)] == [
        one for one in shown["findings"] if f"{one['sentence']}: {one['remedy']}" in sentences
    ]
    assert all(sentence in str(result) for sentence in sentences)
    write_result(tmp_path / "out", result)
    page = html.unescape((tmp_path / "out" / "report.html").read_text(encoding="utf-8"))
    assert all(sentence in page for sentence in sentences)


@pytest.mark.parametrize("seed", long_unless((3).__eq__, [3, 18]))
def test_a_clean_log_of_the_right_model_ends_with_0(seed: int, tmp_path: Path) -> None:
    log = clean(seed, AXES)
    assert "nothing" in log.run.label
    record, axis = written(log, tmp_path)
    result = run_command("check", str(record), "--config", str(axis))
    first, *more = result.stdout.splitlines()
    assert re.fullmatch(rf"log.csv: {log.run.u.size} samples, nothing (wrong )?found", first)
    assert [line for line in more if not line.startswith("note: effects outside the model are below")] == []


# --- remedies, followed literally -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Mended:
    columns: dict[str, np.ndarray]
    changes: dict[str, dict[str, object]]


def value_of(pattern: str, text: str) -> str:
    found = re.search(pattern, text)
    assert found is not None, text
    return found.group(1)


def keyed(section: str, key: str) -> Callable[[Logged, str], Mended]:
    """Return the mend that sets the key and the value of the remedy."""

    def mend(log: Logged, text: str) -> Mended:
        return Mended(log.columns, {section: {key: json.loads(value_of(rf"{key} = (\S+)", text))}})

    return mend


def swapped(log: Logged, text: str) -> Mended:
    names = {key: value_of(rf'{key} = "(\w)"', text) for key in ("input", "output")}
    return Mended(log.columns, {"record": dict(names)})


def cut(log: Logged, text: str) -> Mended:
    part = slice(int(value_of(r"use rows (\d+) to", text)) - 1, int(value_of(r"use rows \d+ to (\d+)", text)))
    return Mended({name: values[part] for name, values in log.columns.items()}, {})


def thinned(log: Logged, text: str) -> Mended:
    every = int(value_of(r"keep every (\d+)th row", text))
    starts = np.arange(0, log.columns["u"].size - every, every)
    y = log.columns["y"]
    first = int(np.flatnonzero(np.diff(y))[0] + 1) % every if "new value" in text else 0
    u = log.columns["u"]
    means = np.array([u[start : start + every].mean() for start in starts + first if start + every <= u.size])
    columns = {"u": means, "y": y[starts[: means.size] + first]}
    return Mended(columns, {"record": {"dt": log.run.dt * every}})


REMEDIES: dict[str, Callable[[Logged, str], Mended]] = {
    "reversed sign": keyed("model", "input_gain"),
    "forgotten bits": keyed("encoder", "bits"),
    "velocity as position": keyed("record", "output_kind"),
    "exchanged columns": swapped,
    "clipped counter": cut,
    "stuck counter": cut,
    "output held": thinned,
    "sample rate too high": thinned,
    "dead time": keyed("model", "dead_time"),
}


def mass_of(record: Record, axis: Axis) -> float:
    """Return the mass by instrumental variables, or by the fit with a dead time; infinity without convergence."""
    method = "iv" if axis.model.dead_time == 0 else "fit"
    options = axis.estimator.model_copy(update={"method": method})
    try:
        with mock.patch("pmfid.diagnostics.verdict.fit_again", return_value=None):
            return float(identify(record, axis.model_copy(update={"estimator": options})).theta[0])
    except PmfidError:
        return np.inf


@pytest.mark.parametrize("fault", long_unless([*REMEDIES][1::2].__contains__, REMEDIES))
def test_the_remedy_helps_when_it_is_followed_literally(fault: str) -> None:
    log, truth = log_of(fault), log_of(fault).run.axis.drive.mass
    text = next(finding.text for finding in found_in(fault) if finding.code in FAULTS[fault][1])
    mended = REMEDIES[fault](log, text)
    raw = {name: dict(part) for name, part in log.configuration.model_dump(exclude_unset=True).items()}
    for section, keys in mended.changes.items():
        raw[section] |= keys
    axis = Axis.model_validate(raw)
    before = abs(mass_of(log.record(), log.configuration) / truth - 1)
    after = abs(mass_of(record_of(mended.columns, axis), axis) / truth - 1)
    assert after < max(0.5 * before, 0.005)
    assert after < 0.2


# --- findings ---------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_relative_error_that_nobody_would_accept_is_no_result() -> None:
    run = make_scenario("moves", seed=1, duration=10.0)
    rng = np.random.default_rng(3)
    u = rng.normal(size=run.counts.size)  # the input of another record
    with pytest.raises(NotIdentifiableError):
        pmfid.identify(u, run.counts, model=pmfid.Drive(2.0), dt=run.dt, encoder=pmfid.Encoder(run.resolution))


def pendulum(gravity: bool, torque: float) -> tuple[Record, Axis]:
    """Return a pendulum under slow position control with its AXIS.toml; `torque` is the load's [N m]."""
    drive = DriveParameters(0.02, 0.05, 0.1, 1.0)
    t, dt, resolution = np.arange(3000) * 0.01, 0.01, 2 * np.pi / 4096
    reference = 1.2 * np.sin(0.7 * t) + 0.5 * np.sin(2.9 * t + 1) + 0.2 * np.sin(7.1 * t)
    machine = Machine(drive, gravity=torque, gravity_angle=0.3)
    run = control_machine(machine, reference, dt, resolution, kp=8.0, kd=0.8, u_max=5.0)
    raw = {"record": {"input": "u", "output": "y", "dt": dt}, "encoder": {"resolution": resolution}}
    model = {"kind": "drive", "input_gain": 1.0, "axis": "rotary", "gravity": gravity}
    return Record(run.u, run.counts, dt, resolution, (), "pendulum"), Axis.model_validate(raw | {"model": model})


def test_gravity_that_the_model_leaves_out_is_named() -> None:
    """An earlier version suggested a shorter sample period and a dead time of 21 samples."""
    record, axis = pendulum(False, 0.8)
    assert check_record(record, axis) == ()
    assert "set gravity = true" in {one.remedy for one in check(record, axis)}
    assert "set gravity = true" not in {one.remedy for one in check(*pendulum(False, 1e-9))}


def test_an_input_that_is_logged_late_is_moved_and_no_dead_time() -> None:
    """For this record `dead_time = "estimate"` found 0, and the status stayed."""
    run = make_scenario("prbs", seed=1, increments=1024, duration=10.0)
    u, counts = run.motion.u, run.counts
    fit = partial(pmfid.identify, model=pmfid.Drive(2.0), dt=run.dt, encoder=pmfid.Encoder(run.resolution))
    text = " ".join(finding.text for finding in fit(np.roll(u, 1)[1:], counts[1:]).findings)
    assert "before it is logged" in text
    assert "shift the input's column earlier" in text
    assert 'dead_time = "estimate"' not in text
    noise = np.random.default_rng(1).standard_normal(counts.size)
    assert fit(u, counts).status == fit(u, np.rint(counts + noise).astype(np.int64)).status == ()
