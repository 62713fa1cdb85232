"""`pmfid init` finds time, input and output in logs of four loggers, with names in English and German and without."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from pmfid.errors import UsageError
from pmfid.pipeline.guess.axis_file import guess
from tests.first_guess.logs import LOGS, Log


@pytest.mark.parametrize(
    ("seed", "log"), list(enumerate(LOGS)), ids=[f"{log.logger} {', '.join(log.columns)}" for log in LOGS]
)
def test_the_columns_of_a_log_are_found(tmp_path: Path, seed: int, log: Log) -> None:
    path = log.write(tmp_path, seed)
    if log.answer is None:
        with pytest.raises(UsageError, match=r"no column|no two columns|does not move"):
            guess(path)
        return
    record = tomllib.loads(guess(path).text)["record"]
    assert (record.get("time", ""), record["input"], record["output"]) == log.answer


def test_a_close_second_is_a_doubt_in_numbers(tmp_path: Path) -> None:
    """Current and voltage of one machine are explained alike, and no name says which drives it."""
    columns = {"t": "t", "a": "current", "b": "voltage", "x": "position"}
    text = guess(Log("matlab", "open", columns, None).write(tmp_path, 3)).text
    doubt = re.search(
        r'input = "([ab])"  # TO DO: check this column; the pair has a probability of (\d+) %; (.*)', text
    )
    assert doubt is not None
    assert 50 <= int(doubt[2]) < 90
    assert f"--input {'ab'.replace(doubt[1], '')} --output x" in doubt[3]
