"""The pictures of status words show logs that raise them, next to logs that do not."""

from __future__ import annotations

from pathlib import Path

import pytest

from docs.stage import explain_words, list_words
from docs.word_estimates import ESTIMATES, SAMPLES
from docs.words import PICTURES, make_logs
from pmfid.findings import codes
from pmfid.pipeline.identify import check
from tests.conftest import long_unless


def test_each_picture_belongs_to_a_word_without_a_page() -> None:
    pages = {path.stem for path in (Path(__file__).parents[1] / "docs/howto/status").glob("*.md")}
    assert {*PICTURES, *SAMPLES, *ESTIMATES} <= set(list_words()) - pages


@pytest.mark.parametrize("word", long_unless(("clipped",).__contains__, list(PICTURES)))
def test_a_picture_shows_the_log_that_raises_its_word(word: str) -> None:
    good, bad = make_logs(PICTURES[word])
    assert word in {one.code for one in check(bad.record(), bad.configuration)}
    assert word not in codes(check(good.record(), good.configuration))


def test_the_section_of_a_word_has_its_picture(tmp_path: Path) -> None:
    assert "](status/clipped.png)" in explain_words(["clipped"], tmp_path)
    assert (tmp_path / "howto/status/clipped.png").stat().st_size > 10_000
    assert "![" not in explain_words(["unseen"], tmp_path)
