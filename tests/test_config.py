"""AXIS.toml: the accepted content, and the one error text for all other content."""

from __future__ import annotations

from pathlib import Path

import pytest

from pmfid.config.axis import Axis, check_sampling, load_axis
from pmfid.errors import NotIdentifiableError, PmfidError, UsageError, did_you_mean

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


def test_errors_form_one_family() -> None:
    assert issubclass(UsageError, PmfidError)
    assert issubclass(NotIdentifiableError, PmfidError)
    assert not issubclass(NotIdentifiableError, UsageError)


@pytest.mark.parametrize(
    ("word", "expected"), [("cutof", "; did you mean 'cutoff'?"), ("U", "; did you mean 'u'?"), ("zzz", "")]
)
def test_did_you_mean(word: str, expected: str) -> None:
    assert did_you_mean(word, ["cutoff", "u"]) == expected


def test_minimal_file_gets_the_defaults(tmp_path: Path) -> None:
    axis = load_axis(write(tmp_path), {})
    assert (axis.record.output_kind, axis.record.dt, axis.record.input_scale) == ("position", None, 1.0)
    assert (axis.encoder.bits, axis.encoder.standstill_time, axis.encoder.max_speed) == (None, 0.2, None)
    assert (axis.model.kind, axis.model.input_gain, axis.model.offset) == ("drive", 2.0, False)
    estimator = axis.estimator
    assert (estimator.method, estimator.order, estimator.forgetting) == ("auto", 2, 1.0)
    assert (estimator.discretization, estimator.precision) == ("matched", "float64")
    assert estimator.prefilter_zeros is None


def test_axis_is_frozen(tmp_path: Path) -> None:
    axis = load_axis(write(tmp_path))
    with pytest.raises(ValueError, match="frozen"):
        axis.estimator.cutoff = 1.0  # type: ignore[misc]


def test_overrides_go_before_the_file_and_none_is_ignored(tmp_path: Path) -> None:
    overrides = {
        "estimator.cutoff": 20.0,
        "encoder.resolution": None,
        "record.dt": 0.01,
        "model.offset": True,
    }
    axis = load_axis(write(tmp_path), overrides)
    assert (axis.estimator.cutoff, axis.encoder.resolution, axis.record.dt) == (20.0, 1e-3, 0.01)
    assert axis.model.offset is True


def test_the_estimator_has_a_default_and_overrides_can_supply_a_whole_section(tmp_path: Path) -> None:
    path = write(tmp_path, MINIMAL.replace("[estimator]\ncutoff = 50.0\n", ""))
    assert load_axis(path).estimator.cutoff is None
    assert load_axis(path, {"estimator.cutoff": 30.0}).estimator.cutoff == 30.0
    assert "[encoder] is missing; give a section with at least the resolution" in message(
        write(tmp_path, MINIMAL.replace("[encoder]\nresolution = 1e-3\n", ""))
    )


def test_a_transfer_function_needs_the_pole_of_its_filters(tmp_path: Path) -> None:
    process = MINIMAL.replace("input_gain = 2", 'kind = "transfer_function"\nn = 1\nm = 0')
    assert load_axis(write(tmp_path, process)).estimator.pole == 50.0
    text = message(write(tmp_path, process.replace("cutoff = 50.0", "")))
    assert text.startswith("[estimator] cutoff is missing")
    assert "near the poles of the process" in text


def test_bad_override_is_named_as_option(tmp_path: Path) -> None:
    text = message(write(tmp_path), {"estimator.cutoff": -3.0})
    assert text.startswith("[estimator] cutoff = -3.0 (given as an option): it should be greater than 0; give ")


def test_input_scale_is_a_number_or_a_name(tmp_path: Path) -> None:
    path = write(tmp_path)
    assert load_axis(path, {"record.input_scale": -2.5}).record.input_scale == -2.5
    assert load_axis(path, {"record.input_scale": "gtau"}).record.input_scale == "gtau"


def test_prefilter_zeros_from_a_toml_list(tmp_path: Path) -> None:
    path = write(tmp_path, MINIMAL + "prefilter_zeros = [-30, -60.5]\n")
    assert load_axis(path).estimator.prefilter_zeros == (-30.0, -60.5)


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("cutoff = 50.0", "cutoff = 0", ("[estimator] cutoff = 0:", "greater than 0", "rad/s")),
        ("cutoff = 50.0", "cutoff = nan", ("[estimator] cutoff = nan:", "finite")),
        ("cutoff = 50.0", 'cutoff = "50"', ("[estimator] cutoff = '50':", "valid number")),
        ("resolution = 1e-3", "", ("[encoder] resolution is missing; give the unit of y per count",)),
        ("cutoff = 50.0", "cutof = 50.0", ("[estimator] cutof is an unknown key", "did you mean 'cutoff'?")),
        (
            "[estimator]\n",
            "[estimator]\nbits = 8\n",
            ("[estimator] bits is an unknown key", "belongs in [encoder]"),
        ),
        ("[record]\n", "cutoff = 1.0\n[record]\n", ("[cutoff] is an unknown", "belongs in [estimator]")),
        (
            "[estimator]\n",
            "[estimater]\n",
            ("[estimater] is an unknown section", "did you mean 'estimator'?"),
        ),
        ("[record]\n", "encoder = 3\n[record]\n", ("not valid TOML", "line 6")),
        ("cutoff = 50.0", "cutoff = 50.0\norder = 7", ("[estimator] order = 7:", "2 to 6")),
        ("cutoff = 50.0", "cutoff = 50.0\norder = 2.5", ("[estimator] order = 2.5:", "2 to 6")),
        ("cutoff = 50.0", "cutoff = 50.0\nforgetting = 1.2", ("forgetting = 1.2:", "use 1 - dt/T")),
        ("cutoff = 50.0", "cutoff = 50.0\nforgetting = 0.0", ("forgetting = 0.0:", "(0, 1]")),
        ("cutoff = 50.0", 'cutoff = 50.0\nmethod = "svd"', ("[estimator] method = 'svd':", "'bcrls'")),
        (
            "cutoff = 50.0",
            "cutoff = 50.0\nprefilter_zeros = [-3.0, 4.0]",
            ("prefilter_zeros = [-3.0, 4.0]:", "less"),
        ),
        ("cutoff = 50.0", "cutoff = 50.0\nprefilter_zeros = [-3.0, -3.0]", ("the two zeros must differ",)),
        ("cutoff = 50.0", "cutoff = 50.0\nprefilter_zeros = [-3.0]", ("prefilter_zeros", "two different")),
        (
            "resolution = 1e-3",
            "resolution = -1e-3",
            ("[encoder] resolution = -0.001:", "unit of y per count"),
        ),
        ("resolution = 1e-3", "resolution = 1e-3\nbits = 33", ("[encoder] bits = 33:", "1 to 32")),
        (
            "resolution = 1e-3",
            "resolution = 1e-3\nstandstill_time = 0",
            ("standstill_time = 0:", "time in s"),
        ),
        ("resolution = 1e-3", "resolution = 1e-3\nmax_speed = inf", ("max_speed = inf:", "finite")),
        ("input_gain = 2", "input_gain = inf", ("[model] input_gain = inf:", "finite", "N per unit of u")),
        ("input_gain = 2", "input_gain = true", ("[model] input_gain = True:", "valid number")),
        ("input_gain = 2", "input_gain = 2\noffset = 1", ("[model] offset = 1:", "true to identify")),
        ("input_gain = 2", 'input_gain = 2\nkind = "siso"', ("[model] kind = 'siso':", "'drive'")),
        ('time = "t"\n', "", ("[record]: time and dt are both missing",)),
        ('time = "t"\n', "dt = 0.0\n", ("[record] dt = 0.0:", "sample period in s")),
        ('output = "y"', 'output = "u"', ("[record]: input, output and time must be different",)),
        ('output = "y"', 'output = ""', ("[record] output = '':", "at least 1 character")),
        ('output = "y"', 'output = "y"\noutput_kind = "volts"', ("output_kind = 'volts':", "'counts'")),
        ('output = "y"', 'output = "y"\ninput_scale = 0', ("input_scale = 0:", "neither zero")),
        ('output = "y"', 'output = "y"\ninput_scale = true', ("[record] input_scale = True:", "a factor")),
    ],
)
def test_what_is_not_allowed_is_named_with_value_and_remedy(
    tmp_path: Path, old: str, new: str, parts: tuple[str, ...]
) -> None:
    text = changed(tmp_path, old, new)
    for part in parts:
        assert part in text


def test_a_value_in_place_of_a_section(tmp_path: Path) -> None:
    text = message(write(tmp_path, "encoder = 3\n" + MINIMAL.replace("[encoder]\nresolution = 1e-3\n", "")))
    assert text == "[encoder] must be a section of keys"


def test_several_problems_come_in_one_error_in_the_order_of_the_sections(tmp_path: Path) -> None:
    path = write(tmp_path, MINIMAL.replace("1e-3", "0").replace("50.0", "-1"))
    first, second = message(path).split("\n  ")
    assert first.startswith("[encoder] resolution = 0:")
    assert second.startswith("[estimator] cutoff = -1:")


def test_a_misspelt_key_comes_before_the_missing_one(tmp_path: Path) -> None:
    first, second = changed(tmp_path, "resolution = 1e-3", "resolutio = 1e-3").split("\n  ")
    assert first.endswith("guard, edge_age, lines, tick; did you mean 'resolution'?")
    assert second.startswith("[encoder] resolution is missing")


def test_a_wrong_input_scale_gives_one_line(tmp_path: Path) -> None:
    assert "\n" not in changed(tmp_path, 'output = "y"', 'output = "y"\ninput_scale = true')


def test_toml_syntax_error_names_the_line(tmp_path: Path) -> None:
    assert "line 2" in message(write(tmp_path, "[record]\ninput = u\n"))


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


def test_a_byte_order_mark_is_harmless(tmp_path: Path) -> None:
    assert load_axis(write(tmp_path, "\ufeff" + MINIMAL)).estimator.cutoff == 50.0


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


def test_a_message_stops_after_ten_problems(tmp_path: Path) -> None:
    keys = "\n".join(f"wrong{k} = 1" for k in range(40_000))
    (tmp_path / "axis.toml").write_text(f"[record]\n{keys}\n")
    with pytest.raises(UsageError) as refused:
        load_axis(tmp_path / "axis.toml")
    lines = str(refused.value).splitlines()
    assert len(lines) == 11
    assert "wrong0 is an unknown key" in lines[0]
    assert "more problems" in lines[-1]


def test_an_unknown_kind_is_the_only_problem(tmp_path: Path) -> None:
    """Only the kind decides whether an encoder is needed."""
    text = (Path(__file__).parents[1] / "examples" / "second_order.toml").read_text()
    path = tmp_path / "axis.toml"
    path.write_text(text.replace('"transfer_function"', '"transferfunction"'))
    with pytest.raises(UsageError) as caught:
        load_axis(path)
    assert str(caught.value).startswith(
        f"{path}: [model] kind = 'transferfunction': it should be 'drive', 'equation' or "
    )
    assert "\n" not in str(caught.value)
