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
from PIL import Image

from pmfid import Drive, Encoder, identify
from pmfid.errors import UsageError
from pmfid.estimators.results import Track
from pmfid.pipeline.result import format_short, format_value
from pmfid.report.design import ellipse_figure
from pmfid.report.figures import (
    DOUBTFUL,
    comparison_figure,
    decimation,
    estimate_figure,
    residual_figure,
    save_png,
    signals_figure,
    status_figure,
)
from pmfid.report.html import Section, svg, write_report
from pmfid.report.result import write_result
from pmfid.report.tuning import TUNING
from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, quantize, simulate_drive
from pmfid.status import Status
from tests.refusals import refused

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
    "comparison": lambda: comparison_figure(T, {"RLS": {"512": TRACK}, "BCRLS": {"512": TRACK}}, "mass", TRUTH),
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


def test_the_limits_show_the_settled_part_and_the_nominal_value() -> None:
    for name in ("estimate", "comparison"):
        low, high = FIGURES[name]().axes[0].get_ylim()
        assert 0.8 < low < 0.98
        assert 1.07 < high < 1.6


def test_doubtful_samples_are_shaded() -> None:
    def shaded(track: Track) -> bool:
        return "poor excitation or compensation held" in svg(estimate_figure(T, track))

    assert shaded(TRACK)
    assert not shaded(replace(TRACK, status=TRACK.status & ~np.uint32(DOUBTFUL)))


def test_without_an_estimate_there_is_a_figure_still() -> None:
    nothing = replace(TRACK, status=np.full(N, Status.STARTING, np.uint32), innovation_variance=np.zeros(N))
    assert "mass [kg]" in svg(estimate_figure(T, nothing))
    assert ellipse_figure(("mass",), np.ones(1), {}) is None  # one parameter has no pair


@pytest.mark.parametrize("n", [1, 5, TUNING.max_points, TUNING.max_points + 1, 9973, 300_000])
def test_decimation_keeps_the_extremes_and_the_ends(n: int) -> None:
    y = np.random.default_rng(n).standard_normal(n)
    i = decimation(y)
    assert i.size == min(n, i.size) <= TUNING.max_points
    assert (np.diff(i) > 0).all()
    assert (i[0], i[-1]) == (0, n - 1)
    assert (y[i].min(), y[i].max()) == (y.min(), y.max())


def test_a_long_record_stays_small() -> None:
    n = 200_000
    t, track = np.arange(n) * 1e-3, make_track(n)
    assert len(svg(estimate_figure(t, track, {"mass": 1.0}))) < 500_000
    assert len(svg(signals_figure(t, track["mass"], track["mass"]))) < 300_000


def test_wrong_lengths_are_named() -> None:
    refused(
        (r"u must have the shape of t, \(600,\), got \(3,\)", lambda: signals_figure(T, [1, 2, 3], np.cos(T))),
        (
            r"BCRLS, 512 must have the shape of t",
            lambda: comparison_figure(T, {"RLS": {"512": TRACK}, "BCRLS": {"512": make_track(500)}}, "mass", TRUTH),
        ),
    )
    refused(
        ("nominal mass must have the shape", lambda: estimate_figure(T, TRACK, {"mass": TRUTH[1:]})),
        (r"t must have shape \(n,\)", lambda: status_figure([], [])),
    )


def test_png_has_the_width_asked_for(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        save_png(FIGURES["signals"](), tmp_path / name, width=1200)
    with Image.open(tmp_path / "a.png") as image:
        assert image.size[0] == 1200
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def report(path: Path, title: str = "Title") -> str:
    sections = [
        Section(
            "First", "One.\n\nTwo.", (("name", "value"), (("mass", 1.0 / 3.0), ("never", 12))), svg(FIGURES["status"]())
        ),
        Section("Second", svg=svg(FIGURES["status"]())),
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


def test_a_short_row_is_named() -> None:
    with pytest.raises(UsageError, match="row 2 of the table 'Errors' has 1 cells, the header 2"):
        Section("Errors", table=(("a", "b"), ((1, 2), (3,))))


def test_a_number_has_the_digits_of_its_standard_error() -> None:
    assert [format_value(*pair) for pair in ((0.62, 6.1e-5), (9.00871, 0.12), (120.0, 3.0), (2.5e-6, 0.0))] == [
        "0.620000", "9.01", "120.0", "2.5e-06"
    ]  # fmt: skip
    assert format_short(3.20012e-4, 5.1e-8) == "0.000320012(51)"
    assert format_short(2.97251e-6, 1.6e-10) == "2.97251(16)e-06"
    assert format_short(1234.5, 20.0) == "1234(20)"


def test_a_rotary_axis_has_no_metre(tmp_path: Path) -> None:
    u = prbs(1500, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    model = Drive(CART.input_gain, axis="rotary")
    result = identify(u, counts, model=model, dt=CART_DT, encoder=Encoder(CART_RESOLUTION), cutoff=20.0, method="iv")
    write_result(tmp_path, result)
    html = re.sub(
        r"<svg.*?</svg>", lambda found: " ".join(re.findall(r">([^<]+)<", found[0])), _read(tmp_path), flags=re.S
    )
    assert "inertia" in html
    assert "kg m2" in html
    assert (
        re.findall(r"(?<!N) m(?:/s)?[\]. ,]|\[N\]|N s/m|mass", re.sub(r"<[^>]+>", " ", html.partition("<body>")[2]))
        == []
    )


def _read(folder: Path) -> str:
    return (folder / "report.html").read_text(encoding="utf-8")
