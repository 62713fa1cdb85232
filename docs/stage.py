"""Prepare the pages that Sphinx reads: `python -m docs.stage FOLDER`.

The pages of docs/ are copied. The output and the figures of each code block follow the block. The pages on status
words, commands and results are written from the program itself.
"""

from __future__ import annotations

import ast
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import click

from docs.blocks import ROOT, run_blocks
from docs.word_estimates import ESTIMATES, SAMPLES, draw_estimates, draw_samples
from docs.words import PICTURES, draw_log
from pmfid.cli.main import main as program
from pmfid.config.explain import ReferenceEntry, entries
from pmfid.diagnostics.matter import FLAGS, OF_LOG, OF_MODEL
from pmfid.status import Status

DOCS = ROOT / "docs"
WORDS = re.compile(r"^<!-- status: ([\w ]+) -->$", re.MULTILINE)
STUDY = re.compile(r"^\t\.venv/bin/python -m ((?:studies|tests)\.[\w.]+) --out results/(\w+)\.md", re.MULTILINE)


def stage(folder: Path) -> None:
    """Write all pages into `folder`, which is emptied before."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(DOCS, folder, ignore=shutil.ignore_patterns("*.py", "_*"))
    shutil.copytree(ROOT / "deploy", folder.parent / "deploy", dirs_exist_ok=True)
    for page in sorted(folder.rglob("*.md")):
        text = WORDS.sub(lambda mark: explain_words(mark[1].split(), folder), page.read_text(encoding="utf-8"))
        page.write_text(show_outcomes(text, page), encoding="utf-8")
    (folder / "reference" / "commands.md").write_text("".join(describe_commands(program, "pmfid")), encoding="utf-8")
    records = sorted(path.stem for path in (folder / "decisions").glob("[a-z]*.md"))
    append_contents(folder / "decisions" / "README.md", records)
    list_results(folder / "results.md", ROOT / "results")


def append_contents(page: Path, entries_below: list[str]) -> None:
    """Append the pages below a page, which its text already names, for the side bar."""
    text = page.read_text(encoding="utf-8")
    page.write_text("\n".join([text, "```{toctree}", ":hidden:", "", *entries_below, "```", ""]), encoding="utf-8")


# --- code blocks ------------------------------------------------------------------------------------------------------


def show_outcomes(text: str, page: Path) -> str:
    """Return the text with the output and the figures of each block after the block."""
    parts, start, number = [], 0, 0
    with tempfile.TemporaryDirectory() as place:
        for outcome in run_blocks(text, Path(place)):
            parts.append(text[start : outcome.end])
            start = outcome.end
            if outcome.text.strip():
                parts.append(f"\n```text\n{outcome.text.rstrip()}\n```\n")
            for figure in outcome.figures:
                number += 1
                image = page.with_name(f"{page.stem}-{number}.png")
                figure.savefig(image, dpi=150)
                parts.append(f"\n![Figure of the block above]({image.name})\n")
    return "".join([*parts, text[start:]])


# --- status words -----------------------------------------------------------------------------------------------------


def explain_words(words: list[str], folder: Path) -> str:
    """Return a section for each status word: its meaning, its weight, and its figure or the page with figures."""
    known = {entry.name: entry for entry in entries() if not entry.kind}
    sections = []
    for word in words:
        more = (
            f"\n\n[Records and figures](status/{word}.md)" if (folder / "howto/status" / f"{word}.md").exists() else ""
        )
        for drawn, draw in ((PICTURES, draw_log), (SAMPLES, draw_samples), (ESTIMATES, draw_estimates)):
            if word in drawn:
                (folder / "howto/status").mkdir(parents=True, exist_ok=True)
                draw(word).savefig(folder / f"howto/status/{word}.png", dpi=150)
                more += f"\n\n![A good record, and one with the word {word}](status/{word}.png)"
        weight = f"\n\n*{weigh_word(word)}*" if weigh_word(word) else ""
        sections.append(f"### {word}\n\n{write_meaning(known[word])}{weight}{more}\n")
    return "\n".join(sections)


def write_meaning(entry: ReferenceEntry) -> str:
    """Return the text of `pmfid explain` as sentences."""
    text = entry.meaning.rstrip(".")
    return f"{text[0].upper()}{text[1:]}."


def weigh_word(word: str) -> str:
    """Return how much a status word matters, by the masks and sets that the program itself uses."""
    bit = Status.__members__.get(word.upper())
    if bit is not None and bit & Status.NOT_AN_ESTIMATE:
        return "The numbers of such a sample are no estimate, or no new one."
    if bit is not None and bit & Status.SAMPLE_REJECTED:
        return "The sample is left out, and the estimate goes on."
    if word in OF_MODEL or (bit is not None and bit & Status.DISTORTED):
        return "A parameter may be wrong by more than its standard error."
    if word in OF_LOG:
        return "The word matters only if the model does not explain the record."
    return "The sample counts, and its number is used." if bit is not None else ""


def list_words() -> list[str]:
    """Return all status words."""
    return [*(str(bit.name).lower() for bit in Status), *FLAGS]


# --- commands and results ---------------------------------------------------------------------------------------------


def describe_commands(command: click.Command, path: str, parent: click.Context | None = None) -> Iterator[str]:
    """Yield the page of the command line: a section for each command, with its help and its options."""
    context = click.Context(command, info_name=path.rpartition(" ")[2], parent=parent)
    level = "#" * (1 if parent is None else 2)
    yield f"{level} {'The command line' if parent is None else path}\n\n"
    yield f"    {path} {' '.join(command.collect_usage_pieces(context))}\n\n"
    yield "\n\n".join(write_paragraphs(command.help or "")) + "\n\n"
    records = [record for parameter in command.get_params(context) if (record := parameter.get_help_record(context))]
    if records:
        yield "| option | meaning |\n|---|---|\n"
        yield (
            "".join(
                f"| `{option.replace('|', chr(92) + '|')}` | {escape_cell(meaning)} |\n" for option, meaning in records
            )
            + "\n"
        )
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            inner = command.get_command(context, name)
            if inner is not None and not inner.hidden:
                yield from describe_commands(inner, f"{path} {name}", context)


def write_paragraphs(text: str) -> list[str]:
    """Return the paragraphs of a help text as Markdown; a preformatted paragraph stays as it is."""
    paragraphs = text.replace("\f", "").split("\n\n")
    return [
        f"```text\n{part.removeprefix(chr(8)).strip(chr(10))}\n```"
        if part.startswith("\b")
        else escape_cell(" ".join(part.split()))
        for part in paragraphs
    ]


def escape_cell(text: str) -> str:
    """Return a text without characters that Markdown would take for marks."""
    return re.sub(r"([|<*\[\]])", r"\\\1", text) if "`" not in text else text.replace("|", "\\|")


def list_results(page: Path, measured: Path) -> None:
    """Append a table of all studies to the page, and copy each page of results that a study has written."""
    pages = page.parent / "results"
    pages.mkdir(exist_ok=True)
    if (measured / "images").exists():
        shutil.copytree(measured / "images", pages / "images")
    rows, links = [], []
    for module, name in STUDY.findall((ROOT / "Makefile").read_text(encoding="utf-8")):
        present = (measured / f"{name}.md").exists()
        if present:
            shutil.copy(measured / f"{name}.md", pages)
            links.append(f"results/{name}")
        title = f"[{name}](results/{name}.md)" if present else name
        rows.append(
            f"| {title} | {escape_cell(read_summary(module))} | `python -m {module} --out results/{name}.md` |\n"
        )
    text = (
        page.read_text(encoding="utf-8") + "\n| study | what it measures | command |\n|---|---|---|\n" + "".join(rows)
    )
    page.write_text(text, encoding="utf-8")
    if links:
        append_contents(page, links)


def read_summary(module: str) -> str:
    """Return the first line of a module's docstring, without the command that may follow."""
    path = ROOT / module.replace(".", "/")
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    line = (ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "").partition("\n")[0]
    return re.sub(r"(, as a page)?[:.]?$", "", line.partition(": `")[0])


if __name__ == "__main__":
    stage(Path(sys.argv[1]))
