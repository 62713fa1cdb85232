"""Section on measured records cut in four: agreement of the parts' estimates, and length of their intervals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pmfid
from pmfid.types import Floats
from studies.paper.truth import Study, Task, table

#: The electro-mechanical positioning system, 24 841 samples at 1 kHz (Janot, Gautier and Brunot 2019).
EMPS, EMPS_DT = Path(__file__).parents[2] / "shared" / "data" / "emps" / "DATA_EMPS.mat", 1e-3
#: Logs of a cart under relay current: 150 Hz, travel per count [m], force per current [N/A].
CART, CART_DT, STEP, FORCE = EMPS.parents[1] / "real" / "cart_relay", 1 / 150, 8.8e-5, 3.3357
PARTS = 4
#: Largest ratio of half an interval to the scatter of the parts.
LONGEST = 4.0


@dataclass(frozen=True, eq=False)
class Motion:
    """Input (n,), counts (n,), unit of the position per count, sample period [s]."""

    u: Floats
    counts: NDArray[np.int64]
    resolution: float
    dt: float


#: Values (k,) from the parts with an estimate, and half of their intervals (k,).
Parts = tuple[Floats, Floats]


def tasks(seeds: int) -> list[Task]:
    """Return one task for each existing record."""
    emps = [("EMPS",)] if EMPS.exists() else []
    return [*emps, *((path.stem,) for path in sorted(CART.glob("*.csv")))]


def measured(resolution: float) -> Motion:
    """Return the record of EMPS with the counts of an encoder."""
    from scipy.io import loadmat

    data = loadmat(EMPS)
    counts = np.floor(data["qm"].ravel() / resolution + 1e-6).astype(np.int64)
    return Motion((data["vir"] * data["gtau"]).ravel(), counts, resolution, EMPS_DT)


def cart_log(name: str) -> Motion:
    """Return a record on an even clock, without its first two rows."""
    time, current, position = np.loadtxt(CART / f"{name}.csv", delimiter=",", usecols=(0, 1, 2), skiprows=2).T
    even = np.arange(time[0], time[-1], CART_DT)
    last = np.searchsorted(time, even + CART_DT / 4) - 1
    return Motion(current[last], np.rint(position[last] / STEP).astype(np.int64), STEP, CART_DT)


def work(name: str) -> dict[str, Parts]:
    """Return the parts' estimates, by parameter."""
    emps = name == "EMPS"
    whole = measured(5e-8) if emps else cart_log(name)
    model = pmfid.Drive(1.0, offset=True) if emps else pmfid.Drive(FORCE)
    found = list(_identified(whole, model))
    return {
        key: (np.array([theta[i] for theta, _ in found]), np.array([half[i] for _, half in found]))
        for i, key in enumerate(model.equation.names)
    }


def _identified(whole: Motion, model: pmfid.Drive) -> Iterator[Parts]:
    encoder, dt = pmfid.Encoder(whole.resolution), whole.dt
    for part in np.array_split(np.arange(whole.u.size), PARTS):
        try:
            found = pmfid.identify(whole.u[part], whole.counts[part], model=model, encoder=encoder, dt=dt)
        except pmfid.NotIdentifiableError:
            continue
        assert found.interval_95 is not None
        yield found.theta, np.ptp(found.interval_95, axis=1) / 2


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    cells = [(name, key, *parts) for (name,), by_key in results.items() for key, parts in by_key.items()]
    rows, short = [], 0
    for name, key, values, half in cells:
        pairs = list(combinations(range(values.size), 2))
        agree = sum(abs(values[i] - values[j]) <= np.hypot(half[i], half[j]) for i, j in pairs)
        length = float(np.sqrt(np.mean(half**2)) / np.std(values, ddof=1)) if values.size > 1 else np.nan
        short += length <= LONGEST
        each = ", ".join(f"{value:.4g} ± {h:.2g}" for value, h in zip(values, half, strict=True))
        rows.append([name, key, each, f"{agree} of {len(pairs)}", f"{length:.1f}"])
    return [
        "## Measured records in four parts",
        "",
        f"Of {len(cells)} cells {short} have half an interval of at most {LONGEST:g} times the scatter of the parts. "
        "The parts repeat one motion. An error of the model that is the same in each is in the interval, and not in "
        "the scatter.",
        "",
        *table(["record", "parameter", "parts", "pairs that agree", "half interval over scatter"], rows),
    ]


RECORD_PARTS = Study("records", tasks, work, write)
