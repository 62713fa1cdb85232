"""The command of a user, run in the process of the test."""

from __future__ import annotations

from click.testing import CliRunner, Result

from pmfid.cli.main import main


def run_command(*words: object, code: int = 0, stdin: bytes | None = None) -> Result:
    """Run `pmfid` with these words, and require its exit code."""
    result = CliRunner().invoke(main, [str(word) for word in words], input=stdin)
    assert result.exit_code == code, result.output
    return result
