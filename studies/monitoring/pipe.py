"""The files of a monitored axis."""

from __future__ import annotations

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
