"""Findings: what there is to say of a record or of an estimate. One list, most important first, for every reader.

Terminal, JSON, HTML and Python show the same list: who wants to say something makes a `Finding`, and nobody else makes
sentences of it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

__all__ = ["MOVE", "Finding", "advise", "codes", "make_notes", "sort_findings", "texts"]

#: The remedy that helps most often.
MOVE = "record a motion with reversals and varying speed"
Severity = Literal["wrong", "doubt", "note"]
#: Most important first. wrong: no result that follows is valid; doubt: an error may exceed its error bar; note: what
#: was done, and how.
SEVERITIES: tuple[Severity, ...] = ("wrong", "doubt", "note")


@dataclass(frozen=True)
class Finding:
    """Something that was found in a record or a result.

    Attributes
    ----------
    code : str
        Its name in the status, such as "feedback".
    sentence : str
        What is the case, and what comes of it.
    remedy : str
        What to do, literally; empty if the sentence says so or nothing is to be done.
    severity : str
    detail : str
        What only the report, JSON and Python add; empty if there is no more to say.

    Examples
    --------
    >>> from pmfid import Finding
    >>> Finding("rest", "the axis never moves", "give more input").text
    'the axis never moves: give more input'
    """

    code: str
    sentence: str
    remedy: str = ""
    severity: Severity = "doubt"
    detail: str = ""

    @property
    def text(self) -> str:
        """Sentence and remedy, on one line."""
        return f"{self.sentence}: {self.remedy}" if self.remedy else self.sentence

    @property
    def line(self) -> str:
        """Sentence and remedy, with their severity in front."""
        return f"{self.severity}: {self.text}"

    @property
    def lines(self) -> tuple[str, ...]:
        """The same for a terminal: a line for the sentence, and one for the remedy."""
        return (f"{self.severity}: {self.sentence}", *([f"  {self.remedy}"] if self.remedy else []))

    @property
    def paragraph(self) -> str:
        """All of it, for a report."""
        return f"{self.line}. {self.detail}" if self.detail else self.line

    def to_json(self) -> dict[str, str]:
        return dict(vars(self))


def advise(findings: Iterable[Finding], usual: str = MOVE) -> str:
    """What to say after a refusal: the most important finding that is more than a note, else what usually helps."""
    return next((finding.text for finding in sort_findings(findings) if finding.severity != "note"), usual)


def make_notes(code: str, sentences: Iterable[str]) -> list[Finding]:
    """Sentences on what was done, as findings."""
    return [Finding(code, sentence, severity="note") for sentence in sentences if sentence]


def sort_findings(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """The findings, most important first, each once; of the same weight in the order in which they were found."""
    return tuple(sorted(dict.fromkeys(findings), key=lambda finding: SEVERITIES.index(finding.severity)))


def codes(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Names for the status: of what is more than a note, each once."""
    return tuple(dict.fromkeys(finding.code for finding in findings if finding.severity != "note"))


def texts(findings: Iterable[Finding]) -> tuple[str, ...]:
    """The sentences, with their remedies, each once."""
    return tuple(dict.fromkeys(finding.text for finding in findings))
