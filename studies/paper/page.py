"""The reproduced figures as sections of a page: caption, pictures, tables, and a text on the numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from studies.paper.encoders import without_encoder
from studies.paper.figure5 import settle_time
from studies.paper.merit import HEADER, Merit, cells
from studies.paper.run import FIGURES
from studies.paper.truth import table

PICTURES: Mapping[str, tuple[str, ...]] = {
    "2": ("figure2",),
    "3": ("figure3", "figure3-methods"),
    "4": ("figure4", "figure4-methods"),
    "5": ("figure5", "figure5-methods", "figure5-inputs"),
    "encoders": (),
}


def sections(rows: Sequence[Merit], images: str) -> list[str]:
    """Return the lines of all figures that have rows; `images` is the relative folder of the pictures."""
    lines = []
    for name in PICTURES:
        mine = [row for row in rows if row.figure == name]
        if mine:
            title = f"Figure {name}" if name.isdigit() else name.capitalize()
            lines += [f"### {title}", "", FIGURES[name].caption, ""]
            lines += [line for picture in PICTURES[name] for line in (f"![{picture}]({images}/{picture}.png)", "")]
            lines += _TABLES[name](mine)
    return lines


def _by_encoder(rows: Sequence[Merit]) -> list[str]:
    """Return one table for each condition: bias ± std and coverage of the mass [%], by method and encoder."""
    lines = []
    for condition in dict.fromkeys(row.condition for row in rows):
        mine = [row for row in rows if row.condition == condition]
        encoders = list(dict.fromkeys(row.increments for row in mine))
        header = [condition, *(f"{n} increments" for n in encoders)]
        at = {(row.method, row.increments): row for row in mine}
        methods = list(dict.fromkeys(row.method for row in mine))
        lines += table(header, [[f"`{m}`", *(_cell(at[m, n]) for n in encoders)] for m in methods])
        lines += _settled(at, methods, encoders)
    return lines


def _cell(row: Merit) -> str:
    if math.isnan(row.bias):
        return "no answer"
    refused = f", {row.refused} without answer" if row.refused else ""
    return f"{row.bias:+.2f} ± {row.std:.2f} ({row.coverage:.0f}){refused}"


def _settled(at: Mapping[tuple[str, int], Merit], methods: Sequence[str], encoders: Sequence[int]) -> list[str]:
    if all(math.isnan(row.settled) for row in at.values()):
        return []
    column = HEADER.index("settled [s]")
    rows = [[f"`{m}`", *(cells(at[m, n])[column] for n in encoders)] for m in methods]
    return table(["within 5 % after [s]", *(f"{n} increments" for n in encoders)], rows)


def _plain(rows: Sequence[Merit]) -> list[str]:
    """Return the rows without the columns that no row fills."""
    texts = [cells(row)[1:] for row in rows]
    kept = [i for i in range(len(HEADER) - 1) if any(row[i] not in ("–", "0") for row in texts)]
    return table([HEADER[1 + i] for i in kept], [[row[i] for i in kept] for row in texts])


def _three(rows: Sequence[Merit]) -> list[str]:
    open_loop = "Bias ± standard deviation of the mass in percent, in brackets the coverage of the 95 % intervals."
    return [open_loop, "", *_by_encoder(rows)]


def _five(rows: Sequence[Merit]) -> list[str]:
    at = {(row.condition, row.method): row for row in rows}
    pulses, designed, train = (at[name, "rls"] for name in ("pulses", "designed", "pulse train"))
    verdict = _verdict(designed.settled <= 0.5 * pulses.settled)
    return [
        *_plain(rows),
        f"Check, the designed input brings RLS to 2 % in at most half the time of the pulses: {verdict}, "
        f"{designed.settled:.2f} s against {pulses.settled:.2f} s with one pulse per stroke. A train of four pulses "
        f"takes {train.settled:.2f} s. No input can do it before {settle_time():.2f} s, when the filters have settled.",
        "",
        f"Of the information on the mass with friction known, the single pulse has {pulses.information:.3g} 1/kg², the "
        f"design {designed.information:.3g}, the train {train.information:.3g}. After its pulse the cart stands still: "
        "the place where it stopped is read again and again. The design is not allowed to count on that, and RLS makes "
        "nothing of a standing axis.",
        "",
    ]


def _verdict(met: bool) -> str:
    return "met" if met else "**not met**"


#: Scenario, method, encoders, and largest allowed bias of the mass [%].
GOALS: tuple[tuple[str, str, tuple[int, ...], float], ...] = (
    ("prbs", "bcrls", (4096, 1024, 512, 256), 0.5),
    ("prbs", "iv", (4096, 1024, 512, 256), 0.5),
    ("stop-and-go", "bcrls", (4096, 1024, 512, 256), 0.5),
    *(("stop-and-go", method, (4096, 1024, 512, 256), 0.5) for method in ("iv", "riv", "auto")),
    *(("stop-and-go", method, (64,), 1.0) for method in ("iv", "riv", "auto")),
)


def _encoders(rows: Sequence[Merit]) -> list[str]:
    at = {(row.condition, row.method, row.increments): row for row in rows}
    lines = [*_three(rows), "Largest bias of the mass against what is asked:", ""]
    for scenario, method, encoders, limit in GOALS:
        worst = max((at[scenario, method, n] for n in encoders), key=lambda row: abs(row.bias))
        among = f"{encoders[0]} to {encoders[-1]}" if len(encoders) > 1 else str(encoders[0])
        verdict = _verdict(abs(worst.bias) < limit)
        lines.append(f"- {scenario}, {among} increments, `{method}`: {worst.bias:+.2f} %, asked {limit:g} %: {verdict}")
    return [*lines, "", _cause(without_encoder()), ""]


def _cause(fine: Mapping[str, float]) -> str:
    return (
        "Under stop-and-go control the paper's compensation alone does not do it, and the encoder is not the reason: "
        f"with 2^24 increments `rls` is {fine['rls']:+.2f} % off, `bcrls` {fine['bcrls']:+.2f} %, `iv` "
        f"{fine['iv']:+.2f} %. While the drive sticks, and where it stops or turns between two samples, the equation "
        "with sign(v) does not hold. What can do it are the methods that simulate the motion, stiction included: `iv`, "
        "`riv` and `auto`."
    )


_TABLES: Mapping[str, Callable[[Sequence[Merit]], list[str]]] = {
    "2": _plain,
    "3": _three,
    "4": _three,
    "5": _five,
    "encoders": _encoders,
}
