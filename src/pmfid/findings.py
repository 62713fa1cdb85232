"""Findings on a record or an estimate, in one list for all readers, sorted by importance.

The terminal, JSON, HTML and Python show the same list. Each check returns a `Finding`; no other code writes
sentences on findings.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

#: Relative error of a parameter that does not matter.
NEGLIGIBLE = 0.01
#: The remedy that helps most often.
MOVE = "record a motion with reversals and varying speed"
Severity = Literal["wrong", "doubt", "note"]
#: All severities, the most important first. After "wrong", no further result is valid. With "doubt", an error may
#: exceed its error bar. A "note" says how the result was computed.
SEVERITIES: tuple[Severity, ...] = ("wrong", "doubt", "note")


@dataclass(frozen=True)
class Finding:
    """One observation on a record or a result: a status word, a sentence and a remedy.

    Attributes
    ----------
    code : str
        Name of the finding in the status, such as "feedback".
    sentence : str
        The observation and its consequence.
    remedy : str
        Instruction for the user. Empty if the sentence contains the instruction or if no action is needed.
    severity : str
        One of `SEVERITIES`.
    detail : str
        Further text that only the report, JSON and Python show; may be empty.

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
        """Sentence and remedy on one line."""
        return f"{self.sentence}: {self.remedy}" if self.remedy else self.sentence

    @property
    def line(self) -> str:
        """Severity, sentence and remedy on one line."""
        return f"{self.severity}: {self.text}"

    @property
    def lines(self) -> tuple[str, ...]:
        """Lines for a terminal: the severity and the sentence, then the remedy if the finding has one."""
        return (f"{self.severity}: {self.sentence}", *([f"  {self.remedy}"] if self.remedy else []))

    @property
    def paragraph(self) -> str:
        """Severity, sentence, remedy and detail as sentences, for a report."""
        text = f"{self.line}. {self.detail}".rstrip(". ")
        return f"{text[0].upper()}{text[1:]}."

    def to_json(self) -> dict[str, str]:
        return dict(vars(self))


def advise(findings: Iterable[Finding], usual: str = MOVE) -> str:
    """Return the advice after a refusal: the text of the most important finding that is no note, or else `usual`."""
    return next((finding.text for finding in sort_findings(findings) if finding.severity != "note"), usual)


def make_notes(code: str, sentences: Iterable[str]) -> list[Finding]:
    """Return one note for each sentence that is not empty."""
    return [Finding(code, sentence, severity="note") for sentence in sentences if sentence]


def sort_findings(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the findings without duplicates, the most important first. Findings of equal severity keep their order.

    Of findings with the same sentence, only the most important one remains.
    """
    found: dict[tuple[str, str], Finding] = {}
    for one in sorted(findings, key=lambda finding: SEVERITIES.index(finding.severity)):
        found.setdefault((one.code, one.sentence), one)
    return tuple(found.values())


def codes(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Return the status words of all findings except notes, without duplicates."""
    return tuple(dict.fromkeys(finding.code for finding in findings if finding.severity != "note"))


class Judged:
    """A result with findings."""

    findings: tuple[Finding, ...]

    @property
    def status(self) -> tuple[str, ...]:
        """The words of the findings that are more than notes."""
        return codes(self.findings)


def texts(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Return the texts of the findings, without duplicates."""
    return tuple(dict.fromkeys(finding.text for finding in findings))
