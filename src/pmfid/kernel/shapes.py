"""Tables of forces as the kernel holds them (csrc/pmf_shapes.h)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from pmfid.kernel.configuration import fill
from pmfid.kernel.structures import constants_of, structures

_KERNEL = constants_of(None)
_OF = {name: _KERNEL[f"PMF_OF_{name.upper()}"] for name in ("speed", "square", "place")}
#: Forces that it holds, and knots of all their tables.
MOST_SHAPES, MOST_KNOTS = _KERNEL["PMF_MAX_SHAPES"], _KERNEL["PMF_MAX_KNOTS"]
FIRST_NODE = _KERNEL["PMF_SIGNALS"]


@dataclass(frozen=True)
class ShapeTable:
    """knots (k,) from `start` on in steps, of a speed or a place; beyond them the last one holds, or a periodic table
    repeats. of "square": the square of the speed, without knots. positive: as of the `Shape`."""

    of: Literal["speed", "square", "place"]
    knots: tuple[float, ...] = (0.0, 1.0)
    start: float = 0.0
    step: float = 1.0
    periodic: bool = False
    positive: bool = False


#: A table, and whether the force acts against the motion.
Acting = tuple[ShapeTable, bool]


def shape_values(
    shapes: Sequence[Acting], nodes: Sequence[int], measured: Sequence[int] | None = None
) -> dict[str, object]:
    """The fields of `pmf_shapes_config_t`; nodes: where the mean of each over an interval goes; measured: and where its
    value at the place of the counts, 0: nowhere. Raises ValueError if the kernel has no room for the tables."""
    rows, knots, sums = [], [0.0], [0.0]  # never none, for an array of C has one element or more
    for (table, resists), node, seen in zip(shapes, nodes, measured or [0] * len(nodes), strict=True):
        own = np.array(table.knots)
        form = (_OF[table.of], int(resists), int(table.positive), int(table.periodic))
        rows.append((*form, len(knots), own.size - 1, node, seen, table.start, 1 / table.step))
        knots += own.tolist()
        sums += [0.0, *np.cumsum((own[1:] + own[:-1]) / 2).tolist()]
    if refused := too_many([table for table, _ in shapes]):
        raise ValueError(refused)
    return {"n": len(rows), "shape": rows, "knot": knots, "sum": sums}


def too_many(tables: Sequence[ShapeTable]) -> str:
    """Why the kernel cannot hold them, with a remedy; empty where it can."""
    knots = 1 + sum(len(table.knots) for table in tables)
    if len(tables) <= MOST_SHAPES and knots <= MOST_KNOTS:
        return ""
    return (
        f"the model has {len(tables)} forces of a given form with {knots} knots, the kernel holds {MOST_SHAPES} and "
        f"{MOST_KNOTS}; use fewer"
    )


@lru_cache
def shape_bytes(shapes: tuple[Acting, ...]) -> bytes:
    """The same for the simulation alone (`_kernel64.simulate`); empty without any."""
    if not shapes:
        return b""
    config = np.zeros((), structures(None, "float64")["pmf_shapes_config_t"])
    fill(config, shape_values(shapes, range(FIRST_NODE, FIRST_NODE + len(shapes))))
    return config.tobytes()
