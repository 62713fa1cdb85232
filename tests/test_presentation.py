"""The display of results in Python and in a notebook: lines, a table, a figure, numbers."""

from __future__ import annotations

import inspect
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import matplotlib
import numpy as np
import polars as pl
import pytest
from matplotlib.figure import Figure

import pmfid
from pmfid.findings import Finding
from pmfid.presentation import Presentable, Summary
from pmfid.report.html import svg
from tests.gallery import gallery
from tests.refusals import refused
from tests.test_architecture import modules_after

#: Objects with parameters by name, and all objects.
NAMED = ("drive", "drive, on-line", "drive, mass given", "process", "fit", "track", "tracks", "estimate", "posterior")
KINDS = (
    *NAMED,
    "curve",
    "validation",
    "validation of two",
    "experiment",
    "transfer function",
    "monitor",
    "design",
    "appraisal",
)
HOSTILE = "<script>alert(1)</script>\x1b[2J\n$x$.csv"


class Text(HTMLParser):
    """The tags and the text of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.text = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.tags.append(tag)

    def handle_data(self, data: str) -> None:
        self.text += data


def test_the_gallery_has_all_of_them() -> None:
    assert tuple(gallery()) == KINDS
    public = {getattr(pmfid, name) for name in pmfid.__all__}
    shown = {cls for cls in public if inspect.isclass(cls) and issubclass(cls, Presentable)}
    there = tuple(type(one) for one in gallery().values())
    assert {cls.__name__ for cls in shown if not any(issubclass(kind, cls) for kind in there)} == {"TermSearch"}


@pytest.mark.parametrize("kind", KINDS)
def test_a_person_reads_a_few_lines_a_notebook_a_table_and_a_program_numbers(kind: str) -> None:
    one = gallery()[kind]
    text, html, content, frame = repr(one), one._repr_html_(), one.to_dict(), one.to_frame()
    assert 2 <= len(text.splitlines()) <= 9
    assert max(map(len, text.splitlines())) < 120
    assert not re.search(r"array\(|object at|\(\w+=", text)
    page = Text(html)
    assert set(page.tags) <= {"div", "p", "b", "table", "tr", "th", "td"}
    assert page.tags.count("tr") == 1 + len(one.summary().rows)
    cells = page.tags.count("th") + page.tags.count("td")
    assert html.count("padding: 0.1em 1em") == cells  # this padding alone keeps the columns apart
    assert one.summary().title in page.text
    assert json.loads(json.dumps(content, allow_nan=False)) == content
    assert isinstance(frame, pl.DataFrame)
    assert frame.height > 0


@pytest.mark.parametrize("kind", NAMED)
def test_parameters_have_a_value_a_bar_and_a_unit(kind: str) -> None:
    one = gallery()[kind]
    lines = repr(one).splitlines()[1 : 1 + len(one.names)]  # type: ignore[union-attr]
    for line, name, unit in zip(lines, one.names, one.units, strict=True):  # type: ignore[union-attr]
        assert re.match(rf"  {name} (= )?[-\d.e]+ .*{re.escape(unit)}", line)
        assert " ± " in line or " to " in line
        number = float(line.split()[2 if "=" in line else 1])
        assert number == pytest.approx(np.median(np.atleast_2d(one[name])[:, -1]), rel=1e-5)  # type: ignore[index]


@pytest.mark.parametrize("kind", KINDS)
def test_a_figure_says_what_is_on_its_axes(kind: str) -> None:
    figure = gallery()[kind].plot()
    assert isinstance(figure, Figure)
    assert "pyplot" not in getattr(figure.canvas.manager, "__module__", "")
    lowest = figure.axes[-1].get_xlabel() or figure.get_supxlabel()
    assert lowest
    assert figure.axes[0].get_ylabel() or figure.axes[0].get_yticklabels()[0].get_text()


def test_frames_hold_the_values() -> None:
    shown = gallery()
    drive, track, curve = shown["drive"], shown["track"], shown["curve"]
    assert drive.to_frame()["value"].to_list() == drive.theta.tolist()  # type: ignore[union-attr]
    assert track.to_frame()["mass"].to_list() == track["mass"].tolist()  # type: ignore[index]
    assert curve.to_frame()["force"].to_list() == curve.force.tolist()  # type: ignore[union-attr]
    fleet = shown["tracks"].to_frame().filter(pl.col("axis") == 2)
    assert fleet["mass"].to_list() == shown["tracks"]["mass"][2].tolist()  # type: ignore[index]


def test_an_estimate_says_its_status_in_words_and_none_for_what_is_not_known() -> None:
    estimate = gallery()["estimate"]
    assert isinstance(estimate, pmfid.Estimate)
    assert estimate.status_names == ("count_jump",)
    assert repr(estimate).splitlines()[-1] == "status: count_jump"
    assert estimate.to_dict()["status"] == ["count_jump"]
    start = pmfid.RLS(pmfid.Drive(1.0), pmfid.Encoder(1e-5), 0.01, 30.0).step(0.0, 0)
    content = start.to_dict()["parameters"]
    assert content["mass"] == {"value": 0.0, "std": None, "unit": ""}  # type: ignore[index]
    assert "mass = 0 ± inf" in repr(start)


def test_hostile_names_are_text() -> None:
    experiment = replace(gallery()["experiment"], name=HOSTILE)  # type: ignore[type-var]
    drive = gallery()["drive"]
    result = replace(drive, record=replace(drive.record, name=HOSTILE), findings=(Finding("hostile", HOSTILE),))  # type: ignore[type-var, union-attr]
    for one in (experiment, result):
        page = Text(one._repr_html_())
        assert "script" not in page.tags
        assert "<script>alert(1)</script>\\x1b" in page.text
        assert "\x1b" not in repr(one) + one._repr_html_()
        assert repr(one).splitlines()[0].startswith("<script>")
    assert "$x$.csv" in repr(result).splitlines()[0]


def test_long_lists_and_notes_are_cut_with_a_word() -> None:
    text = Summary("title", ("a",), [(str(k),) for k in range(20)], (), ["word " * 100] * 5).text.splitlines()
    assert len(text) == 14
    assert text[9] == "  ... and 12 more"
    assert text[10].endswith("word ...")
    assert text[13] == "... and 2 more notes"


def test_figures_take_times_and_nominal_values() -> None:
    track = gallery()["track"]
    figure = track.plot(t=0.01 * np.arange(1200), nominal={"mass": 1.07})
    assert figure.axes[-1].get_xlabel() == "time [s]"
    assert {text.get_text() for legend in figure.legends for text in legend.get_texts()} >= {"estimate", "nominal"}
    assert track.plot().axes[-1].get_xlabel() == "sample [-]"
    refused((r"the figure of Track has no such option .*'colour'", lambda: track.plot(colour="red")))


def test_what_cannot_be_simulated_has_a_figure_too() -> None:
    drive, process = gallery()["drive"], gallery()["process"]
    nonsense = replace(drive, theta=-drive.theta)  # type: ignore[type-var, union-attr]
    assert [axes.get_ylabel() for axes in nonsense.plot().axes] == ["input [N]", "velocity [m/s]"]
    unstable = replace(process, process=replace(process.process, a=np.array([-1.0])))  # type: ignore[type-var, union-attr]
    assert "fit unknown, unstable" in repr(unstable)
    assert [axes.get_ylabel() for axes in unstable.plot().axes] == ["magnitude [dB]", "phase [degrees]"]


def test_a_figure_has_the_style_of_the_report_whatever_the_user_has_set() -> None:
    with matplotlib.rc_context({"text.usetex": True, "axes.facecolor": "black"}):
        text = svg(gallery()["estimate"].plot())
    assert "Coulomb friction" in text


def test_results_load_no_library_of_figures_or_tables_until_asked() -> None:
    loaded = {name.partition(".")[0] for name in modules_after("import pmfid._estimate, pmfid.presentation")}
    assert "numpy" in loaded
    assert {"matplotlib", "polars"} & loaded == set()
