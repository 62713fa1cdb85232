"""The page of a comparison of encoders."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pmfid.pipeline.encoders import EncoderChoice
from pmfid.report.figures import COLOURS, GREY, open_figure, plain_ticks
from pmfid.report.page import ResultPage, Section

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def encoder_page(found: EncoderChoice) -> ResultPage:
    """Return the page of a comparison of encoders."""
    table = found.summary()
    text = "\n\n".join(f"{note[0].upper()}{note[1:]}." for note in found.notes)
    heading = table.title.partition(": ")[2].capitalize()
    section = Section(heading, text, (table.header, table.rows), lambda: encoder_figure(found))
    lead, remarks = [f"{found.answer.capitalize()}."], [f"note: {note}" for note in found.notes]
    return ResultPage("encoder", f"{found.record}: which encoder", found.to_dict(), [section], lead, remarks)


def encoder_figure(found: EncoderChoice) -> Figure:
    """Draw the uncertainty against the encoder, from counts and with edge times."""
    places = found.steps if found.turn is None else found.turn / found.steps
    with open_figure(3.8) as (figure, (axes,)):
        axes.axhline(100 * found.wanted, color=GREY, lw=0.8, label=f"wanted: {100 * found.wanted:.3g} %")
        axes.axhline(100 * found.own, color=GREY, lw=0.8, ls="--", label="from this record")
        for (label, bars), colour in zip(found.kinds.items(), COLOURS, strict=False):
            known = np.where(bars < 1, 100 * bars, np.nan)
            axes.plot(places, known, "o-", color=colour, ms=3.5, lw=1.2, label=label)
        axes.set_xscale("log")
        axes.set_yscale("log")
        if found.turn is not None:
            axes.set_xticks(places, [f"{place:.0f}" for place in places])
            axes.minorticks_off()
        else:
            plain_ticks(axes.xaxis)
        plain_ticks(axes.yaxis)
        axes.set_xlabel(f"step in {found.unit}" if found.turn is None else "increments per turn")
        axes.set_ylabel(f"{found.parameter}: standard deviation in %")
        axes.legend()
    return figure
