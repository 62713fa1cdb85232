"""Figures and the report: units, decimation, self-contained and the same bytes each time."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

from pmfid.estimators.results import Track
from pmfid.report.figures import (
    MAX_POINTS,
    decimation,
    estimate_figure,
    residual_figure,
    signals_figure,
    status_figure,
)
from pmfid.report.html import svg, write_report
from pmfid.report.page import Section
from pmfid.status import Status

N = 600
T = np.arange(N) * 0.01
TRUTH = np.where(T < 3, 1.07, 1.44)


def make_track(n: int = N) -> Track:
    """Return a track with a start without estimate, wild values, then mass 1 kg and viscous friction 10 N s/m, held
    for 1 s.
    """
    rng = np.random.default_rng(1)
    theta = np.array([1.0, 10.0, 0.5]) * (1 + 0.01 * rng.standard_normal((n, 3)))
    theta[20:50] *= 1e4
    status = np.zeros(n, np.uint32)
    status[:20] = Status.STARTING | Status.SETTLING
    status[300:400] = Status.COMPENSATION_HELD
    variance = np.where(np.arange(n) < 20, 0.0, 1.0)
    names, units = ("mass", "viscous_friction", "prefilter_1"), ("kg", "N s/m", "s^1")
    return Track(names, units, theta, np.full((n, 3), 1e-4), np.zeros((n, 3)), np.zeros(n), variance, status)


TRACK = make_track()
FIGURES = {
    "estimate": lambda: estimate_figure(T, TRACK, {"mass": 1.07, "viscous_friction": TRUTH}),
    "signals": lambda: signals_figure(T, np.sin(T), np.cos(T), input_unit="V"),
    "status": lambda: status_figure(T, TRACK.status),
    "residual": lambda: residual_figure(T, np.sin(T)),
}


def labels_of(figure: Figure) -> list[str]:
    return [label for axes in figure.axes for label in (axes.get_xlabel(), axes.get_ylabel()) if label]


@pytest.mark.parametrize("name", FIGURES)
def test_every_axis_label_has_its_unit(name: str) -> None:
    figure = FIGURES[name]()
    labels = labels_of(figure)
    assert "time [s]" in labels
    assert all(re.fullmatch(r".+ \[.+\]", label) for label in labels)
    panels = [axes for axes in figure.axes if name not in ("status", "residual")]
    assert all(axes.get_ylabel() for axes in panels)
    assert all(label in svg(figure) for label in labels)


def test_without_an_estimate_there_is_a_figure_still() -> None:
    nothing = replace(TRACK, status=np.full(N, Status.STARTING, np.uint32), innovation_variance=np.zeros(N))
    assert "mass [kg]" in svg(estimate_figure(T, nothing))


@pytest.mark.parametrize("n", [1, 5, MAX_POINTS, MAX_POINTS + 1, 9973, 300_000])
def test_decimation_keeps_the_extremes_and_the_ends(n: int) -> None:
    y = np.random.default_rng(n).standard_normal(n)
    i = decimation(y)
    assert i.size == min(n, i.size) <= MAX_POINTS
    assert (np.diff(i) > 0).all()
    assert (i[0], i[-1]) == (0, n - 1)
    assert (y[i].min(), y[i].max()) == (y.min(), y.max())


def report(path: Path, title: str = "Title") -> str:
    sections = [
        Section("First", "One.\n\nTwo.", (("name", "value"), (("mass", 1.0 / 3.0), ("never", 12))), FIGURES["status"]),
        Section("Second", figure=FIGURES["status"]),
    ]
    write_report(path, title, sections)
    return path.read_text("utf-8")


class Checker(HTMLParser):
    """A parser that counts the elements that may appear in a page only once or in pairs."""

    def __init__(self) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.ids += [value or "" for name, value in attributes if name == "id"]
        if tag not in ("meta", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.ids += [value or "" for name, value in attributes if name == "id"]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_report_is_self_contained_well_formed_and_the_same_each_time(tmp_path: Path) -> None:
    page, checker = report(tmp_path / "r.html"), Checker()
    for forbidden in ("http", "<script", "src=", "@import", "<link", "<iframe"):
        assert forbidden not in page
    assert set(re.findall(r"url\((.)", page)) <= {"#"}
    assert set(re.findall(r'href="(.)', page)) <= {"#"}
    checker.feed(page)
    assert checker.open == []
    assert len(set(checker.ids)) == len(checker.ids) > 0
    used = re.findall(r'(?:url\(|href=")#([^)"]+)', page)
    assert used
    assert set(used) <= set(checker.ids)
    with matplotlib.rc_context({"font.size": 20, "svg.hashsalt": None}):
        assert report(tmp_path / "b.html") == page


def test_text_is_escaped_and_numbers_stand_right(tmp_path: Path) -> None:
    evil = "<script>alert('x')</script> & co"
    page = report(tmp_path / "r.html", evil)
    assert evil not in page
    assert page.count("&lt;script&gt;alert(&#39;x&#39;)&lt;/script&gt; &amp; co") == 2
    section = Section(evil, evil, ((evil,), ((evil,),)))
    write_report(tmp_path / "s.html", "t", [section])
    assert "<script" not in (tmp_path / "s.html").read_text("utf-8")
    assert '<td class="number">0.3333</td>' in page
    assert '<td class="number">12</td>' in page
    assert "<td>mass</td>" in page
    assert page.count("<p>") == 2
