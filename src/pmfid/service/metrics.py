"""What is counted as Prometheus's text format, version 0.0.4, with what the system says of the process."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

from pmfid.service.counters import Counters, Labels

__all__ = ["CONTENT_TYPE", "HELP", "exposition", "process_levels"]

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"

#: What a name means, for those that the service counts; others get their name in words.
HELP: dict[str, str] = {
    "pmfid_axes": "Axes of a configuration.",
    "pmfid_axes_silent": "Axes with an alarm that they send nothing.",
    "pmfid_checkpoint_bytes": "Size of the last checkpoint, in bytes.",
    "pmfid_checkpoint_errors_total": "Checkpoints that could not be written.",
    "pmfid_checkpoint_made_seconds": "Time that the engine took for the last checkpoint, in seconds.",
    "pmfid_checkpoint_seconds": "Time until the last checkpoint was on the disk, in seconds.",
    "pmfid_checkpoint_working": "1 while the last checkpoint could be written, else 0.",
    "pmfid_checkpoints_total": "Checkpoints on the disk.",
    "pmfid_deliveries_total": "Deliveries of sources that the engine has taken.",
    "pmfid_dropped_notices_total": "Notices that a sink was too slow or not there for.",
    "pmfid_dropped_rows_total": "Rows that a sink was too slow or not there for.",
    "pmfid_engine_busy_seconds_total": "Time in which the engine worked, in seconds.",
    "pmfid_events_total": "Events of axes, by kind.",
    "pmfid_inbox_deliveries": "Deliveries that wait for the engine.",
    "pmfid_deliveries_slower_total": "Deliveries whose estimates took longer than so many seconds.",
    "pmfid_latency_seconds": "Age of the oldest delivery of the last step when its estimates were there, in seconds.",
    "pmfid_lines_dropped_total": "Lines that are no samples, or came twice or too late.",
    "pmfid_page_browsers_dropped_total": "Browsers that did not read what the page sent.",
    "pmfid_page_refused_total": "Requests to the page that were refused, by reason.",
    "pmfid_page_rows_dropped_total": "Rows of an axis shown live that a browser was too slow for.",
    "pmfid_page_rows_missed_total": "Rows of an axis shown live that a browser did not get.",
    "pmfid_paused_seconds_total": "Time in which the whole process stood still, in seconds.",
    "pmfid_refused_total": "Rows and notices that a sink could not take whatever was tried.",
    "pmfid_samples_dropped_total": "Samples of blocks that came twice or too late.",
    "pmfid_samples_missing_total": "Samples that never came: gaps.",
    "pmfid_samples_total": "Samples that went through a monitor.",
    "pmfid_samples_without_input_total": "Samples whose input was lost: NaN.",
    "pmfid_sink_errors_total": "Attempts to write that a sink failed in; what it was given was tried again.",
    "pmfid_sink_rows_total": "Rows that a sink has written.",
    "pmfid_sink_silent": "1 while there is an alarm that a sink takes nothing, else 0.",
    "pmfid_sink_waiting_rows": "Rows that wait for a sink.",
    "pmfid_sink_working": "1 while the last thing that a sink was given could be written, else 0.",
    "pmfid_source_silent": "1 while there is an alarm that nothing comes from a source, else 0.",
    "pmfid_source_working": "1 while a source that had a problem works again, 0 while it has one.",
    "pmfid_unusable_total": "What came and was no sample, by reason.",
    "process_cpu_seconds_total": "CPU time of the process, in seconds.",
    "process_open_fds": "Open files and connections of the process.",
    "process_max_fds": "Most files and connections that the process may have open.",
    "process_resident_memory_bytes": "Memory of the process that is resident, in bytes.",
    "process_virtual_memory_bytes": "Address space of the process, in bytes.",
    "process_threads": "Threads of the process.",
    "process_start_time_seconds": "When the process started, in seconds since 1970.",
}

#: When this module was first needed: the start of the process where the system does not say.
_LOADED = time.time()


def exposition(counters: Counters) -> str:
    """All that is counted, and the figures of the process: families by name, a HELP and a TYPE line for each; what ends
    in `_total` is a counter, all else a gauge."""
    values = dict(counters.values()) | {(name, ()): value for name, value in process_levels().items()}
    families: dict[str, list[tuple[Labels, float]]] = {}
    for (name, labels), value in values.items():
        families.setdefault(_legal(name, ":"), []).append((labels, value))
    lines = (line for name in sorted(families) for line in _family(name, families[name]))
    return "\n".join(lines) + "\n"


def _family(name: str, samples: list[tuple[Labels, float]]) -> Iterator[str]:
    words = HELP.get(name, f"{name.removeprefix('pmfid_').replace('_', ' ').capitalize()}.")
    yield f"# HELP {name} {words.replace(chr(92), chr(92) * 2).replace(chr(10), chr(92) + 'n')}"
    yield f"# TYPE {name} {'counter' if name.endswith('_total') else 'gauge'}"
    for labels, value in sorted(samples):
        yield f"{name}{_labelled(labels)} {_number(value)}"


def _labelled(labels: Labels) -> str:
    pairs = (f'{_legal(label, "")}="{_escaped(value)}"' for label, value in labels)
    return f"{{{','.join(pairs)}}}" if labels else ""


def _legal(name: str, also: str) -> str:
    """A name with only letters, digits, underscores and those of `also`; the first is no digit."""
    legal = re.sub(rf"[^a-zA-Z0-9_{also}]", "_", name)
    return f"_{legal}" if legal[:1].isdigit() or not legal else legal


def _escaped(value: str) -> str:
    text = value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return text.encode("utf-8", "replace").decode()  # a lone surrogate is no UTF-8


def _number(value: float) -> str:
    if value != value:
        return "NaN"
    if value in (float("inf"), float("-inf")):
        return "+Inf" if value > 0 else "-Inf"
    return repr(int(value)) if value == int(value) and abs(value) < 1e15 else repr(float(value))


def process_levels() -> Mapping[str, float]:
    """What Prometheus's own clients tell of a process, as far as the system has it: CPU time, memory, open files."""
    levels = {"process_cpu_seconds_total": time.process_time(), "process_start_time_seconds": _LOADED}
    try:
        return levels | _of_proc(Path("/proc/self"))
    except (OSError, ValueError, IndexError):  # a system without /proc, or without a descriptor left to read it
        return levels


def _of_proc(own: Path) -> dict[str, float]:
    page, ticks = os.sysconf("SC_PAGE_SIZE"), os.sysconf("SC_CLK_TCK")
    pages = own.joinpath("statm").read_text(encoding="ascii").split()
    # behind the name of the command, which may hold anything
    fields = own.joinpath("stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
    booted = re.search(r"^btime (\d+)$", Path("/proc/stat").read_text(encoding="ascii"), re.MULTILINE)
    found = {
        "process_virtual_memory_bytes": float(int(pages[0]) * page),
        "process_resident_memory_bytes": float(int(pages[1]) * page),
        "process_threads": float(fields[17]),
        "process_open_fds": float(len(os.listdir(own / "fd")) - 1),  # one is that of the listing
        **_most_files(own),
    }
    if booted:
        found["process_start_time_seconds"] = int(booted[1]) + int(fields[19]) / ticks
    return found


def _most_files(own: Path) -> dict[str, float]:
    limit = re.search(r"^Max open files\s+(\d+)", own.joinpath("limits").read_text(encoding="ascii"), re.MULTILINE)
    return {"process_max_fds": float(limit[1])} if limit else {}
