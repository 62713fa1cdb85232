"""What is said of an input that acts later than the model has it."""

from __future__ import annotations

from collections.abc import Iterator

from pmfid.estimators.adequacy import Adequacy
from pmfid.estimators.lateness import ALIKE, Lateness, lateness
from pmfid.findings import Finding
from pmfid.models.equation import DEAD_TIME, ESTIMATE, LAG, Equation

#: Least delay [samples] that is reported without a score that names it: a smaller one imitates other effects, as
#: friction within a sample.
LEAST = 0.05
#: What each is called, for people.
CALLED = {DEAD_TIME: "dead time", LAG: "first-order lag"}


def late(found: Adequacy) -> Iterator[Finding]:
    """What is said where the counts ask for an input that acts late, or late in another way; of a model that is
    not adequate."""
    equation, dt = found.difference.equation, found.difference.dt
    ways = _ways(found)
    if ways:
        best, cure = _describe_delay(ways[0], dt), _cure(ways[0], equation)
        yield Finding(
            "dead_time", f"a {best} explains the counts better{_compare_ways(ways, dt)}: set {cure} in [model]"
        )


def _ways(found: Adequacy) -> list[Lateness]:
    """Where the scores do not name it, and the model has none, it must explain more than any force that they name."""
    equation = found.difference.equation
    if found.dead_time is not None:
        return lateness(found) or [Lateness({DEAD_TIME: found.dead_time}, 0.0, False)]
    if equation.at_once != equation:
        return lateness(found)
    most, least = max((float(found.gain[k]) for k in found.missed), default=0.0), LEAST * found.difference.dt
    large = [way for way in lateness(found) if way.gain > most and sum(way.times.values()) > least]
    return [way for way in large if found.follows or way.follows]


def _compare_ways(ways: list[Lateness], dt: float) -> str:
    if len(ways) == 1:
        return ""
    return (
        f", a {_describe_delay(ways[1], dt)} {'nearly as well' if ways[0].gain - ways[1].gain < ALIKE else 'less so'}"
    )


def _describe_delay(way: Lateness, dt: float) -> str:
    """The delay in samples of dt [s], as words."""
    return " and a ".join(f"{CALLED[name]} of about {time / dt:.2g} samples" for name, time in way.times.items())


def _cure(way: Lateness, equation: Equation) -> str:
    """What to write, and what to leave out of it."""
    given = {DEAD_TIME: equation.dead_time, LAG: equation.lag}
    dropped = [f"{name} = 0" for name, value in given.items() if value and name not in way.times]
    return " and ".join([f'{name} = "{ESTIMATE}"' for name in way.times] + dropped)
