"""The exported C has the same bits on this computer and on emulated microcontrollers; its states, folder and
command.
"""

from __future__ import annotations

import re
import subprocess
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import pytest

import pmfid
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.registry import OFF_LINE, RECURSIVE
from pmfid.export.samples import record_run
from pmfid.kernel.saved import configuration
from pmfid.kernel.structures import structures
from tests.conftest import cart_run, long_unless
from tests.firmware.build import (
    CLANG,
    GCC,
    HERE,
    M4F,
    M7,
    REQUIRED,
    WARNINGS,
    Target,
    command,
    compiled,
    links,
    objects,
    run,
)
from tests.firmware.replay import PREFIX, difference, exported
from tests.refusals import refused
from tests.test_many import process_record
from tests.test_redge import estimator_of, swing

DT, CUTOFF = 0.01, 100 / 3
PRECISIONS = ("float32", "float64")
SELFTEST, EXAMPLE = "examples/selftest/selftest.c", "examples/main/main.c"
FIRMWARE_PAGE = Path(__file__).parents[1] / "docs" / "howto" / "firmware.md"


def make(cls: type[RecursiveEstimator], precision: str = "float32", **options: object) -> RecursiveEstimator:
    encoder = pmfid.Encoder(cart_run(1, samples=10, increments=512).encoder.resolution, bits=16, max_speed=5.0)
    drive = options.pop("drive", pmfid.Drive(input_gain=2.0))
    return cls(drive, encoder, DT, CUTOFF, **{"forgetting": 0.995, "precision": precision, **options})


def hostile(samples: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """Return a cart's run with a bad input, a jump of the counts, a rest, and numbers beyond float32."""
    run = cart_run(1, samples=samples, increments=512)
    u, counts = run.u.copy(), run.counts.copy()
    u[300], u[301], u[1150], u[1151] = np.nan, np.inf, 1e30, -1e30
    counts[600:] += 20_000
    counts[800:900] = counts[800]
    return u, counts


KERNELS = [(cls, precision) for cls in RECURSIVE for precision in PRECISIONS]
#: Cases of `make test`: the method with the most code in both precisions, the other methods each in one.
OFTEN = [(pmfid.RIV, "float32"), (pmfid.RIV, "float64"), (pmfid.BCRLS, "float32"), (pmfid.RLS, "float64")]
BUILDS = {(GCC, "-O3"): OFTEN[2:], (CLANG, "-O2"): OFTEN[2:3], (M4F, "-O2"): OFTEN[:1], (M7, "-O3"): OFTEN[1:2]}


@pytest.fixture(scope="module")
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    cls, precision = request.param
    return exported(make(cls, precision), tmp_path_factory.mktemp("export"), *hostile())


# --- the same bits ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("folder", "target", "optimize"),
    [
        pytest.param(
            kernel,
            *build,
            marks=[build[0].needed, *([] if kernel in often else [pytest.mark.long])],
            id=f"{kernel[0].__name__}-{kernel[1]}-{build[0].name}{build[1]}",
        )
        for kernel in KERNELS
        for build, often in BUILDS.items()
    ],
    indirect=["folder"],
)
def test_exported_code_computes_the_bits_of_python(folder: Path, target: Target, optimize: str) -> None:
    assert difference(folder, target, optimize, *WARNINGS) is None


FMA = "fma" in Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else False
#: Compiler options that change the arithmetic.
SPOILING = (
    ("-ffast-math",),
    *([("-mfma", "-ffp-contract=fast")] if FMA else []),
    ("-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math"),
    ("-ffinite-math-only",),
)
VARIANTS = {
    "offset": {"drive": pmfid.Drive(2.0, offset=True)},
    "spring": {"drive": pmfid.Drive(2.0, spring=True)},
    "friction": {"drive": pmfid.Drive(2.0, friction="directional")},
    "shapes": {"drive": pmfid.Drive(2.0, stribeck=0.05, quadratic=True, cogging=0.01)},
    "places": {"drive": pmfid.Drive(2.0, gravity=True)},
    "late": {"drive": pmfid.Drive(2.0, dead_time=0.017)},
    "after a lag": {"drive": pmfid.Drive(2.0, dead_time=0.017, lag=0.006)},
    "order": {"order": 4},
}

#: Variants of `make test`: each part of the kernel that an export may leave out.
OFTEN_VARIED = ("offset", "shapes", "late")


@GCC.needed
@pytest.mark.parametrize(
    ("variant", "cls"),
    long_unless(
        lambda variant, cls: cls is pmfid.RIV and variant in OFTEN_VARIED,
        product(VARIANTS, RECURSIVE),
    ),
)
def test_every_configuration_is_exported(variant: str, cls: type[RecursiveEstimator], tmp_path: Path) -> None:
    try:
        estimator = make(cls, "float32", **VARIANTS[variant])
    except pmfid.UsageError:
        pytest.skip("this method does not have it")
    assert difference(exported(estimator, tmp_path, *hostile()), GCC, "-O0", *WARNINGS) is None


@pytest.mark.parametrize("variant", ["shapes", "after a lag"])
@pytest.mark.parametrize(
    "target",
    [pytest.param(t, marks=[t.needed, *([pytest.mark.long] if t is M4F else [])], id=t.name) for t in (CLANG, M4F, M7)],
)
@pytest.mark.long
def test_shapes_and_dead_times_have_the_bits_of_python_everywhere(target: Target, variant: str, tmp_path: Path) -> None:
    """The two recursions have different sizes, so that no compiler may assume a common size."""
    estimator = make(pmfid.RIV, "float32", **VARIANTS[variant])
    assert difference(exported(estimator, tmp_path, *hostile()), target, "-O3", *WARNINGS) is None


PROCESS = pmfid.TransferFunction(2, 1, delay=2, offset=True)
PROCESSES = {
    "rls": (pmfid.RLS, {}),
    "bcrls": (pmfid.BCRLS, {}),
    "start": (pmfid.RLS, {"model": pmfid.TransferFunction(2, 0, initial_conditions=True)}),
    "order": (pmfid.BCRLS, {"model": pmfid.TransferFunction(3, 1)}),
}

#: Numbers of the samples of `hostile` that follow a gap: in motion, after a bad input, in a rest, and twice in a row.
GAPS = (250, 302, 850, 1100, 1101)


def gaps_differ(estimator: RecursiveEstimator, folder: Path, u: np.ndarray, counts: np.ndarray) -> tuple[bool, bool]:
    """Return whether the exported C differs from Python, with the gaps reported to it and without."""
    exported(estimator, folder, u, counts, GAPS)
    reported = f"-DGAPS={','.join(map(str, GAPS))}"
    programs = ([reported, *WARNINGS], WARNINGS)
    with_gaps, without = (difference(folder, GCC, "-O0", *options) is not None for options in programs)
    return with_gaps, without


@GCC.needed
@pytest.mark.parametrize(("cls", "precision"), long_unless(lambda *kernel: kernel == OFTEN[0], OFTEN))
def test_lost_samples_have_the_bits_of_python(cls: type[RecursiveEstimator], precision: str, tmp_path: Path) -> None:
    """pmf_gap() on the drive equals the `gap` of the kernel: the estimates and the whole state have the same bits."""
    u, counts = (np.delete(column, slice(1000, 1090)) for column in hostile())
    assert gaps_differ(make(cls, precision), tmp_path, u, counts) == (False, True)


@GCC.needed
@pytest.mark.parametrize(
    ("cls", "precision"),
    long_unless(
        lambda cls, precision: (cls is pmfid.RIV) == (precision == "float64"),
        product([pmfid.RIV, pmfid.BCRLS, pmfid.RLS], PRECISIONS),
    ),
)
def test_a_step_that_varies_has_the_bits_of_python(
    cls: type[RecursiveEstimator], precision: str, tmp_path: Path
) -> None:
    u, counts = hostile()
    steps = DT * np.random.default_rng(8).uniform(0.1, 1.9, u.size)
    steps[[400, 900]] = np.nan, 1e9  # invalid steps of a clock
    estimator = make(cls, precision, steps="given")
    exported(estimator, tmp_path, u, counts, steps=steps)
    assert difference(tmp_path, GCC, "-O0", *WARNINGS) is None
    exported(make(cls, precision), tmp_path / "even", u, counts)
    sizes = [(folder / "pmf_sizes.h").read_text() for folder in (tmp_path, tmp_path / "even")]
    assert ["PMF_WITH_STEPS 1" in text for text in sizes] == [True, False]


@GCC.needed
@pytest.mark.long
def test_lost_samples_of_a_linear_process_have_the_bits_of_python(tmp_path: Path) -> None:
    u, counts = (np.delete(table[0], slice(1000, 1090)) for table in process_record())
    assert gaps_differ(process_estimator("bcrls", "float32"), tmp_path, u, counts) == (False, True)


def process_estimator(name: str, precision: str) -> RecursiveEstimator:
    cls, options = PROCESSES[name]
    encoder = pmfid.Encoder(1e-3, bits=16)
    settings = {"model": PROCESS, "encoder": encoder, "dt": DT, "cutoff": 10.0, "forgetting": 0.999}
    return cls(**(settings | options), precision=precision)


@GCC.needed
@pytest.mark.parametrize(
    ("name", "precision"),
    long_unless(
        lambda *case: case in (("bcrls", "float32"), ("order", "float32"), ("rls", "float64")),
        [(name, real) for name, (cls, _) in PROCESSES.items() for real in PRECISIONS[: 1 + (name == cls.method)]],
    ),
)
def test_linear_processes_are_exported(name: str, precision: str, tmp_path: Path) -> None:
    """Variants of the methods have only float32."""
    estimator = process_estimator(name, precision)
    u, counts = (table[0].copy() for table in process_record())
    u[1500], u[1501], counts[1600:] = np.nan, 1e30, counts[1600:] + 70_000
    assert difference(exported(estimator, tmp_path, u, counts), GCC, "-O0", *WARNINGS) is None
    assert "y'' + a0 y" in (tmp_path / "axis.h").read_text() or name == "order"
    assert selftest(tmp_path, GCC, *WARNINGS, optimize="-O0").returncode == 0
    resumed = process_estimator(name, precision)
    estimator.run(u[:1700], counts[:1700])
    resumed.set_state(estimator.get_state())
    assert np.array_equal(resumed.run(u[1700:], counts[1700:]).theta, estimator.run(u[1700:], counts[1700:]).theta)


@M4F.needed
@pytest.mark.long
@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_linear_process_on_a_microcontroller(precision: str, tmp_path: Path) -> None:
    u, counts = (table[1, :2000] for table in process_record())
    folder = exported(process_estimator("bcrls", precision), tmp_path, u, counts)
    assert difference(folder, M4F, "-O2", *WARNINGS) is None


# --- the self-test ----------------------------------------------------------------------------------------------------


def selftest(folder: Path, target: Target, *options: str, optimize: str = "-O2") -> subprocess.CompletedProcess[str]:
    """Compile the self-test of an export with further options and run it."""
    (config,) = folder.glob("*_config.c")
    prefix = config.name.removesuffix("_config.c")
    return run(compiled(folder, prefix, target, folder / SELFTEST, optimize, *options), target)


@GCC.needed
@pytest.mark.parametrize(("options", "words"), [({}, []), ({"steps": "given"}, ["OPTIMIZE=-O0"])])
def test_make_selftest_and_example_as_a_stranger_would(
    options: dict[str, object], words: list[str], tmp_path: Path
) -> None:
    pmfid.export_firmware(make(pmfid.RIV, **options), tmp_path)
    done = command(["make", "-s", *words, "selftest", "all", "example"], tmp_path)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")
    assert command(["./selftest"], tmp_path).stdout == "800 samples, the same bits\n"
    assert command(["./example"], tmp_path).returncode == 0


@GCC.needed
@pytest.mark.parametrize(
    "folder",
    [pytest.param(kernel, marks=[] if kernel in BUILDS[GCC, "-O3"] else pytest.mark.long) for kernel in KERNELS],
    indirect=True,
    ids=str,
)
def test_every_export_has_a_self_test_and_an_example_that_run(folder: Path) -> None:
    """The test uses the objects of the test of bits. RIV has them in the test above."""
    assert selftest(folder, GCC, *WARNINGS, optimize="-O3").stdout == "800 samples, the same bits\n"
    example = compiled(folder, PREFIX, GCC, folder / EXAMPLE, "-O3", *WARNINGS)
    assert run(example, GCC).returncode == 0


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize(
    "target", [pytest.param(target, marks=target.needed, id=target.name) for target in (GCC, CLANG)]
)
@pytest.mark.long
def test_the_canary_finds_spoilt_arithmetic(target: Target, precision: str, tmp_path: Path) -> None:
    pmfid.export_firmware(make(pmfid.RLS, precision), tmp_path)
    assert selftest(tmp_path, target).returncode == 0
    for options in SPOILING:
        spoilt = selftest(tmp_path, target, *options)
        assert (spoilt.returncode, spoilt.stdout[:11]) == (255, "options of "), options


# --- compilers and checkers -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("target", "optimize", "precision"),
    [
        pytest.param(
            target, optimize, precision, marks=[target.needed, *often[precision]], id=f"{target.name}-{precision}"
        )
        for target, optimize, often in (
            (GCC, "-O3", {"float32": [pytest.mark.long], "float64": []}),
            (CLANG, "-O2", {"float32": [], "float64": [pytest.mark.long]}),
            (M4F, "-O2", {"float32": [], "float64": [pytest.mark.long]}),
            (Target("g++", "g++", ("-x", "c++", "-std=c++17")), "-O2", {"float32": [pytest.mark.long], "float64": []}),
            (
                Target("clang++", "clang++", ("-x", "c++", "-std=c++17")),
                "-O2",
                {"float32": [pytest.mark.long], "float64": [pytest.mark.long]},
            ),
        )
        for precision in PRECISIONS
    ],
)
def test_every_file_compiles_without_a_warning(target: Target, optimize: str, precision: str, tmp_path: Path) -> None:
    """The kernel's C has the options of the test of bits above, which did not fail there."""
    pmfid.export_firmware(make(pmfid.RIV, precision), tmp_path)
    words = [target.compiler, *target.options, *(() if "c++" in target.options else ("-std=c99",))]
    files = [path.name for path in tmp_path.glob("*.c")] + [SELFTEST, EXAMPLE]
    assert {SELFTEST, EXAMPLE, "axis_config.c"} < set(files)
    if "c++" not in target.options:
        assert len(objects(tmp_path, target, optimize, *WARNINGS)) == len(files) - 3
        files = [SELFTEST, EXAMPLE, "axis_config.c"]
    done = command([*words, *WARNINGS, optimize, "-ffp-contract=off", "-I.", "-c", *files], tmp_path)
    assert (done.returncode, done.stderr) == (0, "")


#: Rules of MISRA C:2012 that the kernel breaks on purpose; docs/howto/firmware.md gives the reasons.
MISRA = set(re.findall(r"^\| (\d+\.\d+) \|", FIRMWARE_PAGE.read_text(encoding="utf-8"), re.MULTILINE))


def export_files(kind: str, folder: Path) -> list[str]:
    """Export the drive or the process with the most code, or edges, and return the C files."""
    if kind == "edges":
        *record, step = swing(16)
        pmfid.export_firmware(estimator_of(step, precision="float32", memory=8.0), folder, record=tuple(record))
    else:
        pmfid.export_firmware(make(pmfid.RIV) if kind == "drive" else process_estimator("bcrls", "float32"), folder)
    return sorted(path.name for path in folder.glob("*.c"))


KINDS = pytest.mark.parametrize("kind", ["drive", "process", "edges"])


@Target("", "cppcheck").needed
@KINDS
@pytest.mark.long
def test_misra_finds_only_what_is_justified(kind: str, tmp_path: Path) -> None:
    """Each export is checked with only its own macros."""
    files = export_files(kind, tmp_path)
    options = [
        "--std=c99",
        "-UPMF_LANES",
        "-DONE_CONFIGURATION",
        "-I.",
    ]  # without -D the checker guesses a dozen others
    done = command(["cppcheck", "--addon=misra", *options, *files], tmp_path)
    if "Bailing out from" in done.stderr or "failed to execute" in done.stderr.lower():
        pytest.skip("this cppcheck has no working MISRA addon")
    found = set(re.findall(r"misra-c2012-(\d+\.\d+)", done.stderr))
    assert "15.5" in found, "the checker has looked at nothing"
    assert found <= MISRA


@Target("", "clang-tidy").needed
@KINDS
@pytest.mark.long
def test_clang_tidy_finds_nothing(kind: str, tmp_path: Path) -> None:
    options = [f"--config-file={Path(__file__).parents[1] / '.clang-tidy'}", "--quiet", *export_files(kind, tmp_path)]
    done = command(["clang-tidy", *options, "--", "-std=c99", "-I."], tmp_path)
    assert (done.returncode, done.stdout) == (0, "")


@GCC.needed
@pytest.mark.long
def test_sanitizers_find_nothing(tmp_path: Path) -> None:
    folder = exported(make(pmfid.RIV), tmp_path, *hostile())
    assert difference(folder, GCC, "-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover") is None


@CLANG.needed
@pytest.mark.parametrize("cls", [pmfid.BCRLS, pmfid.RIV])
def test_fuzzing_for_a_while_finds_nothing(cls: type[RecursiveEstimator], tmp_path: Path) -> None:
    sanitize = ("-fsanitize=fuzzer,undefined", "-fno-sanitize-recover=all")
    if not links(CLANG, "-fsanitize=fuzzer", "-Dmain=LLVMFuzzerTestOneInput"):
        pytest.skip("this clang has no libFuzzer")
    pmfid.export_firmware(make(cls), tmp_path)
    program = compiled(tmp_path, "axis", CLANG, HERE / "fuzz.c", "-O2", *sanitize)
    options = ["-max_total_time=3", "-max_len=600", "-len_control=0", "-seed=1"]
    done = command([f"./{program.name}", *options], tmp_path)
    assert done.returncode == 0, done.stderr[-2000:]
    assert int(re.search(r"steps: (\d+)", done.stderr)[1]) > 1000


# --- saved states -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("cls", "precision"), long_unless(lambda *kernel: kernel in OFTEN, KERNELS))
def test_interrupted_after_any_sample_it_goes_on_with_the_same_bits(
    cls: type[RecursiveEstimator], precision: str
) -> None:
    u, counts = hostile()
    whole, resumed, done = make(cls, precision), make(cls, precision), 0
    for k in [*range(0, 60), *range(60, 1199, 41)]:
        for part in range(done, k + 1):
            whole.step(u[part], int(counts[part]))
        resumed.set_state(whole.get_state())
        for one in (whole, resumed):
            one.step(u[k + 1], int(counts[k + 1]))
        assert resumed.get_state() == whole.get_state()
        done = k + 2


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_flipped_bit_is_refused(precision: str) -> None:
    estimator = make(pmfid.BCRLS, precision)
    estimator.run(*hostile())
    state = estimator.get_state()
    for place in range(0, len(state), 3):
        damaged = bytearray(state)
        damaged[place] ^= 1 << place % 8
        refused(("checksum|configuration", partial(estimator.set_state, bytes(damaged))))
    estimator.set_state(state)


def test_the_header_is_read_as_the_compiler_lays_it_out() -> None:
    for precision in PRECISIONS:
        kernel, types = make(pmfid.RIV, precision).kernel, structures(None, precision)
        assert types["pmf_config_t"].itemsize == len(kernel.raw_config())
        assert types["pmf_state_t"].itemsize == len(kernel.raw_state())
        config = configuration(kernel, precision)
        assert config["direct"]["forgetting"] == np.asarray(0.995, kernel.dtype)
        assert config["encoder"]["count_mask"] == 2**16 - 1
        assert config["auxiliary"]["dt"] == np.asarray(DT, kernel.dtype)


def test_two_exports_are_the_same_bytes_and_the_kernel_is_unchanged(tmp_path: Path) -> None:
    one = pmfid.export_firmware(make(pmfid.BCRLS), tmp_path / "one")
    two = pmfid.export_firmware(make(pmfid.BCRLS), tmp_path / "two")
    assert [path.name for path in one] == [path.name for path in two]
    assert all(a.read_bytes() == b.read_bytes() for a, b in zip(one, two, strict=True))
    sources = {path.name: path for path in (Path(__file__).parents[1] / "csrc").rglob("pmf*")}
    copied = [path for path in one if path.name.startswith("pmf") and path.name != "pmf_sizes.h"]
    assert len(copied) >= 7
    assert all(path.read_bytes() == sources[path.name].read_bytes() for path in copied)
    other = pmfid.export_firmware(replace(make(pmfid.BCRLS), dt=0.02), tmp_path / "other")
    assert any(a.read_bytes() != b.read_bytes() for a, b in zip(one, other, strict=True))


# --- the written files -----------------------------------------------------------------------------------------------


def test_what_cannot_be_exported_is_refused(tmp_path: Path) -> None:
    rls, whole = make(pmfid.RLS), [cls(pmfid.Drive(2.0), pmfid.Encoder(1e-5), DT, CUTOFF) for cls in OFF_LINE]
    (full := tmp_path / "full").mkdir()
    (full / "thesis.tex").write_text("")
    names = ("", "1st", "Axis", "a-b", "pmf", "pmf_x")
    refused(
        *(("begin with a letter", partial(pmfid.export_firmware, rls, tmp_path, prefix=prefix)) for prefix in names),
        *(("needs a whole record", partial(pmfid.export_firmware, made, tmp_path)) for made in whole),
        (r"thesis\.tex", lambda: pmfid.export_firmware(rls, full)),
        ("at least one; take another record", lambda: record_run(rls, [], [])),
        ("at least one; take another record", lambda: record_run(rls, [np.nan], [0])),
    )
    assert len(record_run(rls, [1.0], [0]).u) == 1


@GCC.needed
def test_two_axes_in_one_program(tmp_path: Path) -> None:
    """The axes have different methods and precisions, each with its own kernel."""
    pmfid.export_firmware(make(pmfid.BCRLS, "float32"), tmp_path / "x", prefix="x")
    pmfid.export_firmware(make(pmfid.RIV, "float64"), tmp_path / "y", prefix="y")
    objects = []
    for name in ("x", "y"):
        done = command(["make", "-s", "OPTIMIZE=-O0", f"lib{name}.a"], tmp_path / name)
        assert (done.returncode, done.stderr) == (0, "")
        flags = ["-I.", "-c", SELFTEST, "-DSELFTEST_NO_MAIN", "-o", f"{name}_selftest.o"]
        assert command(["gcc", *REQUIRED, *flags], tmp_path / name).returncode == 0
        objects += [f"{name}/{name}_selftest.o", f"{name}/lib{name}.a"]
    declared = "unsigned x_selftest(void); unsigned y_selftest(void);"
    (tmp_path / "main.c").write_text(f"{declared} int main(void) {{ return (int)(x_selftest() | y_selftest()); }}")
    assert command(["gcc", "main.c", *objects, "-o", "both"], tmp_path).returncode == 0
    assert command(["./both"], tmp_path).returncode == 0
