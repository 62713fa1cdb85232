"""Run a call as the command does, and judge its outcome by the promises of the pages."""

from __future__ import annotations

import contextlib
import json
import re
import resource
import signal
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from click.testing import CliRunner, Result

from pmfid.cli.main import main
from tests.conftest import PROGRESS
from tests.hostile.commands import Case
from tests.hostile.draw import draw

#: Exit codes of the commands: done, wrong usage or unreadable input, data that cannot identify the parameters.
DONE, USAGE, NOT_IDENTIFIABLE = 0, 2, 3
NOT_FINITE = re.compile(r"(?<![\w'\"\[])[-+]?(nan|inf|infinity)(?![\w'\"\]])", re.IGNORECASE)
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f]")
#: A call hangs if it takes more processor time [s]; a call that takes more memory has unpacked a hostile file [kB].
HANGS, TOO_MUCH = 60.0, 400_000


@dataclass(frozen=True)
class Verdict:
    """The verdict on a call. The outcome holds command, exit code, processor time [s] and the broken promises."""

    command: str
    code: int
    seconds: float
    faults: tuple[str, ...]


class HangsError(Exception):
    """The error of a call that takes too long."""


def judge(seed: int) -> Verdict:
    """Draw a call, run it in its own folder with every warning as an error, and judge the outcome."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        return run(draw(seed, folder), folder)


def run(case: Case, folder: Path) -> Verdict:
    for name, data in case.files.items():
        (folder / name).write_bytes(data)
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    with _limited(), contextlib.chdir(folder), warnings.catch_warnings():
        warnings.simplefilter("error")
        result = CliRunner().invoke(main, list(case.arguments), input=case.piped)
    seconds, more = time.process_time() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    faults = [*_error(result), *_said(case, result)]
    faults += [f"{name} is not what it was" for name, data in case.files.items() if _read(folder / name) != data]
    faults += [f"{more / 1000:.0f} MB more than any call before"] if more > TOO_MUCH else []
    return Verdict(case.arguments[0] if case.arguments else "", result.exit_code, seconds, tuple(faults))


@contextlib.contextmanager
def _limited() -> Iterator[None]:
    """Raise HangsError within the block if it uses too much processor time."""

    def stop(number: int, frame: object) -> None:
        raise HangsError(f"more than {HANGS:g} s")

    before = signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, HANGS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)


def _read(path: Path) -> bytes:
    return path.read_bytes() if path.is_file() else b""


def _error(result: Result) -> list[str]:
    error = result.exception
    if error is None or isinstance(error, SystemExit):
        return []
    places = [f"{Path(place.filename).name}:{place.lineno}" for place in traceback.extract_tb(error.__traceback__)]
    return [f"{type(error).__name__}: {error} at {' '.join(places[-3:])}"]


def _said(case: Case, result: Result) -> list[str]:
    out, err, code = result.stdout, PROGRESS.sub("", result.stderr), result.exit_code
    texts = {"stdout": out, "stderr": err}
    faults = [f"control character in {name}" for name, text in texts.items() if CONTROL.search(text)]
    if code not in (DONE, USAGE, NOT_IDENTIFIABLE):
        return [*faults, f"exit code {code}"]
    watches = case.arguments[:1] in (("monitor",), ("serve",))
    if "--json" in case.arguments and not {"--help", "-h"} & set(case.arguments):
        faults += _json(out, several=watches)
    if code == DONE:
        return [
            *faults,
            *_finite(out),
            *([f"said on stderr: {err[:100]}"] if err and not watches else []),
        ]
    if out and not (watches or (code == NOT_IDENTIFIABLE and '"relax"' in out)):
        faults.append("output in spite of an error")
    last = "\n".join(err.splitlines()[-1 - err.count("\n  ") :]) if watches else err
    one = last.startswith("pmfid: ") and last.count("\n") <= 1 + last.count("\n  ")
    return faults if one or "Error: " in err or "Usage: " in err else [*faults, f"no one-line error: {err[:200]!r}"]


def _finite(out: str) -> list[str]:
    number = NOT_FINITE.search(out)
    text = "" if number is None else out[max(0, number.start() - 60) : number.end() + 20]
    return [f"a number that is not finite: {text!r}"] if number else []


def _json(out: str, several: bool) -> list[str]:
    """Return the faults of the JSON output: one object on one line, or one line for each event of a watch."""
    lines = out.splitlines()
    try:
        for line in lines:
            json.loads(line)
    except ValueError as error:
        return [f"no JSON: {error}"]
    return ["more than one line of JSON"] if len(lines) > 1 and not several else []
