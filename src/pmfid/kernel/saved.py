"""Saved states, which Python and firmware exchange as bytes."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pmfid.errors import UsageError
from pmfid.kernel.structures import (
    KernelSizes,
    Structured,
    Structures,
    constants_of,
    edge_structures,
    layout_number,
    resize_structure,
    structures,
    whole_words,
)

if TYPE_CHECKING:
    from pmfid._kernel64 import EdgeKernel, Kernel, ManyKernel


def configuration(kernel: Kernel, precision: str) -> Structured:
    """Return the configuration of the kernel in the layout of the module."""
    return np.frombuffer(kernel.raw_config(), structures(None, precision)["pmf_config_t"])[0]  # type: ignore[no-any-return]


def shape_of(config: Structured) -> KernelSizes:
    """Return the sizes and parts of the kernel that a configuration needs."""
    network = config["network"]
    shapes = config["auxiliary"]["shapes"]
    recursions = recursions_of(config)
    parameters = max(int(recursion["n_parameters"]) for recursion in recursions)
    process = config["encoder"]["process"] or any(np.any(recursion["target_noise"]) for recursion in recursions)
    nodes = {*network["stage"]["source"].tolist(), *network["tap"]["node"].tolist()}
    return KernelSizes(
        max_stages=max(1, int(network["n_stages"])),
        max_taps=int(network["tap_end"][int(network["n_columns"]) - 1]),
        max_parameters=parameters,
        max_misreads=parameters if config["encoder"]["misread"] else 1,
        max_columns=int(network["n_columns"]),
        max_shapes=int(shapes["n"]),
        max_knots=knots_of(shapes),
        max_rates=max(1, 4 * -(-int(network["n_rates"]) // 4)),  # the kernel computes four rules at once
        max_late=max(1, int(config["late"]["kept"])),
        with_dead_time=int(config["late"]["kept"] > 0),
        with_auxiliary=int(config["auxiliary"]["enabled"] or shapes["n"] > 0),
        with_process=int(process),
        with_guard=int(config["encoder"]["guard"] > 0),
        with_split=int(
            bool(process)
            or config["late"]["kept"] > 0
            or place_matters(shapes)
            or any(node in split_signals(bool(config["encoder"]["turns"])) for node in nodes)
        ),
        with_misread=int(config["encoder"]["misread"]),
        with_steps=int(config["encoder"]["rate"] > 0),
    )


def firmware_shape(config: Structured) -> KernelSizes:
    """Return the sizes and parts of an export, whose network is code."""
    return replace(shape_of(config), with_network=0)


def place_matters(shapes: Structured) -> bool:
    """Return whether any shape depends on the position."""
    return bool(np.any(shapes["shape"]["of"][: int(shapes["n"])] >= constants_of(None)["PMF_OF_PLACE"]))


def knots_of(shapes: Structured) -> int:
    """Return the number of knots in the tables of a `pmf_shapes_config_t`."""
    used = shapes["shape"][: int(shapes["n"])]
    return int(max(used["first"] + used["intervals"] + 1, default=0))


def recursions_of(config: Structured) -> list[Structured]:
    """Return the recursions that a configuration uses."""
    return [config["direct"], config["instrument"]] if config["auxiliary"]["enabled"] else [config["direct"]]


def split_signals(turns: bool) -> list[int]:
    """Return the nodes that only some models and methods use. With `turns` the node of reversals is not among them. Nor
    are the nodes of misread counts."""
    constants = constants_of(None)
    others = {constants[f"PMF_MISREAD_{name}"] for name in ("INPUT", "DIRECTION", "MOVING")}
    nodes = range(constants["PMF_MOVING"], constants["PMF_SIGNALS"])
    return [node for node in nodes if node not in others and not (turns and node == constants["PMF_TURN"])]


def tight_state(kernel: Kernel, precision: str, shape: KernelSizes, *, kept: bool = False) -> Structured:
    """Return the state in the layout of firmware with sizes `shape`; `kept` selects the form that is saved."""
    own = np.frombuffer(kernel.raw_state(kept), structures(None, precision)["pmf_state_t"])[0]
    state = resize_structure(own, structures(shape, precision)["pmf_state_t"])
    if not shape.with_split:
        state["network"]["node"][split_signals(bool(shape.with_steps))] = 0
        state["encoder"]["change"] = state["encoder"]["travel"] = 0
    return state


def save_state(kernel: Kernel, precision: str) -> bytes:
    """Return the bytes of the `pmf_saved_t` that firmware with the kernel's configuration would write."""
    config = configuration(kernel, precision)
    shape = shape_of(config)
    types = structures(shape, precision)
    return _write_saved(config, tight_state(kernel, precision, shape, kept=True), types)


def load_state(kernel: Kernel, precision: str, data: bytes) -> None:
    """Restore the kernel's state from bytes of `save_state` or firmware. Raises UsageError for other bytes."""
    config = configuration(kernel, precision)
    state = _read_saved(config, data, structures(shape_of(config), precision))
    own = structures(None, precision)["pmf_state_t"]
    with _refused_in_one_sentence():
        kernel.set_raw_state(resize_structure(state, own).tobytes())


def edge_configuration(kernel: EdgeKernel, precision: str) -> Structured:
    """Return the `pmf_redge_config_t` of a recursion over edges."""
    return np.frombuffer(kernel.raw_config(), edge_structures(0, precision)["pmf_config_t"])[0]  # type: ignore[no-any-return]


def tight_edge_structures(config: Structured, precision: str) -> Structures:
    """Return the structures of firmware with this configuration of a recursion over edges."""
    return edge_structures(int(config["lines"]), precision, int(config["parameters"]))


def tight_edge_state(kernel: EdgeKernel, precision: str) -> Structured:
    """Return the state of a recursion over edges in the layout of firmware."""
    config = edge_configuration(kernel, precision)
    own = edge_structures(int(config["lines"]), precision)["pmf_state_t"]
    tight = tight_edge_structures(config, precision)["pmf_state_t"]
    return resize_structure(np.frombuffer(kernel.raw_state(), own)[0], tight)


def save_edge_state(kernel: EdgeKernel, precision: str) -> bytes:
    """Return the bytes of the `pmf_saved_t` that firmware with this recursion over edges would write."""
    config = edge_configuration(kernel, precision)
    return _write_saved(config, tight_edge_state(kernel, precision), tight_edge_structures(config, precision))


def load_edge_state(kernel: EdgeKernel, precision: str, data: bytes) -> None:
    """Restore a recursion over edges from bytes of `save_edge_state` or firmware. Raises UsageError for other bytes."""
    config = edge_configuration(kernel, precision)
    state = _read_saved(config, data, tight_edge_structures(config, precision))
    own = edge_structures(int(config["lines"]), precision)["pmf_state_t"]
    with _refused_in_one_sentence():
        kernel.set_raw_state(resize_structure(state, own).tobytes())


def _write_saved(config: Structured, state: Structured, types: Structures) -> bytes:
    saved = _envelope(config, types)
    saved["state"] = state
    saved["checksum"] = _checksum(saved.tobytes(), types)
    return saved.tobytes()


def _read_saved(config: Structured, data: bytes, types: Structures) -> Structured:
    """Return the state in the bytes of a `pmf_saved_t`. Raises UsageError for bytes of another configuration."""
    data, expected = read_bytes(data), _envelope(config, types)
    if len(data) != types["pmf_saved_t"].itemsize:
        raise UsageError(_FOREIGN)
    saved = np.frombuffer(data, types["pmf_saved_t"])[0]
    if saved["checksum"] != _checksum(data, types):
        raise UsageError(_DAMAGED)
    if any(saved[name] != expected[name] for name in ("magic", "version", "layout", "size", "config")):
        raise UsageError(_FOREIGN)
    return saved["state"]  # type: ignore[no-any-return]


def take_guard(kernel: Kernel, other: Kernel, precision: str) -> None:
    """Copy the samples that the guard holds from `other` to a kernel at its start. Both kernels have one encoder."""
    own, known = (
        np.frombuffer(one.raw_state(), structures(None, precision)["pmf_state_t"]).copy() for one in (kernel, other)
    )
    own["guard"] = known["guard"]
    kernel.set_raw_state(own.tobytes())


def set_model(kernel: Kernel, values: Sequence[float], precision: str) -> None:
    """Give the auxiliary model of a kernel the values of its roles."""
    state = np.frombuffer(kernel.raw_state(), structures(None, precision)["pmf_state_t"]).copy()
    state["auxiliary"]["parameter"][0, : len(values)] = values
    kernel.set_raw_state(state.tobytes())


def fleet_layout(kernel: Kernel, precision: str) -> bytes:
    """Return the `pmf_layout_t` of csrc/many/pmf_many.h: the numbers of a state that a fleet keeps, reals first.

    A fleet keeps what firmware with the kernel's configuration has, without the values that each step computes again.
    Without vectors for the configuration, `lane_words` is 0.
    """
    config, state = configuration(kernel, precision), structures(None, precision)["pmf_state_t"]
    firmware = structures(shape_of(config), precision)["pmf_state_t"]
    kept = np.frombuffer(kernel.kept_bytes(), state)[0]
    used = np.frombuffer(resize_structure(resize_structure(kept, firmware), state).tobytes(), np.uint32) != 0
    whole, size = np.frombuffer(whole_words(precision), np.bool_), np.dtype(precision).itemsize
    first = whole | (np.arange(whole.size) * 4 % size == 0)  # of two words of a real, only the first counts
    lane = np.cumsum(first) - 1
    reals, integers = np.flatnonzero(used & first & ~whole), np.flatnonzero(used & whole)
    words = np.concatenate([reals, integers])
    sizes = np.repeat([size, 4], [reals.size, integers.size])
    packed = -(-int(sizes.sum()) // 8) * 8
    alone = config["late"]["kept"] or config["auxiliary"]["shapes"]["n"] or config["encoder"]["rate"] > 0
    head = [reals.size, words.size, packed, 0 if alone else lane[-1] + 1]
    rows = np.column_stack([4 * words, np.cumsum(sizes) - sizes, lane[words]])
    return np.concatenate([head, rows.ravel()]).astype("<u4").tobytes()


#: Envelope of the states of several axes. `layout` and `config` identify the structure and the configuration of a
#: state, and `size` is its number of bytes. The checksum is the CRC-32 of the preceding words and the states.
HEAD = np.dtype([(name, "<u4") for name in ("magic", "version", "layout", "config", "axes", "size", "checksum")])
FLEET_MAGIC = 0x46464D50  # the bytes "PMFF"


def make_head(kind: tuple[int, int], layout: int, config: int, shape: tuple[int, ...]) -> Structured:
    """Return the envelope of states without the checksum. `kind` is the magic number and the version, and `shape` the
    number of axes and the bytes of each."""
    return np.array((*kind, layout, config, *shape, 0), HEAD)


def seal_parts(parts: Sequence[bytes | memoryview]) -> list[bytes | memoryview]:
    """Return an envelope and the states after it with the checksum. Any thread may compute it."""
    head = np.frombuffer(parts[0], HEAD)[0].copy()
    checksum = zlib.crc32(head.tobytes()[:-4])
    for part in parts[1:]:
        checksum = zlib.crc32(part, checksum)
    head["checksum"] = checksum
    return [memoryview(head.tobytes()), *parts[1:]]


def check_sealed(data: bytes, head: Structured, foreign: str, damaged: str) -> None:
    """Raise UsageError with one of the texts unless the bytes are the envelope `head` with its states."""
    place = HEAD.itemsize
    if len(data) != place + int(head["axes"]) * int(head["size"]):
        raise UsageError(foreign)
    checksum = zlib.crc32(memoryview(data)[place:], zlib.crc32(data[: place - 4]))
    if np.frombuffer(data[:place], HEAD)[0]["checksum"] != checksum:
        raise UsageError(damaged)
    if data[: place - 4] != head.tobytes()[:-4]:
        raise UsageError(foreign)


def save_fleet(kernel: ManyKernel, precision: str) -> bytes:
    """Return the states of all axes of a `ManyKernel`, after an envelope that identifies their configuration."""
    return b"".join(seal_parts([fleet_head(kernel, precision).tobytes(), kernel.states.tobytes()]))


def load_fleet(kernel: ManyKernel, precision: str, data: bytes) -> None:
    """Restore the states of a `ManyKernel` from bytes of `save_fleet`. Raises UsageError for other bytes."""
    data = read_bytes(data)
    check_sealed(data, fleet_head(kernel, precision), _FOREIGN_FLEET, _DAMAGED)
    with _refused_in_one_sentence():
        kernel.set_states(np.frombuffer(data, np.uint8, offset=HEAD.itemsize).reshape(kernel.states.shape))


def fleet_head(kernel: ManyKernel, precision: str) -> Structured:
    """Return the envelope of a fleet's states without the checksum."""
    layout, config = layout_number(structures(None, precision)["pmf_state_t"]), zlib.crc32(kernel.raw_config())
    return make_head((FLEET_MAGIC, kernel.packing), layout, config, kernel.states.shape)


def read_bytes(state: object) -> bytes:
    """Return a saved state as bytes. Raises UsageError for anything else."""
    if not isinstance(state, bytes | bytearray | memoryview):
        raise UsageError(f"a state must be bytes from get_state, got {type(state).__name__}")
    return bytes(state)


@contextmanager
def _refused_in_one_sentence() -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise UsageError(f"{error}; start from an older state, or without a state") from None


_DAMAGED = "these bytes are not a state or are damaged: the checksum is wrong; start from an older state"
_FOREIGN_FLEET = (
    "these bytes are not the states of this fleet; take states from a fleet with the same estimator and number of axes"
)

_FOREIGN = (
    "these bytes are not a state of this configuration; take a state from an estimator with the same method, model, "
    "encoder, dt, filters, precision and version"
)


def _envelope(config: Structured, types: Structures) -> Structured:
    """Return a `pmf_saved_t` that identifies the configuration, without state and checksum."""
    constants = constants_of(None)
    saved = np.zeros((), types["pmf_saved_t"])
    saved["magic"], saved["version"] = constants["PMF_STATE_MAGIC"], constants["PMF_STATE_VERSION"]
    saved["layout"] = layout_number(types["pmf_state_t"])
    saved["size"] = saved.dtype.itemsize
    saved["config"] = config_number(config, types)
    return saved


def config_number(config: Structured, types: Structures) -> int:
    """Return the CRC-32 of a configuration in its tight layout."""
    return zlib.crc32(resize_structure(config, types["pmf_config_t"]).tobytes())


def _checksum(data: bytes, types: Structures) -> int:
    saved = np.zeros((), types["pmf_saved_t"])
    head, state = (saved[name].ctypes.data - saved.ctypes.data for name in ("checksum", "state"))
    return zlib.crc32(data[state:], zlib.crc32(data[:head]))
