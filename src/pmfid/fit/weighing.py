"""What a record says of each force of the table: odds, size, and the change of the parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmfid.fit.compare import Quadratic
from pmfid.fit.terms import ExtraForce
from pmfid.types import Floats


@dataclass(frozen=True, eq=False)
class WeighedForce:
    """A force of the table with c candidates, against the chosen set without it.

    `odds` is the logarithm of its posterior odds, prior odds included. `sizes` (c,) and `stds` (c,) are in the units of
    the candidates. `moved` (p,) is the change of the machine's parameters by the force.
    """

    candidates: tuple[ExtraForce, ...]
    chosen: bool
    odds: float
    sizes: Floats
    stds: Floats
    moved: Floats


def weigh(
    local: Quadratic, table: Sequence[ExtraForce], chosen: Sequence[int], sizes: Floats, stds: Floats, lift: Floats
) -> tuple[WeighedForce, ...]:
    """Return all forces of the table, the chosen ones first.

    `sizes` (c,) and `stds` (c,) are those of the c chosen candidates and their standard errors, in standard deviations
    of the priors. `lift` (p,) converts changes of the machine's parameters to their units.
    """
    free = np.isin(np.arange(len(table)), chosen)  # the fit itself keeps the chosen ones within their bounds
    local = replace(local, lowest=np.where(free, -np.inf, local.lowest))
    groups: dict[str, list[int]] = {}
    for i, one in enumerate(table):
        groups.setdefault(one.words, []).append(i)
    places = {i: k for k, i in enumerate(chosen)}
    value, step, _ = local.evidence(chosen)
    taken, others = [], []
    for group in groups.values():
        inside = [i for i in group if i in places]
        if inside:
            other, moved, _ = local.evidence([i for i in chosen if i not in group])
            change = (step[: local.plain] - moved[: local.plain]) * lift
            at = [places[i] for i in inside]
            taken.append(_make_weighed(table, inside, value - other, (sizes[at], stds[at]), change))
        else:
            further = max([[i] for i in group] + [group], key=lambda one: local.evidence([*chosen, *one])[0])
            other, moved, covariance = local.evidence([*chosen, *further])
            change = (moved[: local.plain] - step[: local.plain]) * lift
            added = moved[step.size :], np.sqrt(np.diag(covariance))[step.size :]
            others.append(_make_weighed(table, further, other - value, added, change, chosen=False))
    return (*taken, *sorted(others, key=lambda one: -one.odds))


def _make_weighed(
    table: Sequence[ExtraForce],
    group: Sequence[int],
    odds: float,
    sizes: tuple[Floats, Floats],
    moved: Floats,
    chosen: bool = True,
) -> WeighedForce:
    sd = np.array([table[i].sd for i in group])
    values, stds = sizes[0] * sd, sizes[1] * sd
    candidates = tuple(table[i].describe(value) for i, value in zip(group, values.tolist(), strict=True))
    return WeighedForce(candidates, chosen, odds, values, stds, moved)
