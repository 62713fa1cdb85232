"""Friction over velocity, without an assumed law, from a record and AXIS.toml or from arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from pmfid.config.axis import Axis
from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.configuration import like
from pmfid.estimators.motion_fit import MotionFit
from pmfid.findings import MOVE, Finding, Judged, make_notes, sort_findings, texts
from pmfid.fit.compare import NORMAL_95
from pmfid.fit.curve import CurveFit, fit_curve
from pmfid.fit.findings import findings_of
from pmfid.models.axes import LINEAR, Units
from pmfid.models.drive import Drive
from pmfid.models.equation import ESTIMATE
from pmfid.pipeline.arrays import axis_of, pair_record
from pmfid.pipeline.drives import match_kind
from pmfid.pipeline.fitted import make_fit
from pmfid.pipeline.known import check_numbers_known, gain_needed
from pmfid.presentation import Presentable, Summary, plain_dict, remarks_of
from pmfid.records.outliers import repair_as_configured
from pmfid.records.record import Record
from pmfid.types import Floats


@dataclass(frozen=True, eq=False, repr=False)
class FrictionCurve(Presentable, Judged):
    """Friction over velocity, with error bars.

    `velocity` (k,) [m/s] are in rising order, the backward ones first. `force` and `std` (k,) [N] are the friction and
    its standard errors, `mass` and `mass_std` [kg] the mass and its standard error. The standard errors contain the
    noise, the unknown smoothness of the curve, and further forces that the record does not exclude. `samples` is the
    number of counts. `motion` holds the units, which for a rotary axis are rad/s, N m and kg m2.
    """

    velocity: Floats
    force: Floats
    std: Floats
    mass: float
    mass_std: float
    samples: int
    findings: tuple[Finding, ...] = ()
    motion: Units = LINEAR

    @property
    def visited(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Ranges of the curve's velocity [m/s], backward and forward.

        Between the two ranges, the record cannot separate the curve from the jump at zero.
        """
        back, ahead = self.velocity[self.velocity < 0], self.velocity[self.velocity > 0]
        return (float(back[0]), float(back[-1])), (float(ahead[0]), float(ahead[-1]))

    def evaluate(self, velocity: ArrayLike) -> Floats:
        """Return the friction (n,) [N] at velocities (n,) [m/s]; NaN for velocities outside the curve."""
        v = np.asarray(velocity, np.float64)
        inside = np.any([(low <= v) & (v <= high) for low, high in self.visited], axis=0)
        return np.where(inside, np.interp(v, self.velocity, self.force), np.nan)

    def summary(self) -> Summary:
        units = self.motion
        mass = f"{units.inertia} = {self.mass:.6g} ± {self.mass_std:.2g} {units.of_inertia}"
        header = (f"velocity [{units.speed}]", f"friction [{units.force}]", f"std [{units.force}]")
        sides = [np.flatnonzero(self.velocity < 0), np.flatnonzero(self.velocity > 0)[::-1]]
        shown = np.sort(np.concatenate([side[:: side.size // 10 + 1] for side in sides]))
        rows = [self._row(i) for i in shown.tolist()]
        lines = [
            f"{force} ± {std} {units.force} at {velocity} {units.speed}"
            for velocity, force, std in (
                self._row(i) for i in np.flatnonzero(np.isin(self.velocity, self.visited)).tolist()
            )
        ]
        title = f"friction from {self.velocity[0]:.3g} to {self.velocity[-1]:.3g} {units.speed}; {mass}"
        return Summary(title, header, rows, lines, remarks_of(self.status, texts(self.findings)))

    def _row(self, index: int) -> tuple[str, str, str]:
        return f"{self.velocity[index]:.4g}", f"{self.force[index]:.5g}", f"{self.std[index]:.2g}"

    def columns(self) -> dict[str, object]:
        """Return the columns of a table with one row for each velocity."""
        return {"velocity": self.velocity, "force": self.force, "std": self.std}

    def to_dict(self) -> dict[str, object]:
        rows = zip(self.velocity.tolist(), self.force.tolist(), self.std.tolist(), strict=True)
        return plain_dict(
            {
                "samples": self.samples,
                self.motion.inertia: {"value": self.mass, "std": self.mass_std, "unit": self.motion.of_inertia},
                "curve": [{"velocity": velocity, "force": force, "std": std} for velocity, force, std in rows],
                "visited": [list(part) for part in self.visited],
                "status": list(self.status),
                "findings": [finding.to_json() for finding in self.findings],
            }
        )


def friction_curve(u: ArrayLike, counts: ArrayLike, *, model: Drive, encoder: Encoder, dt: float) -> FrictionCurve:
    """Estimate the mass, and friction over velocity without an assumed law, as `pmfid friction` does.

    Parameters
    ----------
    u : array_like (n,)
        The input. NaN marks a gap.
    counts : array_like (n,)
        Counts of the encoder. NaN marks a missing count.
    model : Drive
        The drive. The function uses every key of the drive but its friction.
    encoder : Encoder
    dt : float
        Sample period [s].

    Returns
    -------
    FrictionCurve

    Raises
    ------
    UsageError
        The arguments contradict each other.
    NotIdentifiableError
        The record does not separate friction from other forces.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Drive, Encoder, friction_curve, quantize
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = prbs(600, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    >>> curve = friction_curve(u, counts, model=Drive(CART.input_gain), encoder=Encoder(CART_RESOLUTION), dt=CART_DT)
    >>> round(curve.mass, 3), CART.mass
    (1.07, 1.07)
    """
    if isinstance(model, Drive) and model.input_gain == ESTIMATE:
        raise gain_needed("a friction curve")
    axis = axis_of(model, encoder, dt, {})
    return record_curve(pair_record(u, counts, axis), axis)


def record_curve(record: Record, axis: Axis) -> FrictionCurve:
    """Return the friction curve of a record that was read for `axis`, without samples that no motion explains."""
    axis = match_kind(record, axis)
    model = axis.model.make()
    if not isinstance(model, Drive):
        raise UsageError('a friction curve needs a machine with friction: give [model] kind = "drive"')
    check_numbers_known(axis, "a friction curve")
    free = replace(model, friction="directional", offset=False, stribeck=None, quadratic=False)
    repaired = repair_as_configured(record, axis)
    method = like(MotionFit, make_fit(axis, record), model=free)
    with np.errstate(all="ignore"):  # motions far from the record may overflow
        fit = fit_curve(method.problem(repaired.record.u, repaired.record.counts, repaired.used))
    if not fit.mass_half < fit.mass:
        raise NotIdentifiableError(
            f"{model.equation.motion.inertia} comes out as {fit.mass:.3g}, and its error may be {fit.mass_half:.2g}. "
            f"Advice: {MOVE}"
        )
    notes = make_notes("record", (*record.notes, repaired.sentence))
    findings = sort_findings((*_findings(fit, method.names, axis.estimator.tolerance), *notes))
    std, mass_std = fit.half / NORMAL_95, fit.mass_half / NORMAL_95
    units = model.equation.motion
    return FrictionCurve(fit.velocity, fit.force, std, fit.mass, mass_std, int(np.sum(repaired.used)), findings, units)


def _findings(fit: CurveFit, names: tuple[str, ...], tolerance: float) -> list[Finding]:
    """Return the findings on the forces beyond the curve and on the mass."""
    machine = fit.fitted.problem.machine
    leading = np.arange(len(machine.names)) == machine.lead
    sizes = np.where(leading, fit.mass, np.inf)
    return list(findings_of(fit.fitted, (*names, *machine.names[len(names) :]), leading, sizes, tolerance))


def curve_json(found: FrictionCurve, name: str) -> dict[str, object]:
    """Return the object that `--json` prints."""
    return {"record": name, **found.to_dict()}
