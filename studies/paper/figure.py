"""The interface of a figure of the paper to the program that reproduces it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from studies.paper.merit import Merit

#: The arguments of one work, and the results by task; the figure's own `rows` knows their types.
Task = tuple[Any, ...]
Results = Mapping[Task, Any]


@dataclass(frozen=True)
class PaperFigure:
    """A figure of the paper.

    `name` is its name on the command line, and `caption` describes it. `tasks` returns the tasks for a number of seeds,
    and `work` computes one of them in a separate process. `rows` returns the rows of the table from the results by
    task. `draw` writes the pictures and their data into a folder, and returns the paths.
    """

    name: str
    caption: str
    tasks: Callable[[int], list[Task]]
    work: Callable[..., object]
    rows: Callable[[Results], list[Merit]]
    draw: Callable[[Path], Sequence[Path]]
