"""The figures of results/monitoring.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from studies.monitoring import detection, false_alarms
from studies.monitoring.axis import CUTOFF, FORGETTING, INCREMENTS
from studies.monitoring.pipe import PipeFigures
from studies.paper.truth import table

HEAD = "# A machine that is watched"


def figures(
    results: Mapping[str, list[Any]], tasks: Mapping[str, Sequence[Any]], pipe: PipeFigures | None
) -> list[str]:
    """Return the lines from HEAD on; `results` and `tasks` are by section, in the same order."""
    return [
        HEAD,
        "",
        "Written by",
        "",
        "    python -m studies.monitoring --out results/monitoring.md",
        "",
        f"The simulated cart, {INCREMENTS} increments per turn unless said otherwise, T = 10 ms, cutoff {CUTOFF:g} "
        f"rad/s, `riv` with forgetting {FORGETTING}; moves to and fro of 0.2 m in 0.8 s with dwells of 0.5 s, each "
        "varied by a quarter at random, position control through the encoder. Calibrated from one hour of normal work "
        "of another seed, as `pmfid monitor` does it: the input drives a simulation in open loop.",
        "",
        *_false_alarms(results["false alarms"]),
        *_detection(results["detection"], tasks["detection"]),
        *_recovery(results["recovery"], tasks["recovery"]),
        *_standstill(results["standstill"], tasks["standstill"]),
        *_pipe(pipe),
    ]


def _false_alarms(results: list[dict[str, Any]]) -> list[str]:
    rows, hours = false_alarms.write(results)
    correlation = np.mean([result["correlation"] for result in results], axis=0)
    near, far = (", ".join(f"{value:+.2f}" for value in row) for row in correlation)
    head = ["detector", "asked [h]", "alarms", "found [h]", "95 % interval (Poisson) [h]", "within a factor of 2"]
    return [
        "## False alarms",
        "",
        f"{hours:.0f} simulated hours of normal work under control, tolerance 0, all detectors on the same runs; after "
        f"an alarm a detector restarts after {false_alarms.HOLD:g} s.",
        "",
        *table(head, rows),
        f"Correlation of a block's deviation (mass, viscous, Coulomb) with the next block's: {near}; two apart: {far}.",
        "",
    ]


def _detection(results: list[dict[str, Any]], tasks: Sequence[Any]) -> list[str]:
    rows = []
    groups: dict[tuple[str, str, float], list[dict[str, Any]]] = {}
    for (detector, change, tolerance, _), result in zip(tasks, results, strict=True):
        groups.setdefault((change, detector, tolerance), []).append(result)
    for (change, detector, tolerance), found in groups.items():
        rows.append([change, detector, f"{100 * tolerance:g}", *_detection_cells(change, found)])
    head = ["change", "detector", "tolerance [%]", "runs", "reported within 3 s [%]", "median [s]", "95 % [s]"]
    head += ["right cause [%]", "size, median [%]", "alarms before"]
    return [
        "## Detection",
        "",
        f"A change at any moment of the cycle; mean time between false alarms {detection.MTBF_HOURS:g} h. Time to the "
        "alarm with its cause, dwells included.",
        "",
        *table(head, rows),
    ]


def _detection_cells(change: str, found: list[dict[str, Any]]) -> list[str]:
    delay = np.array([result["delay"] for result in found])
    right = [result["cause"] == detection.CHANGES[change][0] for result in found]
    return [
        str(len(found)),
        f"{100 * np.mean(delay <= 3):.1f}",
        f"{np.median(delay):.2f}",
        f"{np.sort(delay)[int(np.ceil(0.95 * delay.size)) - 1]:.2f}",
        f"{100 * np.mean(right):.0f}",
        f"{100 * np.nanmedian([result['size'] for result in found]):+.1f}",
        str(sum(result["before"] for result in found)),
    ]


def _recovery(results: list[tuple[float, float]], tasks: Sequence[Any]) -> list[str]:
    rows = []
    for increments in detection.RECOVERY_INCREMENTS:
        found = np.array([r for (inc, _), r in zip(tasks, results, strict=True) if inc == increments])
        median, late = np.median(found, axis=0), np.quantile(found, 0.95, axis=0)
        cells = [f"{value:.2f}" for value in (median[0], late[0], median[1], late[1])]
        rows.append([str(increments), str(len(found)), *cells, f"{median[1] / median[0]:.2f}"])
    head = [
        "increments",
        "runs",
        "constant: median [s]",
        "95 % [s]",
        "re-opened: median [s]",
        "95 % [s]",
        "ratio of medians",
    ]
    return [
        "## Recovery",
        "",
        f"Mass step of 1.07 to {detection.LOADED} kg (paper, figure 4): time until the estimate is within 5 % for "
        f"good, with constant forgetting {FORGETTING}, and with the memory opened by the alarm.",
        "",
        *table(head, rows),
    ]


def _standstill(results: list[dict[str, Any]], tasks: Sequence[Any]) -> list[str]:
    rows = []
    for detector in dict.fromkeys(name for name, _ in tasks):
        found = [r for (name, _), r in zip(tasks, results, strict=True) if name == detector]
        drift = np.max([result["drift"] for result in found], axis=0)
        cells = [", ".join(f"{value:.2f}" for value in row) for row in drift]
        rows.append([detector, str(len(found)), str(sum(result["alarms"] for result in found)), *cells])
    head = ["detector", "runs", "alarms", "drift while it stands [%]", "first second after [%]", "later [%]"]
    return [
        "## An hour of standstill",
        "",
        "A minute of motion, an hour at rest, a minute of motion; tolerance 0. Drift: largest difference of mass, "
        "viscous and Coulomb friction from their values at the beginning of the rest.",
        "",
        *table(head, rows),
    ]


def _pipe(pipe: PipeFigures | None) -> list[str]:
    if pipe is None:
        return []
    lost = pipe.sent - pipe.received
    return [
        "## In a pipe",
        "",
        f"`pmfid monitor - --out -`, fed with {pipe.sent} lines at 1 kHz: delay from line in to estimate out "
        f"{1e3 * pipe.median:.2f} ms (median), {1e3 * pipe.worst:.1f} ms (largest); {lost} estimates missing. Fed as "
        f"fast as it takes them, {pipe.long_samples} samples with `--out FILE.parquet`: {pipe.rate:.0f} samples per "
        f"second, {pipe.early_memory:.0f} MiB resident after a tenth of them, {pipe.late_memory:.0f} MiB at the end.",
        "",
        "## The lines of a run",
        "",
        "The load grows by a fifth after 20 s:",
        "",
        *(f"    {line}" for line in pipe.example),
        "",
    ]
