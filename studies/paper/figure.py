"""What a figure of the paper is to the program that reproduces it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from studies.paper.merit import Merit

#: The arguments of one work, and what each of them gave: the figure's own `rows` knows what that is.
Task = tuple[Any, ...]
Results = Mapping[Task, Any]


@dataclass(frozen=True)
class PaperFigure:
    """name: as on the command line; caption: what it shows.

    tasks: what is to be computed with N seeds; work: one of them, in a process of its own; rows: of the table,
    from the results by task; draw: the pictures and their data in a folder, returns what it has written.
    """

    name: str
    caption: str
    tasks: Callable[[int], list[Task]]
    work: Callable[..., object]
    rows: Callable[[Results], list[Merit]]
    draw: Callable[[Path], Sequence[Path]]
