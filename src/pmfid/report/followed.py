"""The figure of an output that a simulation follows."""

from __future__ import annotations

from matplotlib.figure import Figure

from pmfid.report.figures import COLOURS, GREY, WIDTH, decimation, figure_style
from pmfid.types import Floats


def followed_figure(
    t: Floats, signals: tuple[Floats, Floats], output: str, error: Floats, left: str, shaded: float = 0.0
) -> Figure:
    """Measured and simulated output (n,) over time t (n,) [s], below them an error (n,); output, left: labels of both.
    shaded: time [s] of the first samples, which the start was fitted to."""
    with figure_style():
        figure = Figure(figsize=(WIDTH, 4.4), layout="constrained")
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        for signal, label, style in zip(signals, ("measured", "simulated"), ("-", "--"), strict=True):
            i = decimation(signal)
            upper.plot(t[i], signal[i], style, lw=0.9, label=label)
        upper.set_ylabel(output)
        upper.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, borderaxespad=0.2)
        i = decimation(error)
        lower.plot(t[i], error[i], color=COLOURS[2])
        if shaded:
            lower.axvspan(t[0], t[0] + shaded, color=GREY, alpha=0.3, lw=0)
        lower.set_ylabel(left)
        lower.set_xlabel("time [s]" + (" (shaded: what the start is fitted to)" if shaded else ""))
        lower.margins(x=0)
    return figure
