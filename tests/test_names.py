"""Names: a function is a verb or a verb with its object, and a class name stands for one thing.

Words that hide the subject stay out (docs/glossary.md).
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

PROJECT = Path(__file__).parents[1]
SOURCE = PROJECT / "src" / "pmfid"
PREPOSITIONS = {"of", "by", "in", "at", "between", "apart", "behind", "beside", "within", "along", "about", "beyond"}
PREPOSITIONS |= {"around", "through", "after", "before", "above", "below", "without", "over", "against", "since", "off"}
#: Participles without -ed that were once names of functions here.
IRREGULAR = {
    *("told", "said", "made", "known", "found", "lost", "kept", "held", "sent", "seen", "taken", "chosen"),
    *("given",),
}
IRREGULAR |= {"written", "hidden", "drawn", "shown", "built", "begun", "spent", "broken", "spoken", "drowned", "laid"}
#: Verbs and nouns that only look like participles.
VERBS = {"feed", "need", "seed", "speed", "embed", "proceed", "exceed"}
WORDS = re.compile(r"\b(told|anew|behind|beside|so many)\b", re.IGNORECASE)
#: These words in parts of names, and the literals that contain them: an event, a button, a path, a column, a key.
PARTS = re.compile(r"(?<![a-z])(told|anew|behind|beside|so[ _]many)(?![a-z])", re.IGNORECASE)
LITERAL = re.compile(r"Begin anew|/anew|\banew: |([\"'])(told|anew|behind)\1|time, told:|found\.anew")
ELSEWHERE = ["tests", "studies", "examples", "benchmarks", "docs", "csrc", "deploy"]
TEXTS = {".py", ".md", ".toml", ".c", ".h", ".inl", ".ipynb", ".cpp"}
MOST_OF_A_WORD = 5
#: Files that list these words.
LISTS = {"test_names.py", "test_prose.py"}


def trees() -> Iterator[ast.Module]:
    for path in sorted(SOURCE.rglob("*.py")):
        yield ast.parse(path.read_text(encoding="utf-8"))


def is_property(node: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    return any("property" in ast.unparse(decorator) for decorator in node.decorator_list)


def is_no_verb(name: str) -> bool:
    words = name.strip("_").split("_")
    participle = words[0] in IRREGULAR or (words[0].endswith("ed") and words[0] not in VERBS)
    return words[0] in PREPOSITIONS or (len(words) == 1 and participle)


def test_functions_are_verbs() -> None:
    nodes = (node for tree in trees() for node in ast.walk(tree))
    functions = [n for n in nodes if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef) and not is_property(n)]
    assert len(functions) > 1000
    found = sorted(node.name for node in functions if is_no_verb(node.name))
    assert found == []


def test_a_class_name_stands_for_one_thing() -> None:
    names = Counter(node.name for tree in trees() for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    double = sorted(name for name, count in names.items() if count > 1)
    assert double == []


def test_words_that_hide_the_subject_stay_away() -> None:
    lines = [line for path in sorted(SOURCE.rglob("*.py")) for line in path.read_text(encoding="utf-8").splitlines()]
    found = [line.strip() for line in lines if WORDS.search(LITERAL.sub("", line))]
    assert found == []


def read_prose(path: Path) -> str:
    """Return the text of a file; of the kernel only its comments, because saved states use its names."""
    text = path.read_text(encoding="utf-8")
    return " ".join(re.findall(r"/\*.*?\*/", text, re.DOTALL)) if "csrc" in path.parts else LITERAL.sub("", text)


def test_these_words_stay_away_from_everything_else() -> None:
    files = [path for folder in ELSEWHERE for path in sorted((PROJECT / folder).rglob("*")) if path.suffix in TEXTS]
    files = [path for path in [*files, PROJECT / "README.md"] if path.name not in LISTS and "vendor" not in path.parts]
    assert len(files) > 200
    found = [(word.lower().replace("_", " "), path.name) for path in files for word in PARTS.findall(read_prose(path))]
    counts = Counter(word for word, _ in found)
    assert {word for word, count in counts.items() if count > MOST_OF_A_WORD} == set(), sorted(found)
