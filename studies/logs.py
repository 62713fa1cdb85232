"""Study the estimates from realistic logs: `python -m studies.logs --out results/logs.md`."""

from __future__ import annotations

import argparse
import re
import tempfile
import tomllib
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pmfid.config.axis import Axis
from pmfid.config.toml_file import validate_sections
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.pipeline.guess.axis_file import guess
from pmfid.pipeline.identify import identify, kind_of
from pmfid.types import Floats
from pmfid.units import Quantity, gain
from studies.log_bench import BENCHES, Keys, Log
from studies.log_folder import clean, logs
from studies.paper.truth import table

#: Largest relative difference from the parameters of the clean log.
SAME = 0.005
#: Number of remedies that a user follows before giving up.
PATIENCE = 4
#: A key with its value in a remedy: "[encoder] resolution = "0.01 mm" or "0.01 m"", "give bits = 12".
_KEY = re.compile(r'(?:\[(?P<section>\w+)\] )?(?P<key>\w+) = (?P<first>"[^"]*"|-?[\d.]+(?:e-?\d+)?)')


@dataclass(frozen=True)
class Outcome:
    """The outcome of a log. `error` is the largest relative deviation of a parameter from the clean log, or None
    without an estimate. `said` are the refusals on the way, and `followed` are the remedies that were applied."""

    error: float | None
    said: tuple[str, ...]
    followed: tuple[str, ...]

    @property
    def verdict(self) -> str:
        if self.error is None:
            return "refused"
        return "same" if self.error <= SAME else "WRONG"


Judge = Callable[[Log, Path, Floats], Outcome]


def by_config(path: Path, keys: Keys) -> Floats:
    """Return the estimate of `pmfid identify` with these keys; raise the same errors."""
    axis = validate_sections(Axis, keys)
    return identify(kind_of(axis).read([path], axis), axis).theta


def outcome(log: Log, folder: Path, reference: Floats) -> Outcome:
    """Return the outcome of a log if every remedy is followed literally."""
    path, keys = log.write(folder, BENCHES[log.bench]), deepcopy(log.config())
    said: list[str] = []
    followed: list[str] = []
    for _ in range(PATIENCE):
        try:
            theta = by_config(path, keys)
        except (UsageError, NotIdentifiableError) as error:
            said.append(str(error).removeprefix(f"{path}: "))
            done = _follow(said[-1], log, keys, path)
            if done is None:
                break
            followed.append(done)
            continue
        return Outcome(float(np.max(np.abs(theta / reference - 1))), tuple(said), tuple(followed))
    return Outcome(None, tuple(said), tuple(followed))


def _follow(sentence: str, log: Log, keys: Keys, path: Path) -> str | None:
    """Follow the remedy of a refusal, with the user's own units if it asks for them. None means that the remedy names
    no key, and that the user cannot apply it to the file."""
    if "dt" in log.units and "give [record] dt" in sentence:
        keys["record"]["dt"] = BENCHES[log.bench].dt
        return f"dt = {BENCHES[log.bench].dt:g}"
    remedy = re.search(r"\b(?:give|write|set)\b(.*)", sentence)
    found = _KEY.search(remedy.group(1)) if remedy else None
    if found is None or remedy is None:
        if log.mend is None:
            return None
        log.mend(path)
        return "the file is mended"
    first = _set(found, remedy.group(1), log, keys)
    rest = re.match(r'"?,? and (\w+ = "[^"]*")', remedy.group(1)[found.end() :])
    more = _KEY.match(rest.group(1)) if rest else None
    return f"{first}, {_set(more, rest.group(1), log, keys)}" if more and rest else first


def _set(found: re.Match[str], text: str, log: Log, keys: Keys) -> str:
    """Write the key that a remedy names; of several forms, use the one in the user's units."""
    section = found["section"] or next(name for name, own in _homes().items() if found["key"] in own)
    ways = re.findall(r'"[^"]*"', text[found.start("first") :].split(";")[0].split(" and ")[0]) or [found["first"]]
    value = next((way for unit in log.units for way in ways if re.search(rf'[ /"]{re.escape(unit)}"', way)), ways[0])
    number = float(value) if value[0] != '"' else 0.0
    keys[section][found["key"]] = value.strip('"') if value[0] == '"' else int(number) if value.isdigit() else number
    return f"{found['key']} = {value}"


def _homes() -> dict[str, set[str]]:
    return {name: set(getattr(field.annotation, "model_fields", {})) for name, field in Axis.model_fields.items()}


def by_init(log: Log, folder: Path, reference: Floats) -> Outcome:
    """Return the outcome of a log with the unedited AXIS.toml of `pmfid init`. If asked for the gain and the travel of
    a count, the user gives those of the data sheet. Method and pole of the two compared columns are equal."""
    bench, keys = BENCHES[log.bench], log.config()
    said = gain(keys["model"]["input_gain"])
    known = {"force": said if isinstance(said, Quantity) else bench.truth.input_gain, "travel": bench.step}

    def ask(question: str, read: Callable[[str], float]) -> float:
        return read(f"{known.get(question.split()[0], bench.dt):.12g}")

    path = log.write(folder, bench)
    try:
        raw = tomllib.loads(guess(path, ask).text) | {"estimator": keys["estimator"]}
        theta = by_config(path, raw)
    except (UsageError, NotIdentifiableError) as error:
        return Outcome(None, (str(error).removeprefix(f"{path}: "),), ())
    return Outcome(float(np.max(np.abs(theta / reference - 1))), (), ())


def outcomes(chosen: list[Log], of: Judge = outcome) -> Iterator[tuple[Log, Outcome]]:
    """Yield the outcome of each log, in a separate folder."""
    with tempfile.TemporaryDirectory() as home:
        references = {name: _reference(name, Path(home)) for name in BENCHES}
        for k, log in enumerate(chosen):
            folder = Path(home) / str(k)
            folder.mkdir()
            yield log, of(log, folder, references[log.bench])


def _reference(name: str, folder: Path) -> Floats:
    log = clean(name)
    return by_config(log.write(folder, BENCHES[name]), log.config())


def rows(found: list[tuple[Log, Outcome]], begun: list[Outcome]) -> list[list[str]]:
    """Return a row for each log."""
    made = []
    for (log, result), own in zip(found, begun, strict=True):
        error = "" if result.error is None else f"{100 * result.error:.3f}"
        said = result.said[0].replace("|", "\\|").replace("\n", " ") if result.said else ""
        followed = ", ".join(result.followed).replace("|", "\\|")
        initial = own.verdict if own.error is None else f"{own.verdict}, {100 * own.error:.3f}"
        made.append([log.name, log.bench, result.verdict, error, initial, said, followed])
    return made


PAGE = """\
# Logs as they come

Written by

    python -m studies.logs --out results/logs.md

Logs of a rotary and a linear axis with known truth, in every format, layout, unit and way to tell the time, with every
defect, alone and in twos. The AXIS.toml of each is that of a user who knows the names of the columns and the numbers of
the data sheet, in whatever unit these are. Where the log is refused, the remedy is followed literally, as often as
{patience} times, until there is an estimate. It is the same where mass, viscous and Coulomb friction are within
{same:.1f} % of what the clean log gives.

{count} logs: {same_count} the same ({at_once} of them at once), {refused} refused, {wrong} wrong.

After `pmfid init`, with nothing edited, where the user is asked for the travel of a count and for the gain of the input
and knows both, {initial} are the same and {initial_wrong} are wrong.
"""


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m studies.logs", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="Markdown page to write")
    parser.add_argument("--only", default="", help="logs with this in their name")
    options = parser.parse_args(arguments)
    chosen = [log for log in logs() if options.only in log.name]
    found = list(outcomes(chosen))
    begun = [result for _, result in outcomes(chosen, by_init)]
    verdicts = [result.verdict for _, result in found]
    page = PAGE.format(
        patience=PATIENCE,
        same=100 * SAME,
        count=len(found),
        same_count=verdicts.count("same"),
        at_once=sum(result.verdict == "same" and not result.said for _, result in found),
        refused=verdicts.count("refused"),
        wrong=verdicts.count("WRONG"),
        initial=sum(result.verdict == "same" for result in begun),
        initial_wrong=sum(result.verdict == "WRONG" for result in begun),
    )
    header = ["log", "axis", "outcome", "deviation [%]", "after `pmfid init`", "what was said first", "what was done"]
    options.out.write_text("\n".join([page, *table(header, rows(found, begun))]), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
