"""One fit of one record: the call under test, its time, and a row of the results."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import NamedTuple

import pmfid
from pmfid.models.axes import AxisKind
from pmfid.pipeline.result import DriveResult
from studies.referee.cases import PARAMETERS, Case

#: Processor time after which a fit counts as refused [s].
MOST_SECONDS = 60.0
Row = dict[str, str | float]


class Answer(NamedTuple):
    """What a fit says: values, standard errors and 95 % intervals by parameter, status words, and a refusal or ""."""

    theta: Mapping[str, float]
    std: Mapping[str, float]
    interval: Mapping[str, tuple[float, float]]
    status: Sequence[str]
    refused: str


Call = Callable[[Case], Answer]


class OutOfTime(BaseException):
    """A fit needs more than `MOST_SECONDS`. No `except Exception` in the call under test catches this."""


def fit_plain(case: Case) -> DriveResult:
    """Call `pmfid.identify` with the plain drive, as a user does who knows the input gain and the encoder."""
    axis: AxisKind = "rotary" if case.rotary else "linear"
    if case.t is None:
        drive = pmfid.Drive(case.input_gain, axis=axis)
        encoder = pmfid.Encoder(case.resolution)
        result = pmfid.identify(case.u, case.counts, model=drive, dt=case.dt, encoder=encoder)
    else:
        sections = {
            "record": {"input": "u", "output": "counts", "output_kind": "counts", "time": "t"},
            "encoder": {"resolution": case.resolution},
            "model": {"kind": "drive", "input_gain": case.input_gain, "axis": axis},
        }
        result = pmfid.identify({"t": case.t, "u": case.u, "counts": case.counts}, axis=sections)
    assert isinstance(result, DriveResult)
    return result


def identify(case: Case) -> Answer:
    """Return what the plain fit says."""
    result = fit_plain(case)
    assert result.interval_95 is not None
    return Answer(
        dict(zip(PARAMETERS, map(float, result.theta), strict=False)),
        dict(zip(PARAMETERS, map(float, result.theta_std), strict=False)),
        {name: (float(low), float(high)) for name, (low, high) in zip(PARAMETERS, result.interval_95, strict=False)},
        result.status,
        "",
    )


def load_call(name: str) -> Call:
    """Return the function `module:function`."""
    module, _, function = name.partition(":")
    return getattr(import_module(module), function)  # type: ignore[no-any-return]


def raise_out_of_time(*_: object) -> None:
    raise OutOfTime


def answer(call: Call, case: Case) -> Answer:
    """Call the fit with a bound on its processor time. An error is a refusal."""
    signal.signal(signal.SIGPROF, raise_out_of_time)
    signal.setitimer(signal.ITIMER_PROF, MOST_SECONDS)
    try:
        return call(case)
    except OutOfTime:
        return Answer({}, {}, {}, (), f"OutOfTime: {MOST_SECONDS:g} s")
    except Exception as error:
        return Answer({}, {}, {}, (), f"{type(error).__name__}: {error}".replace("\n", " ")[:100])
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def choose_gain(case: Case, mass: float) -> float:
    """Return 1 or the gain in the record, whichever explains the mass better: a bent input leaves the gain open."""
    return min((1.0, case.seen_gain), key=lambda gain: abs(mass * gain / case.truth["mass"] - 1))


def judge(name: str, case: Case) -> Row:
    """Return the row of one machine. Values, errors and intervals are relative to the truth."""
    call, start = load_call(name), time.process_time()
    theta, std, interval, status, refused = answer(call, case)
    seconds = time.process_time() - start
    row: Row = {"kind": case.kind, "index": case.index, "motion": case.motion, **case.facts, "rotary": int(case.rotary)}
    row |= {"seconds": seconds, "status": " ".join(status), "refused": refused}
    nan = float("nan")
    gain = choose_gain(case, theta.get("mass", nan))
    row["gain"] = gain
    for parameter in PARAMETERS:
        true = case.truth[parameter] / gain
        low, high = interval.get(parameter, (nan, nan))
        row |= {
            f"{parameter}_truth": true,
            f"{parameter}_error": theta.get(parameter, nan) / true - 1,
            f"{parameter}_std": std.get(parameter, nan) / true,
            f"{parameter}_low": low / true - 1,
            f"{parameter}_high": high / true - 1,
        }
    return row
