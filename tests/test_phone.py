"""Reports and the browser page at the width of a phone: nothing is cut, and all text is legible."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import pmfid
from pmfid.report.figures import open_figure
from pmfid.report.html import write_report
from pmfid.report.page import Section
from pmfid.report.result import write_result
from tests.conftest import cart_run
from tests.service.chromium import chromium, tab

pytestmark = pytest.mark.usefixtures("without_judgement")

WIDTH = 390
#: Elements wider than their frame, and the size of the smallest text in a visible figure [px].
CUT = "[...document.querySelectorAll('figure, .table, .wide, main')].filter(e => e.scrollWidth > e.clientWidth).length"
SMALLEST = """Math.min(...[...document.querySelectorAll('figure svg text')].filter(e => e.getBoundingClientRect().width)
    .map(e => parseFloat(getComputedStyle(e).fontSize) * e.ownerSVGElement.clientWidth
        / e.ownerSVGElement.viewBox.baseVal.width))"""
#: Texts of a visible figure that its frame cuts.
OUTSIDE = """[...document.querySelectorAll('figure svg')].filter(e => e.clientWidth > 0).flatMap(frame =>
    [...frame.querySelectorAll('text')].filter(e => {
        const box = e.getBoundingClientRect(), edge = frame.getBoundingClientRect();
        return box.left < edge.left - 1 || box.right > edge.right + 1 }).map(e => e.textContent))"""


@pytest.fixture(scope="module")
def phone() -> Iterator[Any]:
    with chromium() as browser, tab(browser, width=WIDTH) as page:
        yield page


def side_by_side() -> Figure:
    with open_figure(3.2, 1, 3, sharey=True) as (figure, panels):
        for number, panel in enumerate(panels):
            panel.plot([0, 1], [1000.5 * number, 1.0], label=f"parameter {number} of a long name")
            panel.set_xlabel("viscous friction in N s/m")
        figure.legend(loc="outside upper center", ncols=5)
    return figure


def beside_an_axis() -> Figure:
    with open_figure(3.2) as (figure, (axes,)):
        for number in range(4):
            axes.plot([0, 1], [number, 1], label=f"record number {number}")
        axes.set_xlabel("restarted every [s]; last point: never (dotted: standstill; dashed: encoder alone)")
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=4, borderaxespad=0.2)
    return figure


def with_histogram() -> Figure:
    with open_figure(2.6, 1, 2, sharey=True, width_ratios=(4, 1)) as (figure, (axes, side)):
        axes.plot(np.sin(np.arange(100)))
        axes.set_ylabel("residual [N]")
        side.hist(np.sin(np.arange(100)), orientation="horizontal")
        side.set_xlabel("samples [-]")
    return figure


@pytest.mark.parametrize("draw", [side_by_side, beside_an_axis, with_histogram])
def test_a_figure_is_drawn_again_for_a_phone(phone: Any, tmp_path: Path, draw: Callable[[], Figure]) -> None:
    """A figure of full width was cut at 704 px of width, and its text was 5 px high if it fitted."""
    write_report(tmp_path / "report.html", "A figure", [Section("Figure", figure=draw)])
    phone.goto((tmp_path / "report.html").as_uri())
    assert phone.evaluate(CUT) == 0
    assert phone.evaluate(OUTSIDE) == []
    assert phone.evaluate(SMALLEST) >= 9


def result() -> pmfid.Result:
    run = cart_run(1, samples=1000)
    return pmfid.identify(run.u, run.counts, model=pmfid.Drive(2.0), dt=0.01, encoder=run.encoder, cutoff=20.0)


def test_a_report_of_a_machine_fits_a_phone(phone: Any, tmp_path: Path) -> None:
    write_result(tmp_path, result())
    phone.goto((tmp_path / "report.html").as_uri())
    phone.evaluate("document.querySelectorAll('details').forEach(part => part.open = true)")
    assert phone.evaluate(CUT) == 0
    assert phone.evaluate(OUTSIDE) == []
    labels = re.findall(r">(input[^<]*)<", (tmp_path / "report.html").read_text("utf-8"))
    assert set(labels) == {"input [N]"}
