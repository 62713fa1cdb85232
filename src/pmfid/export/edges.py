"""What an export of the recursion over edges differs in from the other exports."""

from __future__ import annotations

import re
import zlib

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.edge_times import Lattice, Trajectory, read_edge_times
from pmfid.errors import UsageError
from pmfid.estimators.configuration import check_arrays
from pmfid.estimators.plants import COULOMB_PART, VISCOUS_PART
from pmfid.estimators.redge import REdge
from pmfid.export.c_text import initializer, literal
from pmfid.export.samples import Samples, make_up_input, moving_part
from pmfid.kernel.saved import config_number, edge_configuration, tight_edge_state, tight_edge_structures
from pmfid.kernel.structures import EDGE_HEADERS, Structures, header, layout_number

#: Example motion with edges: counts per sample at full speed, time constant [samples], and instants in a sample.
EDGES_PER_SAMPLE = 3.0
EDGES_SLOW = 10.0
EDGES_INSTANTS = 20

#: Patterns of the copied sources, and those of the other exports among them.
COPIED = (
    "pmf.h",
    "pmf_internal.h",
    "pmf_bytes.inl",
    "pmf_state.c",
    "pmf_alarm.c",
    "edges/*.[ch]",
    "edges/*.inl",
    "LICENSE",
)
#: Templates in place of those of the other exports.
INSTEAD = {"main.c.j2": "edges_main.c.j2", "sketch.ino.j2": "edges_sketch.ino.j2"}
#: Files in addition to those of the other exports, by template.
FURTHER = {
    "edges_zephyr.c.j2": "examples/zephyr/src/main.c",
    "edges_zephyr.cmake.j2": "examples/zephyr/CMakeLists.txt",
    "edges_zephyr.conf.j2": "examples/zephyr/prj.conf",
}


def make_up_edges(estimator: REdge) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Return input, counts and ages (n,) of a body that reverses and rests."""
    from pmfid._kernel64 import simulate

    u, dt, gain, parts = make_up_input(), estimator.dt, float(estimator.model.input_gain), EDGES_INSTANTS
    step, fine = estimator.encoder.resolution, dt / parts
    viscous = VISCOUS_PART * abs(gain) * dt / (EDGES_PER_SAMPLE * step)
    coulomb = COULOMB_PART * abs(gain)
    body = [viscous * EDGES_SLOW * dt, viscous, viscous, coulomb, coulomb, 0.0, 0.0]
    velocity, *_ = simulate(body, gain, fine, np.repeat(u, parts))
    place = np.concatenate([[0.0], np.cumsum(np.asarray(velocity)[:-1])]) * fine
    path, lines = Trajectory.sample(place, fine), Lattice(step, 0.3 * step, np.zeros(1))
    counts, ages = read_edge_times(path, lines, parts, estimator.tick)
    return u, counts - 100, ages  # the counter wraps


def record_edges(estimator: REdge, types: Structures, u: ArrayLike, counts: ArrayLike, ages: ArrayLike) -> Samples:
    """Run an estimator with the same configuration from its start over u, counts and ages (n,).

    Raises UsageError for a record that is empty or has an input that is not finite.
    """
    from pmfid.estimators.configuration import configuration_of

    inputs, read = check_arrays(u, counts)
    if inputs.size == 0 or not np.all(np.isfinite(inputs)):
        raise UsageError("the samples of the self-test must be finite, and at least one; take another record")
    real = types["pmf_line_t"]["sum"]
    given, times = inputs.astype(real), np.nan_to_num(np.asarray(ages, real), nan=-1.0)
    own = REdge(**configuration_of(estimator))  # type: ignore[arg-type]
    expected = []
    for value, count, age in zip(given.tolist(), read.tolist(), times.tolist(), strict=True):
        own.step(value, count, age)
        expected.append(zlib.crc32(tight_edge_state(own.kernel, own.precision).tobytes()))
    return Samples(given, read.astype(np.uint32), np.array(expected, np.uint32), own.theta, times)


def describe_edges(estimator: REdge, record: tuple[ArrayLike, ...] | None) -> dict[str, object]:
    """Return the values of the templates that depend on the estimator.

    `record` has input, counts and ages (n,) for the self-test.
    """
    config = edge_configuration(estimator.kernel, estimator.precision)
    types = tight_edge_structures(config, estimator.precision)
    if record is None:
        samples = record_edges(estimator, types, *make_up_edges(estimator))
    else:
        part = moving_part(np.asarray(record[1], np.int64))
        samples = record_edges(estimator, types, *(np.asarray(column)[part] for column in record))
    rows = zip(samples.timing, samples.u, samples.counts, samples.expected, strict=True)  # type: ignore[arg-type]
    sources = "".join(map(header, ("pmf.h", *EDGE_HEADERS)))
    return {
        "estimator": estimator,
        "edges": True,
        "tick": estimator.tick or 1e-6,
        "equation": estimator.model.equation.text,
        "macros": {
            "PMF_WITH_EDGES": 1,
            "PMF_MAX_LINES": max(1, int(config["lines"])),
            "PMF_BODY": int(config["parameters"]),
        },
        "config_number": config_number(config, types),
        "layout": layout_number(types["pmf_state_t"]),
        "functions": sorted(set(re.findall(r"\b(pmf_\w+)\(", sources))),
        "sizes": {name: types[f"pmf_{name}_t"].itemsize for name in ("state", "config", "saved")},
        "config": initializer(config),
        "samples": [(f"{literal(age)}, ", literal(u), f"{count}U", f"0x{crc:08x}U") for age, u, count, crc in rows],
        "theta": samples.theta.tolist(),
        "recorded": record is not None,
    }
