"""AXIS.toml: the accepted content, and the one error text for all other content."""

from __future__ import annotations

from pathlib import Path

import pytest

from pmfid.config.axis import Axis, check_sampling, load_axis
from pmfid.errors import UsageError

EXAMPLES = Path(__file__).parents[1] / "examples"
MINIMAL = """\
[record]
input = "u"
output = "y"
time = "t"
[encoder]
resolution = 1e-3
[model]
input_gain = 2
[estimator]
cutoff = 50.0
"""


def write(folder: Path, text: str = MINIMAL) -> Path:
    path = folder / "axis.toml"
    path.write_text(text, encoding="utf-8")
    return path


def message(path: Path, overrides: dict[str, object] | None = None) -> str:
    with pytest.raises(UsageError) as caught:
        load_axis(path, overrides)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert "pydantic" not in text
    return text.removeprefix(f"{path}: ")


def changed(folder: Path, old: str, new: str) -> str:
    assert MINIMAL.count(old) == 1
    return message(write(folder, MINIMAL.replace(old, new)))


def test_keys_that_are_left_out_given_and_replaced(tmp_path: Path) -> None:
    path = write(tmp_path, "\ufeff" + MINIMAL + "prefilter_zeros = [-30, -60.5]\n")
    overrides = {"estimator.cutoff": 20.0, "encoder.resolution": None, "record.dt": 0.01, "record.input_scale": "gtau"}
    axis = load_axis(path, {**overrides, "model.offset": True})
    assert (axis.estimator.cutoff, axis.encoder.resolution, axis.record.dt) == (20.0, 1e-3, 0.01)
    assert (axis.model.offset, axis.record.input_scale) == (True, "gtau")
    assert axis.estimator.prefilter_zeros == (-30.0, -60.5)
    axis = load_axis(write(tmp_path, MINIMAL.replace("[estimator]\ncutoff = 50.0\n", "")))
    assert (axis.record.output_kind, axis.record.dt, axis.record.input_scale) == ("position", None, 1.0)
    assert (axis.encoder.bits, axis.encoder.standstill_time, axis.encoder.max_speed) == (None, 0.2, None)
    assert (axis.model.kind, axis.model.input_gain, axis.model.offset) == ("drive", 2.0, False)
    assert (axis.estimator.method, axis.estimator.order, axis.estimator.cutoff) == ("auto", 2, None)
    assert (axis.estimator.forgetting, axis.estimator.precision) == (1.0, "float64")


CUTOFF, STEP, GAIN, OUTPUT = "cutoff = 50.0", "resolution = 1e-3", "input_gain = 2", 'output = "y"'
#: Text of MINIMAL, what stands there instead, and the beginning and the end of what is said.
WRONG = [
    (CUTOFF, "cutoff = 0", "[estimator] cutoff = 0:", "rad/s"),
    (CUTOFF, "cutoff = nan", "[estimator] cutoff = nan:", "finite"),
    (CUTOFF, 'cutoff = "50"', "[estimator] cutoff = '50':", "valid number"),
    (CUTOFF, "cutof = 50.0", "[estimator] cutof is an unknown key", "did you mean 'cutoff'?"),
    (CUTOFF, CUTOFF + "\norder = 7", "[estimator] order = 7:", "2 to 6"),
    (CUTOFF, CUTOFF + "\norder = 2.5", "[estimator] order = 2.5:", "2 to 6"),
    (CUTOFF, CUTOFF + "\nforgetting = 1.2", "[estimator] forgetting = 1.2:", "use 1 - dt/T"),
    (CUTOFF, CUTOFF + "\nforgetting = 0.0", "[estimator] forgetting = 0.0:", "(0, 1]"),
    (CUTOFF, CUTOFF + '\nmethod = "svd"', "[estimator] method = 'svd':", "'bcrls'"),
    (CUTOFF, CUTOFF + "\nprefilter_zeros = [-3.0, 4.0]", "[estimator] prefilter_zeros = [-3.0, 4.0]:", "less"),
    (CUTOFF, CUTOFF + "\nprefilter_zeros = [-3.0, -3.0]", "[estimator] prefilter_zeros", "the two zeros must differ"),
    (CUTOFF, CUTOFF + "\nprefilter_zeros = [-3.0]", "[estimator] prefilter_zeros", "two different"),
    (STEP, "", "[encoder] resolution is missing; give the unit of y per count", ""),
    (STEP, "resolution = -1e-3", "[encoder] resolution = -0.001:", "unit of y per count"),
    (
        STEP,
        "resolutio = 1e-3",
        "[encoder] resolutio is an",
        "did you mean 'resolution'?\n  [encoder] resolution is missing",
    ),
    (STEP, STEP + "\nbits = 33", "[encoder] bits = 33:", "1 to 32"),
    (STEP, STEP + "\nstandstill_time = 0", "[encoder] standstill_time = 0:", "time in s"),
    (STEP, STEP + "\nmax_speed = inf", "[encoder] max_speed = inf:", "finite"),
    (GAIN, "input_gain = inf", "[model] input_gain = inf:", "N per unit of u"),
    (GAIN, "input_gain = true", "[model] input_gain = True:", "valid number"),
    (GAIN, GAIN + "\noffset = 1", "[model] offset = 1:", "true to identify"),
    (GAIN, GAIN + '\nkind = "siso"', "[model] kind = 'siso': it should be 'drive', 'equation' or ", ""),
    ('time = "t"\n', "", "[record]: time and dt are both missing", ""),
    ('time = "t"\n', "dt = 0.0\n", "[record] dt = 0.0:", "sample period in s"),
    (OUTPUT, 'output = "u"', "[record]: input, output and time must be different", ""),
    (OUTPUT, 'output = ""', "[record] output = '':", "at least 1 character"),
    (OUTPUT, OUTPUT + '\noutput_kind = "volts"', "[record] output_kind = 'volts':", "'counts'"),
    (OUTPUT, OUTPUT + "\ninput_scale = 0", "[record] input_scale = 0:", "neither zero"),
    (OUTPUT, OUTPUT + "\ninput_scale = true", "[record] input_scale = True:", "a factor"),
    ("[estimator]\n", "[estimator]\nbits = 8\n", "[estimator] bits is an unknown key", "belongs in [encoder]"),
    ("[estimator]\n", "[estimater]\n", "[estimater] is an unknown section", "did you mean 'estimator'?"),
    ("[record]\n", "cutoff = 1.0\n[record]\n", "[cutoff] is an unknown", "belongs in [estimator]"),
    ("[record]\n", "encoder = 3\n[record]\n", "not valid TOML", "line 6"),
    ("[encoder]\nresolution = 1e-3\n", "", "[encoder] is missing; give a section with at least the resolution", ""),
]


@pytest.mark.parametrize(("old", "new", "begin", "remedy"), WRONG)
def test_what_is_not_allowed_is_named_with_value_and_remedy(
    tmp_path: Path, old: str, new: str, begin: str, remedy: str
) -> None:
    text = changed(tmp_path, old, new)
    assert text.startswith(begin)
    assert remedy in text
    assert text.count("\n") == remedy.count("\n")


def test_unreadable_configurations(tmp_path: Path) -> None:
    assert "No such file" in message(tmp_path / "absent.toml")
    assert "cannot read the configuration" in message(tmp_path)
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    assert "not UTF-8 text" in message(binary)
    empty = message(write(tmp_path, ""))
    required = [section for section, field in Axis.model_fields.items() if field.is_required()]
    assert len(required) == 3
    assert all(f"[{section}] is missing" in empty for section in required)


def test_check_sampling_names_the_largest_cutoff(tmp_path: Path) -> None:
    axis = load_axis(write(tmp_path))
    check_sampling(axis, 2 / 50.0)
    with pytest.raises(UsageError, match=r"cutoff = 50 rad/s .* Nyquist limit, .* at most 2/dt = 40 rad/s"):
        check_sampling(axis, 0.05)


def test_the_examples_load() -> None:
    emps, cart = load_axis(EXAMPLES / "emps.toml"), load_axis(EXAMPLES / "cart.toml")
    assert (emps.record.input_scale, emps.model.input_gain, emps.model.offset) == ("gtau", 1.0, True)
    assert (cart.record.output_kind, cart.encoder.resolution, cart.estimator.forgetting) == (
        "counts",
        22.75e-6,
        0.995,
    )
