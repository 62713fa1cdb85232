"""Pages for readers have sentences of at most 25 words, without the words that docs/glossary.md replaces."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[1]
#: Pages that `python -m docs.keys` writes, from descriptions that follow "give ...".
GENERATED = {"axis_toml.md", "plant_toml.md"}
PAGES = [
    PROJECT / "README.md",
    PROJECT / "ARCHITECTURE.md",
    *(PROJECT / f"{name}.md" for name in ("SKILL", "CONTRIBUTING", "SECURITY", "CODE_OF_CONDUCT")),
    *sorted(path for path in (PROJECT / "docs").rglob("*.md") if path.name not in GENERATED),
]
MOST_WORDS = 25
#: Words that hide the subject, refer to a distant clause, or are not idiomatic English.
WORDS = [
    *("told", "anew", "behind", "beside", "so many", "so long", "thereof", "lacks", "that of", "those of"),
    *("of which",),
]
WORDS += ["in order to", "hereby", "wherein", "such that", "the former", "the latter", "as well known"]
BAD = re.compile(rf"\b({'|'.join(WORDS)})\b", re.IGNORECASE)
#: Beginnings of sentences without a subject.
VAGUE = re.compile(r"^(There (is|are)|It is (that|to be)|What is more|Thereby|Hereby)\b")


def paragraphs(text: str) -> Iterator[str]:
    """Yield the running text of a page: paragraphs, list items and table cells, without code, headings and links."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"!\[[^\]]*\]\([^)]*\)", "", text)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = text.replace('"Begin anew"', '"button"').replace("*Begin anew*", "*button*")
    block: list[str] = []
    for line in [*text.splitlines(), ""]:
        starts = re.match(r"\s*(?:[-*]|\d+\.) |\|", line)
        if block and (not line.strip() or starts or line.startswith(("#", "    "))):
            yield " ".join(block)
            block = []
        if line.startswith("|"):
            yield from (cell.strip() for cell in line.strip("|").split("|"))
        elif line.strip() and not line.startswith(("#", "    ")):
            block.append(re.sub(r"^\s*(?:[-*]|\d+\.) ", "", line).strip())


def sentences(paragraph: str) -> list[str]:
    """Split a paragraph at each full stop, and at each colon before a list or an example."""
    plain = re.sub(r"`[^`]*`", "X", paragraph)
    plain = re.sub(r"\b(e\.g|i\.e|et al|eq|vs|Fig|No|approx)\.", r"\1", plain)
    return [part.strip() for part in re.split(r"(?<=[.!?])[*_\")]*\s+(?=[\"*_(]*[A-Z0-9`X])", plain) if part.strip()]


def count_words(sentence: str) -> int:
    return len(re.findall(r"[A-Za-z0-9][\w'’.,/%-]*", sentence))


def problems(text: str) -> list[str]:
    found = []
    for paragraph in paragraphs(text):
        for sentence in sentences(paragraph):
            if count_words(sentence) > MOST_WORDS:
                found.append(f"{count_words(sentence)} words: {sentence}")
            found += [f"{word}: {sentence}" for word in BAD.findall(sentence)]
            if VAGUE.match(sentence):
                found.append(f"no subject: {sentence}")
    return found


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(PROJECT)))
def test_sentences_are_short_and_plain(path: Path) -> None:
    assert problems(path.read_text(encoding="utf-8")) == []


def test_the_check_finds_what_it_is_for() -> None:
    long = " ".join(["word"] * MOST_WORDS)
    assert problems(f"{long}.\n") == []
    assert len(problems(f"A {long}.\n\n- An {long}. Short.\n\n| x | the {long} |\n")) == 3
    assert problems(f"    {long} {long}\n\n```\n{long} {long}\n```\n") == []
    assert len(problems("The noise behind the filter is small. There is no other.\n")) == 2
    assert problems("The button [Begin](behind.md) starts.\n") == []
