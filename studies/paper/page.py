"""The page docs/paper.md: the text of template.md with the results of all figures and claims."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from studies.paper import designs, monitoring
from studies.paper.claims import CLAIMS
from studies.paper.equations import index_table
from studies.paper.result import Finding, table

TEMPLATE = Path(__file__).with_name("template.md").read_text(encoding="utf-8")
FIGURES: Mapping[str, Callable[[int, Path], Finding]] = {
    "2": designs.figure2,
    "3": monitoring.figure3,
    "4": monitoring.figure4,
    "5": designs.figure5,
}
#: Figure -> its pictures, each with a caption.
PICTURES: Mapping[str, Mapping[str, str]] = {
    "2": {"figure2": "Designs for the nominal and for a wrong mass, and the motion of the cart under each"},
    "3": {"figure3": "Mass over time by three methods and three encoders, without forgetting"},
    "4": {"figure4": "Mass over time by three methods and three encoders, while the load changes"},
    "5": {
        "figure5": "Mass over time under a pulse and under two designs",
        "figure5_inputs": "The inputs of one stroke",
    },
}
#: A part of the page by its name: its work from the number of seeds and the folder of pictures.
Work = Callable[[int, Path], object]


def jobs() -> dict[str, Work]:
    """Return the work of each part of the page."""
    parts: dict[str, Work] = {f"figure {name}": figure for name, figure in FIGURES.items()}
    for claim in CLAIMS:
        parts[claim.statement] = partial(_run, claim.check)
    return parts | {"bias": partial(_run, monitoring.bias_table)}


def _run(check: Callable[[int], object], seeds: int, images: Path) -> object:
    return check(seeds)


def do_job(task: tuple[str, int, Path]) -> tuple[str, object]:
    """Return the name of a part and its result."""
    name, seeds, images = task
    return name, jobs()[name](seeds, images)


def write_page(results: Mapping[str, object], seeds: int, images: str) -> str:
    """Return the page from the results of all parts; `images` is the relative folder of the pictures."""
    findings = {name: result for name, result in results.items() if isinstance(result, Finding)}
    bias = results["bias"]
    if not isinstance(bias, list):
        raise TypeError("the part bias gives the lines of a table")
    parts = {"seeds": str(seeds), "bias": _join(bias), "index": _join(index_table()), "claims": _claims(findings)}
    parts["summary"] = _summary(findings)
    for name in FIGURES:
        parts[f"figure {name}"] = _figure(name, findings[f"figure {name}"], images)
    return re.sub(r"<<(.*?)>>", lambda mark: parts[mark[1]], TEMPLATE)


def _join(lines: list[str]) -> str:
    return "\n".join(lines).strip("\n")


def _summary(findings: Mapping[str, Finding]) -> str:
    statements = dict(re.findall(r"^## Figure (\d)\n\n\*\*The paper:\*\* (.*)$", TEMPLATE, re.MULTILINE))
    rows = [["[1](#every-claim-of-the-text)", CLAIMS[0].statement, findings[CLAIMS[0].statement].verdict]]
    rows += [[f"[{name}](#figure-{name})", statements[name], findings[f"figure {name}"].verdict] for name in FIGURES]
    return _join(table(["figure", "the paper says", "verdict"], rows))


def _figure(name: str, finding: Finding, images: str) -> str:
    pictures = [f"![{caption}]({images}/{picture}.png)\n" for picture, caption in PICTURES[name].items()]
    return _join([f"**Here:** {finding.verdict}. {finding.text}\n", *pictures, *finding.lines])


def _claims(findings: Mapping[str, Finding]) -> str:
    each = [(claim, findings[claim.statement]) for claim in CLAIMS]
    rows = [[claim.section, claim.statement, finding.verdict, finding.text] for claim, finding in each]
    return _join(table(["section", "the paper says", "verdict", "what we find"], rows))
