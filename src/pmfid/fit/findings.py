"""What to think of a fit, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from pmfid.findings import MOVE, Finding
from pmfid.fit.compare import NORMAL_95
from pmfid.fit.fit import Fitted
from pmfid.fit.likelihood import Gaussian
from pmfid.fit.second_mass import SecondMass
from pmfid.fit.terms import ExtraForce
from pmfid.models.axes import rotary
from pmfid.types import Flags, Floats

#: Codes of candidates that have a code of their own; all others are "unmodelled".
CODES = {"dead_time": "dead_time", "lag": "dead_time", "smooth": "friction"}


def findings_of(
    fitted: Fitted,
    names: tuple[str, ...],
    positive: Flags,
    sizes: Floats,
    tolerance: float,
    second: SecondMass | None = None,
) -> Iterator[Finding]:
    """Yield the findings on a fit.

    `positive` (p,) marks inertia and friction. `sizes` (p,) are those to which the errors of the parameters are
    relative, and `tolerance` is the negligible part. A `second` mass stands for the forces that were found without it.
    """
    if second is None:
        yield from _forces(fitted, names, sizes, tolerance)
    else:
        yield _describe(second, fitted, names, sizes, tolerance)
    yield from _wandering(fitted, names, sizes, tolerance)
    yield from _unknown(fitted, names, positive)
    half, std = fitted.half, np.sqrt(np.diag(fitted.covariance))
    hidden = half > np.maximum(tolerance * sizes, 2 * NORMAL_95 * std)
    if np.any(hidden):
        worst = int(np.argmax(np.where(hidden, half / sizes, 0.0)))
        yield Finding(
            "model_spread",
            f"the record does not exclude {fitted.rival}, which may move {names[worst]} by "
            f"{format_part(half[worst] / sizes[worst])}",
            "record an input of several sizes, with reversals and rests",
            "note",
        )


def _forces(fitted: Fitted, names: tuple[str, ...], sizes: Floats, tolerance: float) -> Iterator[Finding]:
    """Yield a finding for each force that the comparison added. It matters if the parameters without it are wrong.
    Smooth friction is a note, because the parameters are those of Coulomb friction beyond its speed."""
    moved = np.abs(fitted.plain - fitted.theta) / sizes
    worst = int(np.argmax(moved))
    matters = bool(moved[worst] > tolerance)
    seen = set()
    for k, one in fitted.problem.place_candidates():
        if one.late or one.words in seen:
            continue
        seen.add(one.words)
        if one.name == "warmth":
            yield Finding("temperature", f"{one.words}{_describe_size(fitted, one)}", severity="note")
            continue
        size, *constants = fitted.solution.q[k : k + 1 + one.free]
        shown = one.describe(size * one.sd)
        detail = f"Without it, {names[worst]} would be {format_part(moved[worst])} off." if matters else ""
        yield Finding(
            CODES.get(one.name, "unmodelled"),
            f"the record shows {shown.words}{_describe_speed(fitted, one, constants)}{_describe_size(fitted, one)}",
            shown.remedy,
            "doubt" if matters and one.name != "smooth" else "note",
            detail,
        )


def _describe_speed(fitted: Fitted, one: ExtraForce, constants: Sequence[float]) -> str:
    """Return the speed of a friction that depends on one, from the constant in units of its first value."""
    if one.name not in ("stribeck", "smooth") or not constants:
        return ""
    speed = f"{constants[0] * one.constant:.3g} {'rad/s' if fitted.problem.machine.turn > 0 else 'm/s'}"
    return f", with a speed of {speed}" if one.name == "stribeck" else f" as tanh(v / ({speed}))"


def _describe_size(fitted: Fitted, one: ExtraForce) -> str:
    """Return the size of an error of the encoder, with its phase at the first position of the record, or the slope of
    friction over its column."""
    weighed = next((force for force in fitted.weighed if force.candidates[0].words == one.words), None)
    if weighed is None:
        return ""
    turns, (sizes, stds) = fitted.problem.machine.turn > 0, (weighed.sizes, weighed.stds)
    if one.name == "warmth":
        units = [rotary(row.unit) if turns else row.unit for row in weighed.candidates]
        slopes = [f"{a:.4g} ± {b:.2g} {unit}" for a, b, unit in zip(sizes, stds, units, strict=True)]
        return f", by {' and '.join(slopes)} per unit of the column"
    if one.reading is None or sizes.size != 2:
        return ""
    size, angle = float(np.hypot(*sizes)), float(np.degrees(np.arctan2(sizes[1], sizes[0])))
    error, across = (float(np.linalg.norm(row * stds)) / max(size, 1e-300) for row in (sizes, sizes[::-1]))
    phase = f"{angle:.4g} ± {np.degrees(across / max(size, 1e-300)):.2g} deg"
    return f", of {size:.4g} ± {error:.2g} {'rad' if turns else 'm'} with a phase of {phase}"


def _describe(second: SecondMass, fitted: Fitted, names: tuple[str, ...], sizes: Floats, tolerance: float) -> Finding:
    """Return the finding on a second mass. It matters if a mass or friction of the rigid axis is not that of both."""
    missed = miss_sums(fitted, second)
    moved = np.abs(missed) / sizes
    worst = int(np.argmax(moved))
    total = f"The sum of {names[worst]} over both masses is {fitted.theta[worst] + missed[worst]:.4g}, so that "
    exact = second.resonance is not None or second.play is not None
    return Finding(
        "two_mass",
        f"{second.describe('rad' if fitted.problem.machine.turn else 'm')} explains the record better",
        second.remedy,
        "doubt" if moved[worst] > tolerance else "note",
        f"{total}{names[worst]} is {format_part(moved[worst])} off." if exact else "",
    )


def _wandering(fitted: Fitted, names: tuple[str, ...], sizes: Floats, tolerance: float) -> Iterator[Finding]:
    """Yield a finding on residuals beyond rounding. The standard errors contain white noise. Other residuals matter if
    errors of their size may move a parameter."""
    noise = fitted.likelihood
    if not isinstance(noise, Gaussian) or not (noise.wanders or noise.scale > 1.5):
        return
    if not noise.wanders:
        sentence = f"the counts have white noise of {np.sqrt(noise.scale):.2g} times the rounding of the encoder"
        yield Finding("unmodelled", sentence, "check [encoder] resolution, or use a sensor with less noise", "note")
        return
    missed = fitted.scale_reach(sizes)
    worst = int(np.argmax(missed))
    matters = bool(missed[worst] > tolerance)
    detail = "" if matters else f"No error of this size moves {names[worst]} by more than {format_part(missed[worst])}."
    what = "a force" if noise.force[0] > 0 else "an error of the position"
    sentence = f"{what} that no term explains wanders, and the intervals include it"
    remedy = "compare the motion with the record (--out), and add the missing effect to [model]"
    yield Finding("unmodelled", sentence, remedy, "doubt" if matters else "note", detail)


def _unknown(fitted: Fitted, names: tuple[str, ...], positive: Flags) -> Iterator[Finding]:
    for name, value, half, never_negative in zip(names, fitted.theta, fitted.half, positive, strict=True):
        if never_negative and value + 1.5 * half < 0:
            yield Finding(
                "implausible", f"{name} is negative", "check sign and scale of the input and the encoder", "wrong"
            )
        elif never_negative and half > abs(value) / 2:
            yield Finding("uncertain", f"the error of {name} may exceed half its value", MOVE)


def format_part(part: float) -> str:
    """Return a relative error as text."""
    return f"{100 * part:.2g} %" if part < 1 else "over 100 %"


def miss_sums(fitted: Fitted, second: SecondMass) -> Floats:
    """Return the distances (p,) of the sums of two masses from the parameters of one, and 0 for other parameters."""
    missed, lift = np.zeros(fitted.theta.size), fitted.problem.machine.lift
    for row, total in second.sums.items():
        columns = np.flatnonzero(lift[row])
        if columns.size == 1 and columns[0] < missed.size:
            missed[columns[0]] = total - fitted.theta[columns[0]]
    return missed


def widen(fitted: Fitted, second: SecondMass) -> Fitted:
    """Return the fit of one mass with intervals that contain the sums of two masses."""
    return replace(fitted, half=np.hypot(fitted.half, NORMAL_95 * miss_sums(fitted, second)))
