"""Runs a case as the command does, and judges what came out by what the pages promise."""

from __future__ import annotations

import json
import re
import tempfile
import traceback
import warnings
from dataclasses import dataclass
from pathlib import Path

from click.testing import CliRunner

from pmfid.cli.main import main
from tests.hostile.draw import Case, draw

#: Exit codes of the commands: done, wrong usage or unreadable input, data that cannot identify the parameters.
DONE, USAGE, NOT_IDENTIFIABLE = 0, 2, 3
NOT_FINITE = re.compile(r"(?<![\w'\"\[])[-+]?(nan|inf|infinity)(?![\w'\"\]])", re.IGNORECASE)
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f]")


@dataclass(frozen=True)
class Verdict:
    """The exit code of a case, and what is wrong with how it ended; empty where all is as promised."""

    code: int
    faults: tuple[str, ...]


def judge(seed: int) -> Verdict:
    """Draws a case, runs it in a folder of its own with every warning an error, and judges."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        case = draw(seed, folder)
        return run(case, folder)


def run(case: Case, folder: Path) -> Verdict:
    record, axis = folder / case.name, folder / "axis.toml"
    record.write_bytes(case.record)
    axis.write_text(case.axis, encoding="utf-8")
    command, *options = case.command
    options = [str(folder / "out") if option == "out" else option for option in options]
    files = [str(axis), "--record", str(record)] if command == "export" else [str(record), "--config", str(axis)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = CliRunner().invoke(main, [command, *files, *options])
    faults = []
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        error = result.exception
        last = traceback.extract_tb(error.__traceback__)[-1]
        faults.append(f"{type(error).__name__}: {error} at {Path(last.filename).name}:{last.lineno}")
    return Verdict(result.exit_code, (*faults, *_said(result.exit_code, result.stdout, result.stderr, options)))


def _said(code: int, out: str, err: str, options: list[str]) -> list[str]:
    faults = [
        f"control character in {name}" for name, text in (("stdout", out), ("stderr", err)) if CONTROL.search(text)
    ]
    if code not in (DONE, USAGE, NOT_IDENTIFIABLE):
        return [*faults, f"exit code {code}"]
    if code == DONE:
        numbers = NOT_FINITE.search(out)
        faults += (
            [f"a number that is not finite: {out[max(0, numbers.start() - 60) : numbers.end() + 20]!r}"]
            if numbers
            else []
        )
        if "--json" in options:
            faults += _json(out)
        return [*faults, *(["said on stderr: " + err[:100]] if err else [])]
    faults += ["output in spite of an error"] if out else []
    one = err.startswith("pmfid: ") and err.count("\n") <= 1 + err.count("\n  ")
    return faults if one or "Error: " in err else [*faults, f"no one-line error: {err[:200]!r}"]


def _json(out: str) -> list[str]:
    try:
        json.loads(out)
    except ValueError as error:
        return [f"no JSON: {error}"]
    return [] if out.count("\n") == 1 else ["more than one line of JSON"]
