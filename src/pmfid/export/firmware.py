"""Export of firmware, with a copy of the kernel and a generated configuration."""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from pmfid.errors import UsageError
from pmfid.estimators.base import Estimator
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.redge import REdge
from pmfid.export import edges
from pmfid.export.c_text import check_names, initializer, literal, remark
from pmfid.export.samples import made_up_record, moving_part, record_run
from pmfid.kernel.saved import config_number, configuration, firmware_shape, recursions_of, shape_of
from pmfid.kernel.structures import (
    HEADERS,
    Structured,
    constants_of,
    header,
    layout_number,
    resize_structure,
    source_folder,
    structures,
)

#: An estimator that runs on a drive.
Exportable = RecursiveEstimator | REdge

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

    def interval(self, estimator: Exportable) -> int:
        """Return the number of samples between used estimates. Raises UsageError for an estimator that never
        forgets.
        """
        rate = estimator.rate if isinstance(estimator, REdge) else 1 - estimator.forgetting
        if rate == 0:
            raise UsageError(
                "an alarm needs forgetting below 1: without forgetting, an estimate does not follow a change"
            )
        return math.ceil(MEMORIES / rate)

    def structure(self, estimator: Exportable) -> Structured:
        """Return the `pmf_alarm_config_t`. Raises UsageError for a parameter that the estimator does not have."""
        if self.parameter not in estimator.names:
            raise UsageError(
                f"the parameter of an alarm must be one of {list(estimator.names)}, got {self.parameter!r}"
            )
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
COPIED = ("*.c", "*.h", "*.inl", "code/*.c", "LICENSE")
#: Sources that send samples to `pmfid serve`.
BLOCKS = ("wire/pmf_block.c", "wire/pmf_block.h")


def export_firmware(
    estimator: Estimator | REdge,
    folder: str | Path,
    *,
    prefix: str = "axis",
    record: tuple[ArrayLike, ...] | None = None,
    alarms: Sequence[ParameterAlarm] = (),
    blocks: bool = False,
) -> list[Path]:
    """Write the estimator as C99 into a folder: kernel, configuration, header, example, build files and self-test.

    The C computes the same bits as the estimator. The same arguments give the same bytes.

    Parameters
    ----------
    estimator : recursive estimator or REdge
    folder : path
    prefix : str
        Prefix of all names, an identifier of C.
    record : arrays (n,), optional
        Input and counts of the axis for the self-test, and the ages of edges for `REdge`. By default the self-test has
        a made-up motion.
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
    if not isinstance(estimator, Exportable):
        raise UsageError(
            f"{estimator.method} needs a whole record and cannot run sample by sample; export rls, bcrls, riv or REdge"
        )
    check_names(prefix, estimator.names)
    folder = Path(folder)
    over_edges = isinstance(estimator, REdge)
    files = FILES
    if over_edges:
        files = {edges.INSTEAD.get(name, name): file for name, file in FILES.items()} | edges.FURTHER
    names = {template: file.replace("NAME", prefix) for template, file in files.items()}
    patterns = [*(edges.COPIED if over_edges else COPIED), *(BLOCKS if blocks else ())]
    absent = {"pmf_sizes.h"} if isinstance(estimator, REdge) else absent_files(estimator)
    copied = sorted({path for pattern in patterns for path in source_files(pattern) if path.name not in absent})
    _check_folder(folder, prefix, {*names.values(), *(path.name for path in copied)})
    texts = _render(
        files,
        _name_export(prefix)
        | (edges.describe_edges(estimator, record) if isinstance(estimator, REdge) else _context(estimator, record))
        | {"sources": sorted(path.name for path in copied if path.suffix == ".c")}
        | {"alarms": alarms, "alarm_initializers": [initializer(alarm.structure(estimator), 1) for alarm in alarms]},
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


def absent_files(estimator: RecursiveEstimator) -> set[str]:
    """Return the sources of the parts that the kernel of an estimator does not need."""
    shape = shape_of(configuration(estimator.kernel, estimator.precision))
    absent = {"pmf_sizes.h", "pmf_network.c", "pmf_network_code.c" if shape.with_steps else "pmf_network_steps.c"}
    if not shape.with_auxiliary:
        absent |= {"pmf_auxiliary.c", "pmf_shapes.inl", "pmf_verdicts.c", "pmf_instrument.c"}
    if not shape.with_guard:
        absent |= {"pmf_guard.c", "pmf_outlier.c"}
    return absent


def _check_folder(folder: Path, prefix: str, files: set[str]) -> None:
    present = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
    others = sorted(present - {Path(file).parts[0] for file in files})
    if others and f"{prefix}.h" not in present:
        raise UsageError(f"{folder} contains other files, for example {others[0]}; give an empty folder")


def _render(files: Collection[str], context: Mapping[str, object]) -> dict[str, str]:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("pmfid.export"), undefined=StrictUndefined, keep_trailing_newline=True, trim_blocks=True
    )
    environment.globals["zip"] = zip
    environment.filters["remark"] = remark
    return {template: environment.get_template(template).render(context) for template in files}


def _name_export(prefix: str) -> dict[str, object]:
    import pmfid

    return {"version": pmfid.__version__, "prefix": prefix, "PREFIX": prefix.upper()}


def _context(estimator: RecursiveEstimator, record: tuple[ArrayLike, ...] | None) -> dict[str, object]:
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
    steps = [""] * samples.u.size if samples.timing is None else [f"{literal(step)}, " for step in samples.timing]
    rows = zip(steps, samples.u, samples.counts, samples.expected, strict=True)
    kinds = {(int(one["n_parameters"]), int(one["instrumental"])) for one in recursions_of(config)}
    return {
        "estimator": estimator,
        "edges": False,
        "equation": estimator.equation.text,
        "macros": shape.macros(),
        "fixed": kinds.pop() if len(kinds) == 1 else None,  # of all recursions, if they agree
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
    """Return the stages of a varying step, whose gain and memory follow their rate. The memory keeps the preceding
    value of a signal. That of an earlier stage is a variable."""
    listed, first = list[str](), constants_of(None)["PMF_SIGNALS"]
    for k, stage in enumerate(network["stage"][: int(network["n_stages"])]):
        source, rate = int(stage["source"]), int(stage["rate"])
        b0, b1 = (literal(stage[name][()]) for name in ("b0", "b1"))
        last = f"memory[{k}]" if source < first else f"was{source - first}"
        if rate and stage["b1"]:
            listed.append(f"FOLLOW({k}, {source}, {last}, {b0}, {b1}, gain{rate}, keep{rate})")
        elif rate:
            listed.append(f"CANCELLED({k}, {source}, {b0}, gain{rate}, keep{rate})")
        else:
            listed.append(f"DELAYED({k}, {last})" if stage["b1"] else f"WRITTEN({k})")
        if source < first and stage["b1"]:
            listed.append(f"REMEMBER({k}, {source})")
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
