"""A user's first contact: help, and the demo's files."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from examples.demo import main as demo
from pmfid.cli.main import main
from tests.command import run_command

pytestmark = pytest.mark.usefixtures("without_judgement")


def test_every_command_says_what_it_does_in_one_line() -> None:
    text = CliRunner().invoke(main, ["--help"], terminal_width=80).output
    lines = [line for line in text.partition("Commands:\n")[2].splitlines() if line]
    assert len(re.findall(r"^  \w", "\n".join(lines), re.M)) == sum(
        not command.hidden for command in main.commands.values()
    )
    assert "..." not in text.partition("Commands:\n")[2]


def test_what_the_demo_writes_can_be_identified_as_it_stands(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    demo(["--out", str(tmp_path)])
    command = capsys.readouterr().out.partition("next: ")[2].split()[:-2]
    assert command[:2] == ["pmfid", "identify"]
    result = run_command(*command[1:])
    assert "mass" in result.output
