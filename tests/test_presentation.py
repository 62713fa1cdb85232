"""The display of results in Python and in a notebook: lines, a table, a figure, numbers."""

from __future__ import annotations

import inspect
import re

import numpy as np
import pytest
from matplotlib.figure import Figure

import pmfid
from pmfid.presentation import Presentable
from tests.gallery import gallery

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


def test_the_gallery_has_all_of_them() -> None:
    assert tuple(gallery()) == KINDS
    public = {getattr(pmfid, name) for name in pmfid.__all__}
    shown = {cls for cls in public if inspect.isclass(cls) and issubclass(cls, Presentable)}
    there = tuple(type(one) for one in gallery().values())
    assert {cls.__name__ for cls in shown if not any(issubclass(kind, cls) for kind in there)} == {"TermSearch"}


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
