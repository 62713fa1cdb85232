"""Blocks of the pages that do not run there: configurations load, C compiles, and commands have their options."""

from __future__ import annotations

import ast
import re
import shlex
import textwrap
import tomllib
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

import pmfid
from docs.blocks import ROOT
from pmfid.cli.main import main as program
from pmfid.config.axis import load_axis
from pmfid.pipeline.designs import load_spec
from pmfid.service.plant import load_plant
from tests.firmware.build import GCC, REQUIRED, command

PAGES = ["README.md", *(str(path.relative_to(ROOT)) for path in sorted((ROOT / "docs").rglob("*.md")))]
FENCED = re.compile(r"^```.*?^```\n", re.DOTALL | re.MULTILINE)
INDENTED = re.compile(r"(?<=\n)\n((?:    [^\n]*\n(?:\n(?=    ))?)+)")
#: Tables of Telegraf, whose programs are not here.
TELEGRAF = {"agent", "inputs", "outputs", "processors", "aggregators"}
#: Declarations that the C of a page takes from the program of its reader.
DECLARED = {
    "docs/howto/firmware.md": "",
    "docs/start/cortex_m.md": "uint32_t status, count; real_t volts, mass;",
    "docs/wire.md": "uint32_t epoch, number; int32_t counts[50]; double seconds; float u[50];",
}
#: What the page's C sees of a microcontroller.
MICROCONTROLLER = """
#include <stdint.h>
typedef struct { volatile uint32_t CNT, SR; } timer_t;
extern timer_t *TIM3, *TIM6;
enum { TIM_SR_UIF = 1, TIM6_DAC_IRQn = 54 };
void NVIC_EnableIRQ(int number);
void Error_Handler(void);
"""


def fenced(language: str) -> list[object]:
    """Return a case of page and text for each block of a language."""
    found = []
    for page in PAGES:
        blocks = re.findall(rf"^```{language}\n(.*?)^```", (ROOT / page).read_text("utf-8"), re.DOTALL | re.MULTILINE)
        found += [pytest.param(page, text, id=f"{page}-{number}") for number, text in enumerate(blocks)]
    return found


def indented() -> list[object]:
    """Return a case of page and text for each indented block."""
    found = []
    for page in PAGES:
        blocks = INDENTED.findall(FENCED.sub("", (ROOT / page).read_text("utf-8")))
        found += [pytest.param(textwrap.dedent(text), id=f"{page}-{number}") for number, text in enumerate(blocks)]
    return found


@pytest.mark.parametrize(("page", "text"), fenced("toml"))
def test_a_configuration_loads(page: str, text: str, tmp_path: Path) -> None:
    tables = tomllib.loads(text)
    file = tmp_path / "shown.toml"
    if tables.keys() & TELEGRAF:
        assert tables.keys() <= TELEGRAF
    elif "experiment" in tables:
        file.write_text(text)
        assert load_spec(file).experiment.unknown
    elif tables.keys() & {"sources", "sinks", "page"}:
        (tmp_path / "axis.toml").write_text((ROOT / "examples/plant_axis.toml").read_text())
        rest = "" if "sources" in tables else '[sources.hall]\nkind = "mqtt"\nhost = "localhost"\ntopics = ["a"]\n'
        file.write_text(f'[service]\nname = "hall"\n[axes.x1]\nconfig = "axis.toml"\n{text}\n{rest}')
        plant = load_plant(file)
        assert plant.page.enabled
        assert tables.get("sources", plant.sources).keys() <= plant.sources.keys()
        assert tables.get("sinks", plant.sinks).keys() <= plant.sinks.keys()
    else:
        kept = re.split(r"(?m)^(?=\[)", (ROOT / "examples/cart.toml").read_text())
        rest = "".join(part for part in kept if part[1:].partition("]")[0] not in tables)
        file.write_text(rest.replace('output_kind = "counts"', "") + text if "edge_age" in text else rest + text)
        assert load_axis(file).model_dump()


@pytest.mark.skipif(bool(GCC.missing), reason=GCC.missing)
@pytest.mark.parametrize(("page", "text"), fenced("c"))
def test_c_compiles_against_an_export(page: str, text: str, tmp_path: Path) -> None:
    """A block without functions stands inside of one, as the reader would place the block."""
    prefix = "cart" if "cart_" in text else "axis"
    estimator = pmfid.RIV(pmfid.Drive(2.0), pmfid.Encoder(1e-5, bits=16), 0.001, 50.0, precision="float32")
    pmfid.export_firmware(estimator, tmp_path, prefix=prefix, blocks=True)
    (tmp_path / "stm32f4xx.h").write_text(MICROCONTROLLER)
    heads = [line for line in text.splitlines() if line.startswith("#include")]
    body = "\n".join(line for line in text.splitlines() if line not in heads)
    whole = body if re.search(r"^void \w+\(void\)\n\{", body, re.MULTILINE) else f"void shown(void)\n{{\n{body}\n}}"
    axis = "" if f"{prefix}_t {prefix}" in body or "pmf_block" in body else f"static {prefix}_t {prefix};"
    source = "\n".join([f'#include "{prefix}.h"', *heads, axis, DECLARED[page], whole])
    (tmp_path / "shown.c").write_text(source)
    done = command(
        [GCC.compiler, *REQUIRED, "-Werror=implicit", "-Werror=int-conversion", "-fsyntax-only", "shown.c"], tmp_path
    )
    assert done.returncode == 0, done.stderr


def parse_command(words: list[str]) -> None:
    """Parse a command of pmfid without running it. Raises click.UsageError for an unknown command or option."""
    group, context = program, click.Context(program, info_name="pmfid")
    while isinstance(group, click.Group):
        name, inner, words = group.resolve_command(context, words)
        assert inner is not None
        group, context = inner, click.Context(inner, info_name=name, parent=context)
    group.make_parser(context).parse_args(list(words))


def commands_of(text: str) -> Iterator[list[str]]:
    """Yield the words of each command of a block, with its continued lines and without what is piped."""
    for line in text.replace("\\\n", " ").splitlines():
        for part in line.split("|"):
            if part.strip() and not part.lstrip().startswith("#"):
                yield shlex.split(part, comments=True)


def is_python(text: str) -> bool:
    try:
        return bool(ast.parse(text).body)
    except SyntaxError:
        return False


@pytest.mark.parametrize("text", indented())
def test_an_indented_block_names_what_exists(text: str) -> None:
    """Commands of pmfid have their options, targets of make exist, and Python imports what is there."""
    if is_python(text):
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom):
                module = pytest.importorskip(str(node.module))
                assert [name.name for name in node.names if not hasattr(module, name.name)] == []
            elif isinstance(node, ast.Attribute) and ast.unparse(node).startswith("pmfid."):
                assert eval(ast.unparse(node), {"pmfid": pmfid})
        return
    makefile = (ROOT / "Makefile").read_text("utf-8")
    for words in commands_of(text):
        if words[0] == "pmfid":
            parse_command([word for word in words[1:] if word != "..."])
        elif words[0] == "make" and "-C" not in words:
            assert re.search(rf"^[\w -]*\b{words[1]}\b[\w -]*:", makefile, re.MULTILINE), words
