"""The command of a user, run in the process of the test."""

from __future__ import annotations

from click.testing import CliRunner, Result

from pmfid.cli.main import main


def counted_axis(dt: float, resolution: float, input_gain: float) -> str:
    """Return an AXIS.toml for a log with the columns u and counts. Its last section is [model]."""
    return f"""
[record]
input = "u"
output = "counts"
output_kind = "counts"
dt = {dt}
[encoder]
resolution = {resolution}
[model]
input_gain = {input_gain}
"""


def run_command(*words: object, code: int = 0, stdin: bytes | None = None) -> Result:
    """Run `pmfid` with these words, and require its exit code."""
    result = CliRunner().invoke(main, [str(word) for word in words], input=stdin)
    assert result.exit_code == code, result.output
    return result
