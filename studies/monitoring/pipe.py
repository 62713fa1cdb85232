"""An axis, its lines and the memory of a process, for pipes."""

from __future__ import annotations

import os
from pathlib import Path

from pmfid.simulation.scenarios import CART, CART_DT, resolution_of
from studies.monitoring.axis import CUTOFF, FORGETTING, INCREMENTS, normal_work

AXIS = """[record]
input = "u"
output = "counts"
output_kind = "counts"
time = "t"

[encoder]
resolution = {resolution!r}

[model]
input_gain = {gain!r}

[estimator]
cutoff = {cutoff!r}
forgetting = {forgetting!r}

[monitor]
reference = "normal.csv"
mtbf_hours = 1.0
"""


def write_axis(folder: Path, seconds: float = 600.0) -> Path:
    """Write AXIS.toml and normal.csv into a folder; return the path of the first."""
    u, counts = normal_work(1, INCREMENTS, seconds / 3600)
    rows = (f"{k * CART_DT:.2f},{a!r},{b}" for k, (a, b) in enumerate(zip(u.tolist(), counts.tolist(), strict=True)))
    (folder / "normal.csv").write_text("\n".join(["t,u,counts", *rows]) + "\n")
    axis = folder / "axis.toml"
    values = {"resolution": resolution_of(INCREMENTS), "gain": CART.input_gain}
    axis.write_text(AXIS.format(cutoff=CUTOFF, forgetting=FORGETTING, **values))
    return axis


def lines(seconds: float, seed: int = 2) -> list[bytes]:
    """Return a header and the samples of normal work."""
    u, counts = normal_work(seed, INCREMENTS, seconds / 3600)
    rows = enumerate(zip(u.tolist(), counts.tolist(), strict=True))
    return [b"t,u,counts\n", *(f"{k * CART_DT:.2f},{a!r},{b}\n".encode() for k, (a, b) in rows)]


def resident(pid: int) -> float:
    """Return the resident memory of a process [MiB], from /proc."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20
