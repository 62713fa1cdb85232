"""Write the pages of all keys of AXIS.toml and PLANT.toml: `python -m docs.keys`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from pmfid.config.axis import Axis
from pmfid.config.explain import ReferenceEntry, entries
from pmfid.service.plant import plant_entries
from pmfid.service.web.config import HERE, PORT

REFERENCE = Path(__file__).parent / "reference"


AXIS_HEAD = """\
# All keys of AXIS.toml

Written by `python -m docs.keys`, from the models that validate the file. `pmfid explain KEY` explains one key,
`pmfid explain WORD` explains a word of a status. Units are SI; *unit of y* is the unit of `[encoder] resolution`.
Not every key is needed: `examples/cart.toml` has the keys of a usual axis.
"""
_KEYS = "| key | type | unit | default | meaning |\n|---|---|---|---|---|"
_STATUS = """\
## Words of a status

The words of `status` in the terminal, in JSON, in reports and in Python.

| word | of | meaning |
|---|---|---|"""
_ABOUT = {
    "service": "The service as a whole.",
    "page": f"Without this section the service shows its page on {HERE}:{PORT}.",
    "axes": "A section for each axis, `[axes.NAME]`.",
    "fleets": "A section for each group of axes with the same configuration, `[fleets.NAME]`.",
    "sources": 'A section for each source, `[sources.NAME]`, with `kind = "{kind}"`.',
    "sinks": 'A section for each sink, `[sinks.NAME]`, with `kind = "{kind}"`.',
}
PLANT_HEAD = """\
# All keys of PLANT.toml

`python -m docs.keys` writes this page from the models that validate the file. `pmfid explain KEY`
describes one key, for example `pmfid explain service.window`, or one kind, for example `pmfid explain sources.mqtt`.
What a plant is, and how to set one up: [service.md](../howto/service.md). The keys of an axis:
[axis_toml.md](axis_toml.md).
"""


def axis_page() -> str:
    """Return the page of all keys in Markdown."""
    known = entries()
    parts = tables([entry for entry in known if entry.kind], _describe_section)
    words = [f"| `{entry.name}` | {entry.what} | {entry.meaning} |" for entry in known if not entry.kind]
    return "\n".join([AXIS_HEAD, *parts, _STATUS, *words, ""])


def tables(known: Sequence[ReferenceEntry], about: Callable[[str], str]) -> list[str]:
    """Return a Markdown table of the keys for each section. `about` returns the text above the table of a section."""
    found = []
    for section in dict.fromkeys(entry.section for entry in known):
        rows = [entry for entry in known if entry.section == section]
        found.append(f"## [{section}]\n\n{about(section)}{_KEYS}\n" + "\n".join(map(_row, rows)) + "\n")
    return found


def _describe_section(section: str) -> str:
    """Return the description of a whole section, or an empty text if it has none."""
    field = Axis.model_fields.get(section)
    return f"{_sentence(field.description)}\n\n" if field is not None and field.description else ""


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


def _row(entry: ReferenceEntry) -> str:
    only = f" Only with {entry.models}." if entry.models else ""
    key = entry.name.rpartition(".")[2]
    cells = (f"`{key}`", entry.kind, entry.unit, entry.default, f"{_sentence(entry.meaning)}{only}")
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def plant_page() -> str:
    """Return the page of all keys, in Markdown."""

    def describe(section: str) -> str:
        table, _, kind = section.partition(".")
        return f"{_ABOUT[table].format(kind=kind)}\n\n"

    return "\n".join([PLANT_HEAD, *tables(plant_entries(), describe)])


def main() -> None:
    """Write both pages."""
    for name, text in (("axis_toml.md", axis_page()), ("plant_toml.md", plant_page())):
        (REFERENCE / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
