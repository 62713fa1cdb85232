"""Export of firmware, with a copy of the kernel and a generated configuration."""

from __future__ import annotations

import math
import re
import shutil
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import SupportsInt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError
from pmfid.estimators.base import Estimator
from pmfid.estimators.configuration import check_arrays
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.kernel.saved import config_number, configuration, firmware_shape, recursions_of, shape_of, tight_state
from pmfid.kernel.structures import (
    HEADERS,
    Structured,
    header,
    layout_number,
    resize_structure,
    source_folder,
    structures,
)

INDENT = "    "


def literal(number: SupportsInt) -> str:
    """Return a number as a C constant. A float is hexadecimal, so that nothing is rounded.

    Raises ValueError for a float that is not finite, because C99 has no constant for it.
    """
    if isinstance(number, np.floating):
        if not np.isfinite(number):
            raise ValueError(f"{number} has no C constant")
        mantissa, _, exponent = float(number).hex().partition("p")
        mantissa = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
        return f"{mantissa}p{exponent}" + ("f" if number.dtype.itemsize == 4 else "")
    return f"{int(number)}U" if isinstance(number, np.unsignedinteger) else str(int(number))


def initializer(structure: Structured, level: int = 0) -> str:
    """Return a structure, or an array of structures, as a braced initialiser with a comment for each field.

    Fields are set by position and not by designators, so that C++17 also reads the initialiser.
    """
    inner = INDENT * (level + 1)
    lines = [
        f"{inner}{_value(structure[name], level + 1)}, /* {_remark(name, structure[name])} */"
        for name in structure.dtype.names or ()
    ]
    return "{\n" + "\n".join(lines) + f"\n{INDENT * level}}}"


def _remark(name: str, value: Structured) -> str:
    scalar_float = value.ndim == 0 and value.dtype.kind == "f"
    return f"{name} = {float(value):.9g}" if scalar_float else name


def _value(value: Structured, level: int) -> str:
    if value.ndim == 0:
        return initializer(value, level) if value.dtype.names else literal(value[()])
    if value.dtype.names:
        return _rows([_flat(row) for row in value], level)
    if value.ndim == 2:
        return _rows([_flat(row) for row in value], level)
    return _flat(value)


def _rows(rows: list[str], level: int) -> str:
    inner = INDENT * (level + 1)
    return "{\n" + "".join(f"{inner}{row},\n" for row in rows) + f"{INDENT * level}}}"


def _flat(row: Structured) -> str:
    """Return the numbers of an array, or the fields of a small structure, in one line."""
    values = [row[name] for name in row.dtype.names] if row.dtype.names else list(row)
    return "{" + ", ".join(literal(value[()]) for value in values) + "}"


#: Ends of the names that an export makes of its prefix for types.
TYPES = ("_t", "_saved_t", "_alarm_t")
#: Types of C99's library whose names end in one of the `TYPES`.
_PLAIN_TYPES = """
size ptrdiff wchar wint wctrans wctype mbstate time clock div ldiv lldiv fpos float double fenv fexcept imaxdiv
sig_atomic va_list intptr uintptr intmax uintmax ssize off
"""
_WIDTHS = [
    f"{sign}int{kind}{bits}" for sign in ("", "u") for kind in ("", "_least", "_fast") for bits in (8, 16, 32, 64)
]
C_TYPES = {f"{name}_t" for name in (*_PLAIN_TYPES.split(), *_WIDTHS)}
#: Other names that an export makes of its prefix in capitals.
TAKEN = {"H", "PARAMETERS", "ALARMS"}
#: ASCII for the signs of units.
PLAIN = str.maketrans({"µ": "u", "μ": "u", "°": "deg", "Ω": "Ohm", "²": "2", "³": "3", "·": " ", "⋅": " "})


def check_names(prefix: str, parameters: Sequence[str]) -> None:
    """Raise UsageError if a prefix or the names of the parameters would not compile."""
    if not re.fullmatch(r"[a-z][a-z0-9_]*", prefix) or prefix.startswith("pmf"):
        raise UsageError(
            "prefix must be lower-case letters, digits and _, begin with a letter, but not with pmf, as all names in "
            f"the C begin with it; got {prefix!r}, give another (--prefix)"
        )
    of_kernel = set(re.findall(r"\b\w+_t\b", "".join(map(header, HEADERS))))
    clash = sorted({prefix + end for end in TYPES} & (C_TYPES | of_kernel))
    if clash:
        raise UsageError(
            f"prefix {prefix!r} makes {clash[0]}, which C or the kernel has already; give another (--prefix)"
        )
    capitals = [name.upper() for name in parameters]
    for name, capital in zip(parameters, capitals, strict=True):
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
            raise UsageError(f"parameter {name!r} has letters that C has not; use a to z, digits and _ in its name")
        if capital in TAKEN or capitals.count(capital) > 1:
            raise UsageError(
                f"parameter {name!r} gives {prefix.upper()}_{capital}, which the C has already; give it another name"
            )


def remark(text: str) -> str:
    """Return a text for a comment in C: one line of ASCII that cannot end the comment."""
    plain = re.sub(r"[^ -~]|[\\?]", ".", text.translate(PLAIN))  # a question mark begins trigraphs
    return re.sub(r"\*(?=/)|/(?=\*)", ".", plain)


SAMPLES = 800
#: Number of samples between changes of the made-up input, and number of samples at rest.
CLOCK, REST = 23, 150


@dataclass(frozen=True)
class Samples:
    """Samples of the self-test.

    `u` (n,) is the input, and `counts` (n,) are the values of the counter. `expected` (n,) is the CRC-32 of the state
    after each sample. `theta` (p,) are the parameters after the last sample. `steps` (n,) are the times since the
    previous sample [s], or None for an even clock.
    """

    u: NDArray[np.floating]
    counts: NDArray[np.uint32]
    expected: NDArray[np.uint32]
    theta: NDArray[np.float64]
    steps: NDArray[np.floating] | None = None


def made_up_record(estimator: RecursiveEstimator) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return input and counts (n,) of a plant that suits the axis. A body reverses and rests, and its counter wraps."""
    u, axis = _input(SAMPLES), estimator
    return u, axis.plant.made_up_counts(axis.equation, u, axis.dt, axis.cutoff, axis.encoder.resolution)


def _input(samples: int) -> NDArray[np.float64]:
    """Return levels between -1 and 1 from a shift register of five bits, with a stretch of zeros."""
    register, levels = 0b10101, []
    for _ in range(samples // CLOCK + 1):
        register = register >> 1 | ((register ^ register >> 2) & 1) << 4
        levels.append((register - 15.5) / 15.5)
    u = np.repeat(levels, CLOCK)[:samples]
    u[samples // 2 : samples // 2 + REST] = 0.0
    return u


def record_run(estimator: RecursiveEstimator, u: ArrayLike, counts: ArrayLike) -> Samples:
    """Run the estimator from its start over u (n,) and counts (n,), without a change of the estimator's state.

    Raises UsageError for a record that is empty or not finite.
    """
    u, counts = check_arrays(u, counts)
    if u.size == 0 or not np.all(np.isfinite(u)):
        raise UsageError("the samples of the self-test must be finite, and at least one; take another record")
    kernel = estimator.make_kernel(estimator.forgetting)
    given = u.astype(kernel.dtype)
    steps = None if estimator.steps is None else _made_up_steps(estimator.dt, u.size).astype(kernel.dtype)
    shape = shape_of(configuration(kernel, estimator.precision))
    expected = []
    for value, count, step in zip(
        given.tolist(), counts.tolist(), [None] * u.size if steps is None else steps.tolist(), strict=True
    ):
        estimate = kernel.step(value, count, step)
        expected.append(zlib.crc32(tight_state(kernel, estimator.precision, shape).tobytes()))
    return Samples(given, counts.astype(np.uint32), np.array(expected, np.uint32), estimate.theta, steps)


def _made_up_steps(dt: float, samples: int) -> NDArray[np.float64]:
    """Return steps (n,) between a half and one and a half sample periods."""
    return np.asarray(dt * (0.5 + (7 * np.arange(samples) % 16) / 15))


def moving_part(counts: NDArray[np.int64]) -> slice:
    """Return the first SAMPLES samples of a record, from shortly before its first motion."""
    moves = np.flatnonzero(np.diff(counts))
    start = max(0, int(moves[0]) - 10) if moves.size else 0
    return slice(start, start + SAMPLES)


#: Logarithm of the likelihood ratio that raises an alarm. By chance, an alarm occurs about once in exp(10) = 22000
#: intervals.
THRESHOLD = 10.0
#: Distance between used estimates, in memories, at which their errors are nearly independent.
MEMORIES = 2.0


@dataclass(frozen=True)
class ParameterAlarm:
    """An alarm on a parameter by a two-sided cumulative sum of log-likelihood ratios (Page 1954).

    `parameter` is the name of the parameter, and `nominal` is its value in normal work. `shift` is the change that
    raises an alarm [unit of the parameter], > 0. `threshold` is the limit of the sum, > 0. Raises UsageError for a
    value outside these bounds.
    """

    parameter: str
    nominal: float
    shift: float
    threshold: float = THRESHOLD

    def __post_init__(self) -> None:
        for name, value in (("shift", self.shift), ("threshold", self.threshold)):
            if not (math.isfinite(value) and value > 0):
                raise UsageError(f"{name} of an alarm must be positive and finite, got {value}")
        if not math.isfinite(self.nominal):
            raise UsageError(f"nominal of an alarm must be finite, got {self.nominal}")

    def interval(self, estimator: RecursiveEstimator) -> int:
        """Return the number of samples between used estimates. Raises UsageError for an estimator that never
        forgets.
        """
        if estimator.forgetting == 1:
            raise UsageError("an alarm needs forgetting below 1: an estimate that remembers everything follows nothing")
        return math.ceil(MEMORIES / (1 - estimator.forgetting))

    def structure(self, estimator: RecursiveEstimator) -> Structured:
        """Return the `pmf_alarm_config_t`. Raises UsageError for a parameter that the estimator does not have."""
        if self.parameter not in estimator.names:
            raise UsageError(f"an alarm's parameter must be one of {list(estimator.names)}, got {self.parameter!r}")
        config = np.zeros((), structures(None, estimator.precision)["pmf_alarm_config_t"])
        config["parameter"] = estimator.names.index(self.parameter)
        config["interval"] = self.interval(estimator)
        for name in ("nominal", "shift", "threshold"):
            config[name] = getattr(self, name)
        return config


#: File in the folder for each template, where NAME is the prefix. Arduino, PlatformIO and Zephyr compile all C in the
#: folder itself, and no C below `examples`.
FILES = {
    "axis.h.j2": "NAME.h",
    "config.c.j2": "NAME_config.c",
    "sizes.h.j2": "pmf_sizes.h",
    "main.c.j2": "examples/main/main.c",
    "sketch.ino.j2": "examples/sketch/sketch.ino",
    "selftest.c.j2": "examples/selftest/selftest.c",
    "selftest_data.h.j2": "examples/selftest/selftest_data.h",
    "Makefile.j2": "Makefile",
    "CMakeLists.txt.j2": "CMakeLists.txt",
    "module.yml.j2": "zephyr/module.yml",
    "library.json.j2": "library.json",
    "library.properties.j2": "library.properties",
}
COPIED = ("*.c", "*.h", "LICENSE")
#: Sources that send samples to `pmfid serve`.
BLOCKS = ("wire/pmf_block.c", "wire/pmf_block.h")


def export_firmware(
    estimator: Estimator,
    folder: str | Path,
    *,
    prefix: str = "axis",
    record: tuple[ArrayLike, ArrayLike] | None = None,
    alarms: Sequence[ParameterAlarm] = (),
    blocks: bool = False,
) -> list[Path]:
    """Write the estimator as C99 into a folder: kernel, configuration, header, example, build files and self-test.

    The C computes the same bits as the estimator. The same arguments give the same bytes.

    Parameters
    ----------
    estimator : recursive estimator
    folder : path
    prefix : str
        Prefix of all names, an identifier of C.
    record : pair of array_like (n,), optional
        Input and counts of the axis for the self-test. By default the self-test has a made-up motion.
    alarms : sequence of ParameterAlarm
        Alarms on parameters of the estimate.
    blocks : bool
        Whether the encoder of blocks for `pmfid serve` is part of the export.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    UsageError
        The method is off-line, the prefix or the names of parameters would not compile, or the folder holds other
        files. An alarm is impossible, or a record is empty or not finite.
    OSError
        The folder cannot be written.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from pmfid import BCRLS, Drive, Encoder, export_firmware
    >>> with TemporaryDirectory() as folder:
    ...     files = export_firmware(BCRLS(Drive(1.0), Encoder(1e-5), 0.001, 50.0), folder + "/axis")
    >>> "main.c" in {file.name for file in files}
    True
    """
    if not isinstance(estimator, RecursiveEstimator):
        raise UsageError(f"{estimator.method} works on whole records; export rls, bcrls, rknown-step or riv")
    check_names(prefix, estimator.names)
    folder = Path(folder)
    names = {template: file.replace("NAME", prefix) for template, file in FILES.items()}
    patterns = [*COPIED, *(BLOCKS if blocks else ())]
    copied = sorted(
        {path for pattern in patterns for path in source_files(pattern)} - {source_folder() / "pmf_sizes.h"}
    )
    _check_folder(folder, prefix, {*names.values(), *(path.name for path in copied)})
    texts = _render(
        _context(estimator, prefix, record)
        | {"sources": sorted(path.name for path in copied if path.suffix == ".c")}
        | {"alarms": alarms, "alarm_initializers": [initializer(alarm.structure(estimator), 1) for alarm in alarms]}
    )
    contents = {file: texts[template].encode("ascii") for template, file in names.items()}
    folder.mkdir(parents=True, exist_ok=True)
    for path in copied:
        shutil.copyfile(path, folder / path.name)
    for file, content in contents.items():
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_bytes(content)
    return sorted(folder / name for name in [*names.values(), *(path.name for path in copied)])


def source_files(pattern: str) -> list[Path]:
    """Return files of the kernel, or the licence, which a checkout has one folder above."""
    found = list(source_folder().glob(pattern))
    return found or list(source_folder().parent.glob(pattern))


def _check_folder(folder: Path, prefix: str, files: set[str]) -> None:
    present = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
    others = sorted(present - {Path(file).parts[0] for file in files})
    if others and f"{prefix}.h" not in present:
        raise UsageError(f"{folder} has other things in it, for example {others[0]}; give an empty folder")


def _render(context: Mapping[str, object]) -> dict[str, str]:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("pmfid.export"), undefined=StrictUndefined, keep_trailing_newline=True, trim_blocks=True
    )
    environment.globals["zip"] = zip
    environment.filters["remark"] = remark
    return {template: environment.get_template(template).render(context) for template in FILES}


def _context(
    estimator: RecursiveEstimator, prefix: str, record: tuple[ArrayLike, ArrayLike] | None
) -> dict[str, object]:
    import pmfid

    kernel, precision = estimator.make_kernel(estimator.forgetting), estimator.precision
    config = configuration(kernel, precision)
    number = config_number(config, structures(shape_of(config), precision))
    shape = firmware_shape(config)
    types = structures(shape, precision)
    if record is None:
        samples = record_run(estimator, *made_up_record(estimator))
    else:
        u, counts = np.asarray(record[0], np.float64), np.asarray(record[1], np.int64)
        part = moving_part(counts)
        samples = record_run(estimator, u[part], counts[part])
    steps = [""] * samples.u.size if samples.steps is None else [f"{literal(step)}, " for step in samples.steps]
    rows = zip(steps, samples.u, samples.counts, samples.expected, strict=True)
    return {
        "version": pmfid.__version__,
        "prefix": prefix,
        "PREFIX": prefix.upper(),
        "estimator": estimator,
        "equation": estimator.equation.text,
        "macros": shape.macros(),
        "fixed": fixed_recursion(config),
        "listed": (list_stepped_stages if shape.with_steps else list_stages)(config["network"]),
        "columns": list_columns(config["network"]),
        "turns": int(config["encoder"]["turns"]),
        "rates": list_rates(config["network"]) if shape.with_steps else None,
        "config_number": number,
        "layout": layout_number(types["pmf_state_t"]),
        "functions": sorted(set(re.findall(r"\b(pmf_\w+)\(", "".join(map(header, HEADERS))))),
        "sizes": {name: types[f"pmf_{name}_t"].itemsize for name in ("state", "config", "saved")},
        "config": initializer(resize_structure(config, types["pmf_config_t"])),
        "samples": [(step, literal(u), f"{count}U", f"0x{crc:08x}U") for step, u, count, crc in rows],
        "theta": samples.theta.tolist(),
        "recorded": record is not None,
    }


def list_stages(network: Structured) -> str:
    """Return the stages as calls of the macros of pmf_network.c."""
    listed = list[str]()
    for k, stage in enumerate(network["stage"][: int(network["n_stages"])]):
        a, b0, b1 = (stage[name][()] for name in ("a", "b0", "b1"))
        place = f"{k}, {int(stage['source'])}"
        if (a, b0, b1) == (0, 0, 1):
            listed.append(f"DELAY({place})")
        elif b1 == -b0 != 0:
            listed.append(f"RISE({place}, {literal(a)}, {literal(b0)})")
        else:
            listed.append(f"STAGE({place}, {literal(a)}, {literal(b0)}, {literal(b1)})")
    return " ".join(listed)


def list_stepped_stages(network: Structured) -> str:
    """Return the stages of a varying step, whose gain and memory follow their rate."""
    listed = list[str]()
    for k, stage in enumerate(network["stage"][: int(network["n_stages"])]):
        place, rate = f"{k}, {int(stage['source'])}", int(stage["rate"])
        b0, b1 = (literal(stage[name][()]) for name in ("b0", "b1"))
        if rate and stage["b1"]:
            listed.append(f"FOLLOW({place}, {b0}, {b1}, gain{rate}, keep{rate})")
        elif rate:
            listed.append(f"CANCELLED({place}, {b0}, gain{rate}, keep{rate})")
        else:
            listed.append(f"{'DELAYED' if stage['b1'] else 'WRITTEN'}({place})")
    return " ".join(listed)


def list_columns(network: Structured) -> str:
    """Return the columns with their taps as calls of the macros of pmf_network.c."""
    listed, first = list[str](), 0
    for column, end in enumerate(network["tap_end"][: int(network["n_columns"])].tolist()):
        for index, tap in enumerate(network["tap"][first:end]):
            kind = "TAP" if index else "COLUMN"
            listed.append(f"{kind}({column}, {int(tap['node'])}, {literal(tap['weight'][()])})")
        first = end
    return " ".join(listed)


def list_rates(network: Structured) -> str:
    """Return the rules by which stages follow a varying step: half of the pole, the step, and the effect of the
    step on the gain. The first rule belongs to stages without a rate."""
    listed, rates = list[str](), network["rates"]
    for i in range(1, int(network["n_rates"])):
        step = "now" if rates["now"][i] else "before"
        effects = {"gain": "", "growth": f" * {step}", "square": " * square"}
        effect = next(literal(rates[name][i]) + factor for name, factor in effects.items() if rates[name][i])
        listed.append(f"RATE({i}, {literal(rates['half'][i])}, {step}, {effect})")
    return " ".join(listed)


def fixed_recursion(config: Structured) -> tuple[int, int, int] | None:
    """Return number of parameters, use of instruments, and scheme of forgetting, if all recursions agree."""
    kinds = {(int(one["n_parameters"]), int(one["instrumental"]), int(one["scheme"])) for one in recursions_of(config)}
    return kinds.pop() if len(kinds) == 1 else None
