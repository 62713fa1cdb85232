"""The page of a free friction curve."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pmfid.pipeline.friction import FrictionCurve, curve_json
from pmfid.report.figures import COLOURS, GREY, open_figure
from pmfid.report.page import ResultPage, Section

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def curve_page(found: FrictionCurve, name: str) -> ResultPage:
    """Return the page of the friction curve of the record `name`."""
    (back, _), (slow, ahead) = found.visited
    own = found.motion
    text = (
        f"The band is two standard deviations. The record goes from {back:.3g} to {ahead:.3g} {own.speed}. The curve "
        f"ends at {found.visited[0][1]:.3g} and {slow:.3g} {own.speed}, and does not contain friction at rest."
    )
    text = "\n\n".join([text, *(finding.paragraph for finding in found.findings)])
    table = found.summary()
    section = Section("Friction over velocity", text, (table.header, table.rows), lambda: curve_figure(found))
    lead = [f"{own.inertia.capitalize()} of the same fit: {found.mass:.5g} ± {found.mass_std:.2g} {own.of_inertia}."]
    remarks = [line for finding in found.findings for line in finding.lines]
    return ResultPage("friction", f"{name}: friction over velocity", curve_json(found, name), [section], lead, remarks)


def curve_figure(found: FrictionCurve) -> Figure:
    """Draw the curve with a band of two standard deviations."""
    with open_figure(3.8) as (figure, (axes,)):
        for number, way in enumerate((found.velocity < 0, found.velocity > 0)):
            v, force, std = found.velocity[way], found.force[way], found.std[way]
            label = "two standard deviations" if number == 0 else None
            axes.fill_between(v, force - 2 * std, force + 2 * std, color=COLOURS[0], alpha=0.25, lw=0, label=label)
            axes.plot(v, force, color=COLOURS[0], lw=1.4, label="friction" if number == 0 else None)
        axes.axhline(0.0, color=GREY, lw=0.8)
        axes.axvline(0.0, color=GREY, lw=0.8)
        axes.set_xlim(*(1.03 * np.array([found.velocity[0], found.velocity[-1]])))
        axes.set_xlabel(f"velocity in {found.motion.speed}")
        axes.set_ylabel(f"friction in {found.motion.force}")
        axes.legend(loc="upper left")
    return figure
