"""`export_firmware`: a folder of C with the bits of a configured estimator."""

from __future__ import annotations

import re
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from pmfid.errors import UsageError
from pmfid.estimators.base import Estimator
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.export.alarm import ParameterAlarm
from pmfid.export.initializer import initializer, literal
from pmfid.export.names import check_names, remark
from pmfid.export.samples import made_up_record, moving_part, record_run
from pmfid.kernel.saved import configuration, recursions_of, shape_of
from pmfid.kernel.structures import (
    HEADERS,
    Structured,
    header,
    layout_number,
    resize_structure,
    source_folder,
    structures,
)

#: Template -> file in the folder; NAME is the prefix.
FILES = {
    "axis.h.j2": "NAME.h",
    "config.c.j2": "NAME_config.c",
    "sizes.h.j2": "pmf_sizes.h",
    "main.c.j2": "main.c",
    "selftest.c.j2": "selftest.c",
    "selftest_data.h.j2": "selftest_data.h",
    "Makefile.j2": "Makefile",
    "CMakeLists.txt.j2": "CMakeLists.txt",
}
COPIED = ("*.c", "*.h", "LICENSE")
#: What sends samples to `pmfid serve`.
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
    """Writes the estimator as C99 into a folder: kernel, configuration, header, example, build files and self-test.

    The C computes the same bits as the estimator. prefix: of all names, an identifier of C. record: (n,) inputs and
    (n,) counts of the axis for the self-test; None: of a made-up motion. alarms: on parameters of the estimate.
    blocks: with the encoder of blocks for `pmfid serve`. Same arguments, same bytes. Returns the files. Raises
    UsageError for an off-line method, a prefix or names of parameters that would not compile, a folder with other
    things in it, an alarm that cannot be, or a record that is empty or not finite, and OSError where the folder cannot
    be written.
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
        (folder / file).write_bytes(content)
    return sorted(folder / name for name in [*names.values(), *(path.name for path in copied)])


def source_files(pattern: str) -> list[Path]:
    """Files of the kernel, or the licence, which a checkout has one floor up."""
    found = list(source_folder().glob(pattern))
    return found or list(source_folder().parent.glob(pattern))


def _check_folder(folder: Path, prefix: str, files: set[str]) -> None:
    present = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
    others = sorted(present - files)
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
    shape = shape_of(config)
    types = structures(shape, precision)
    if record is None:
        samples = record_run(estimator, *made_up_record(estimator))
    else:
        u, counts = np.asarray(record[0], np.float64), np.asarray(record[1], np.int64)
        part = moving_part(counts)
        samples = record_run(estimator, u[part], counts[part])
    rows = zip(samples.u, samples.counts, samples.expected, strict=True)
    return {
        "version": pmfid.__version__,
        "prefix": prefix,
        "PREFIX": prefix.upper(),
        "estimator": estimator,
        "equation": estimator.equation.text,
        "macros": shape.macros(),
        "fixed": fixed_recursion(config),
        "layout": layout_number(types["pmf_state_t"]),
        "functions": sorted(set(re.findall(r"\b(pmf_\w+)\(", "".join(map(header, HEADERS))))),
        "sizes": {name: types[f"pmf_{name}_t"].itemsize for name in ("state", "config", "saved")},
        "config": initializer(resize_structure(config, types["pmf_config_t"])),
        "samples": [(literal(u), f"{count}U", f"0x{crc:08x}U") for u, count, crc in rows],
        "theta": samples.theta.tolist(),
        "recorded": record is not None,
    }


def fixed_recursion(config: Structured) -> tuple[int, int, int] | None:
    """Number of parameters, whether there are instruments, and scheme of forgetting, if all recursions agree."""
    kinds = {(int(one["n_parameters"]), int(one["instrumental"]), int(one["scheme"])) for one in recursions_of(config)}
    return kinds.pop() if len(kinds) == 1 else None
