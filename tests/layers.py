"""The picture of the layers in ARCHITECTURE.md, from the imports: `python -m tests.layers` writes it."""

from __future__ import annotations

from graphlib import TopologicalSorter
from pathlib import Path

from tests.test_architecture import PACKAGE, REPOSITORY, room_of, rooms_imported, source_files

PAGE = REPOSITORY / "ARCHITECTURE.md"
START, END = "```mermaid\n", "```\n"


def packages(root: Path = PACKAGE) -> dict[str, set[str]]:
    """Return the packages that each package imports, at any depth. Single modules are left out."""
    folders = {path.parent.name for path in root.glob("*/__init__.py")}
    graph: dict[str, set[str]] = {name: set() for name in sorted(folders)}
    for path in source_files(root):
        room = room_of(path.relative_to(root).with_suffix("").parts)
        if room in graph:
            graph[room] |= {imported for _, imported in rooms_imported(path, root)} & folders - {room}
    return graph


def reduced(graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return the graph without the arrows that follow from two others."""
    below: dict[str, set[str]] = {}
    for name in TopologicalSorter(graph).static_order():
        below[name] = graph[name].union(*(below[other] for other in graph[name]))
    return {name: own - set().union(*(below[other] for other in own)) for name, own in graph.items()}


def picture(graph: dict[str, set[str]]) -> str:
    """Return the arrows in Mermaid, sorted by name."""
    arrows = [f"    {name} --> {other}\n" for name in sorted(graph) for other in sorted(graph[name])]
    return "".join([START, "flowchart TD\n", *arrows, END])


def page_with(text: str, drawn: str) -> str:
    """Return the text of a page with the drawn picture in place of its picture."""
    before, _, rest = text.partition(START)
    return before + drawn + rest.partition(END)[2]


if __name__ == "__main__":
    PAGE.write_text(page_with(PAGE.read_text(encoding="utf-8"), picture(reduced(packages()))), encoding="utf-8")
