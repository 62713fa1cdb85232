"""Figures of estimates, signals, status and residuals, by matplotlib without pyplot and without shared state."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError
from pmfid.estimators.results import Track
from pmfid.status import Status
from pmfid.types import Flags, Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

MAX_POINTS = 2000
FIGURES_WIDTH = 9.0
#: Width of a figure [inch] on a phone, and number of points of a smooth curve, of a curve on a phone, and of
#: periods in a map.
FIGURES_PHONE = 4.5
FIGURES_POINTS = 800
#: Longest label of a legend with two columns, and longest line of the label of an axis on a phone.
FIGURES_LABEL = 18
FIGURES_LINE = 48

#: Colours of Okabe and Ito (2008) without yellow and black, which colour-blind readers can distinguish.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#56B4E9", "#CC79A7")
MAGENTA = "#CC0099"
GREY = "#777777"
#: An estimate with one of these bits is unreliable.
DOUBTFUL = Status.POOR_EXCITATION | Status.COMPENSATION_HELD
NO_ESTIMATE = Status.STARTING | Status.SETTLING

#: Keywords of matplotlib, each with its own type.
Style = dict[str, Any]
_STYLE: dict[Any, Any] = {  # the keys have a type with hundreds of literals
    "axes.axisbelow": True,
    "axes.edgecolor": GREY,
    "axes.grid": True,
    "axes.labelsize": 10,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 11,
    "font.size": 10,
    "grid.color": "#E4E4E4",
    "legend.frameon": False,
    "lines.linewidth": 1.3,
    "svg.fonttype": "none",  # text in a figure stays searchable text
    "svg.hashsalt": "pmfid",  # equal figures give equal bytes
}


@contextmanager
def figure_style() -> Iterator[None]:
    """Apply the style of all figures in place of the user's matplotlibrc."""
    import matplotlib
    from cycler import cycler

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE | {"axes.prop_cycle": cycler(color=COLOURS)})
        matplotlib.rcParams["text.parse_math"] = False  # a $ in a unit is no formula
        yield


@contextmanager
def open_figure(height: float, rows: int = 1, columns: int = 1, **subplots: Any) -> Iterator[tuple[Figure, list[Axes]]]:
    """Open a figure of `height` inches in the style of reports, with its panels row by row.

    `subplots` are arguments of `Figure.subplots`.
    """
    from matplotlib.figure import Figure

    with figure_style():
        figure = Figure(figsize=(FIGURES_WIDTH, height), layout="constrained")
        yield figure, list(figure.subplots(rows, columns, squeeze=False, **subplots).ravel())


def narrow_figure(figure: Figure) -> None:
    """Change a figure to the width of a phone, with panels of equal width below each other."""
    from matplotlib.gridspec import GridSpec

    height, panels = figure.get_figheight(), figure.axes
    grid = panels[0].get_gridspec()
    if grid is not None and grid.ncols > 1 and np.ptp(np.asarray(grid.get_width_ratios(), float)) == 0:
        shown = [panel for panel in panels if panel.get_visible() and panel.axison]
        height *= len(shown) / grid.nrows
        stack = GridSpec(len(shown), 1, figure=figure)
        for row, panel in enumerate(shown):
            panel.set_subplotspec(stack[row, 0])
            panel.tick_params(labelleft=True)
    for legend in (*figure.legends, *filter(None, (panel.get_legend() for panel in panels))):
        if legend.get_window_extent().width > 0.95 * FIGURES_PHONE * figure.dpi:
            labels = [text.get_text() for text in legend.get_texts()]
            handles = [handle for handle in legend.legend_handles if handle is not None]
            columns = 2 if max(map(len, labels)) <= FIGURES_LABEL else 1
            legend.remove()
            figure.legend(handles, labels, loc="outside upper center", ncols=columns)
            height += 0.2 * len(labels) / columns
    for panel in panels:
        panel.set_xlabel(fill(panel.get_xlabel(), FIGURES_LINE))
        for line in panel.lines:
            x, y = np.asarray(line.get_xydata(), float).T
            rows = np.union1d(decimation(y, FIGURES_POINTS), np.flatnonzero(np.isnan(y)))
            line.set_data(x[rows], y[rows])
    figure.set_size_inches(FIGURES_PHONE, height)


def plain_ticks(axis: Axis) -> None:
    """Set plain numbers at the ticks of a logarithmic axis. Call this function after the scale is set.

    Ticks outside this range would be formulas, which `figure_style` does not typeset.
    """
    from matplotlib.ticker import NullFormatter

    axis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.set_minor_formatter(NullFormatter())


def save_png(figure: Figure, path: Path, width: int = 1200) -> None:
    """Write the figure as PNG, `width` pixels wide. Raises OSError if the file cannot be written."""
    with figure_style():
        figure.savefig(path, format="png", dpi=width / figure.get_figwidth(), metadata={"Software": None})


def decimation(y: ArrayLike, limit: int = MAX_POINTS) -> NDArray[np.int64]:
    """Return rising indices of at most `limit` (>= 4) samples of y (n,), for the ends and the extremes of equal parts.

    A record of at most `limit` samples keeps all its samples. Samples that are not finite are never extremes.
    """
    y = np.asarray(y, float)
    if y.size <= limit:
        return np.arange(y.size)
    edges = np.linspace(0, y.size, limit // 2).astype(np.int64)
    low, high = np.where(np.isfinite(y), y, np.inf), np.where(np.isfinite(y), y, -np.inf)
    parts = list(pairwise(edges))
    extremes = [a + low[a:b].argmin() for a, b in parts] + [a + high[a:b].argmax() for a, b in parts]
    return np.unique(np.array([0, *extremes, y.size - 1], np.int64))


def stretches(t: ArrayLike, flags: Flags) -> list[tuple[float, float]]:
    """Return start and length [s] of the stretches in which flags (n,) are set, at most MAX_POINTS / 2 stretches.

    In a long record, a group of neighbouring samples counts as set if one of its samples is set.
    """
    t = np.asarray(t, float)
    starts = np.arange(0, t.size, -(-t.size // MAX_POINTS))
    grouped = np.logical_or.reduceat(flags, starts)
    change = np.flatnonzero(np.diff(np.r_[False, grouped, False].astype(np.int8)))
    edges = np.r_[t[starts], _end(t)][change]
    return [(float(a), float(b - a)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def estimate_figure(t: ArrayLike, track: Track, nominal: Mapping[str, ArrayLike] | None = None) -> Figure:
    """Draw estimate, +-2 standard deviations and nominal value of each physical parameter over time t (n,) [s].

    `nominal` has a value, or (n,) values, for each parameter name. Poor excitation and held compensation are shaded.
    Raises UsageError if t and the track differ in length.
    """
    values = {name: np.asarray(value, float) for name, value in (nominal or {}).items()}
    over_time = {f"nominal {name}": value for name, value in values.items() if value.ndim}
    t = _time(t, {"track": track.status, **over_time})
    names = [name for name in track.names if not name.startswith("prefilter_")]
    with open_figure(0.9 + 1.9 * len(names), len(names), sharex=True) as (figure, panels):
        for name, axes in zip(names, panels, strict=True):
            _estimate_panel(axes, t, track, name, values.get(name))
        _finish_time(panels[-1], t)
        _legend(figure, panels)
    return figure


def _estimate_panel(axes: Axes, t: Floats, track: Track, name: str, nominal: Floats | None) -> None:
    known = np.where(track.has_status(Status.STARTING), np.nan, track[name])
    low, high = draw_estimate(axes, t, known, track.theta_std[:, track.names.index(name)])
    if nominal is not None:
        _line(axes, t, np.broadcast_to(nominal, t.shape), color=MAGENTA, ls="--", label="nominal")
    _shade(axes, stretches(t, track.has_status(DOUBTFUL)))
    axes.set_ylabel(_label(name, track.units[track.names.index(name)]))
    _robust_limits(axes, [_select_settled(track, low), _select_settled(track, high)], nominal)


def draw_estimate(axes: Axes, t: Floats, theta: Floats, std: Floats) -> tuple[Floats, Floats]:
    """Draw an estimate (n,) with a band of two standard errors (n,) over time t (n,), and return the ends of the band.

    An infinite standard error has no band.
    """
    low, high = theta - 2 * std, theta + 2 * std
    i = np.union1d(decimation(low, MAX_POINTS // 2), decimation(high, MAX_POINTS // 2))
    shown = np.isfinite(std[i])
    _line(axes, t, theta, color=COLOURS[0], label="estimate")
    axes.fill_between(t[i], low[i], high[i], where=shown, color=COLOURS[0], alpha=0.25, lw=0, zorder=1, label="±2 std")
    return low, high


def _shade(axes: Axes, spans: list[tuple[float, float]]) -> None:
    if spans:
        style: Style = {
            "color": COLOURS[3],
            "alpha": 0.25,
            "lw": 0,
            "label": "poor excitation or compensation held",
        }
        axes.broken_barh(spans, (0, 1), transform=axes.get_xaxis_transform(), **style)


def signals_figure(
    t: ArrayLike,
    u: ArrayLike,
    velocity: ArrayLike,
    *,
    input_unit: str = "unit of u",
    velocity_unit: str = "m/s",
) -> Figure:
    """Draw input and velocity over time, each (n,). Raises UsageError if the lengths differ."""
    t = _time(t, {"u": u, "velocity": velocity})
    with open_figure(0.9 + 1.7 * 2, 2, sharex=True) as (figure, panels):
        signals = ((u, "input", input_unit), (velocity, "velocity", velocity_unit))
        for axes, (signal, name, unit) in zip(panels, signals, strict=True):
            _line(axes, t, np.asarray(signal, float), lw=0.8)
            axes.set_ylabel(_label(name, unit))
        _finish_time(panels[-1], t)
    return figure


def status_figure(t: ArrayLike, status: ArrayLike) -> Figure:
    """Draw the times at which each occurring status bit was set, with one row for each bit.

    The time t is (n,) [s], and `status` (n,) has bits of `Status`. Raises UsageError if the lengths differ.
    """
    t, bits = _time(t, {"status": status}), np.asarray(status)
    occurring = [bit for bit in Status if np.any(bits & bit)]
    with open_figure(0.8 + 0.3 * max(1, len(occurring))) as (figure, (axes,)):
        for row, bit in enumerate(occurring):
            colour = COLOURS[1] if bit in DOUBTFUL else COLOURS[0]
            axes.broken_barh(stretches(t, (bits & bit) != 0), (row - 0.35, 0.7), color=colour, lw=1.5)
        names = [_words(bit.name or "").lower() for bit in occurring]
        axes.set_yticks(range(max(1, len(occurring))), names or ["no bit was set"])
        axes.set_ylim(max(1, len(occurring)) - 0.5, -0.5)
        axes.grid(axis="y", visible=False)
        _finish_time(axes, t)
    return figure


def residual_figure(t: ArrayLike, residual: ArrayLike, *, unit: str = "N") -> Figure:
    """Draw the residual (n,) over time t (n,) [s], and its histogram. Raises UsageError if the lengths differ."""
    t, e = _time(t, {"residual": residual}), np.asarray(residual, float)
    with open_figure(2.6, 1, 2, sharey=True, width_ratios=(4, 1)) as (figure, (axes, side)):
        _line(axes, t, e, lw=0.8)
        counts, edges = np.histogram(e[np.isfinite(e)], bins=40)
        side.stairs(counts, edges, orientation="horizontal", fill=True, color=COLOURS[0])
        side.set_xlabel("samples [-]")
        axes.set_ylabel(_label("residual", unit))
        _finish_time(axes, t)
    return figure


def followed_figure(t: Floats, measured: Floats, simulated: Floats, unit: str, read: float = 0.0) -> Figure:
    """Draw a measured and a simulated output (n,) over time t (n,) [s], with their difference below.

    The start of the simulation was fitted to the first `read` seconds, which are shaded.
    """
    label = f" [{unit}]" if unit else ""
    with open_figure(4.4, 2, sharex=True, height_ratios=(3, 2)) as (figure, (upper, lower)):
        for signal, name, style in ((measured, "measured", "-"), (simulated, "simulated", "--")):
            i = decimation(signal)
            upper.plot(t[i], signal[i], style, lw=0.9, label=name)
        upper.set_ylabel(f"output{label}")
        upper.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, borderaxespad=0.2)
        i = decimation(measured - simulated)
        lower.plot(t[i], (measured - simulated)[i], color=COLOURS[2])
        if read:
            lower.axvspan(t[0], t[0] + read, color=GREY, alpha=0.3, lw=0)
        lower.set_ylabel(f"measured\nless simulated{label}")
        lower.set_xlabel("time [s]" + (" (the fit of the start uses the shaded part)" if read else ""))
        lower.margins(x=0)
    return figure


def _time(t: ArrayLike, others: Mapping[str, ArrayLike]) -> Floats:
    time = np.asarray(t, float)
    if time.ndim != 1 or time.size == 0:
        raise UsageError(f"t must have shape (n,), n >= 1, got {time.shape}; give one time per sample")
    for name, values in others.items():
        if np.shape(values) != time.shape:
            raise UsageError(
                f"{name} must have the shape of t, {time.shape}, got {np.shape(values)}; give one value per time"
            )
    return time


def _end(t: Floats) -> float:
    """Return the end of the last sample, one period after its beginning."""
    return float(t[-1] + (t[-1] - t[0]) / max(1, t.size - 1))


def _line(axes: Axes, t: Floats, y: Floats, **style: Any) -> None:
    i = decimation(y)
    axes.plot(t[i], y[i], **style)


def _select_settled(track: Track, y: Floats) -> Floats:
    """Return the finite values of y (n,) after the start-up.

    The first tenth is left out if other values remain.
    """
    usable = np.isfinite(y) & ~track.has_status(NO_ESTIMATE)
    late = usable & (np.arange(y.size) >= y.size // 10)
    return y[late if late.any() else usable]


def _robust_limits(axes: Axes, settled: list[Floats], reference: Floats | None) -> None:
    parts = [np.percentile(part, (1, 99)) for part in settled if part.size]
    if reference is not None:
        parts.append(np.array([reference.min(), reference.max()]))
    if parts:
        low, high = float(np.min(parts)), float(np.max(parts))
        margin = 0.08 * (high - low) or 0.05 * abs(high) or 1.0
        axes.set_ylim(low - margin, high + margin)


def _finish_time(axes: Axes, t: Floats) -> None:
    axes.set_xlabel("time [s]")
    if t[-1] > t[0]:
        axes.set_xlim(float(t[0]), _end(t))


def _legend(figure: Figure, panels: list[Axes]) -> None:
    """Draw one legend above all panels, with each label once."""
    entries = {
        label: handle for axes in panels for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(list(entries.values()), list(entries), loc="outside upper center", ncols=min(5, len(entries)))


def _words(name: str) -> str:
    return name.replace("_", " ").replace("coulomb", "Coulomb")


def _label(name: str, unit: str) -> str:
    return f"{_words(name)} [{unit}]"
