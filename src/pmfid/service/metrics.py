"""Counters in Prometheus's text format, version 0.0.4, with the system's figures of the process."""

from __future__ import annotations

from collections.abc import Iterable

from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from pmfid.stream.outcome import Counters

#: Meanings of the service's counters. Any other counter is described by the words of its name.
HELP: dict[str, str] = {
    "pmfid_axes": "Axes that use a configuration.",
    "pmfid_axes_calibrating": "Axes that are not watched yet, because their calibration is not finished.",
    "pmfid_axes_silent": "Axes with an open alarm because they send nothing.",
    "pmfid_checkpoint_bytes": "Size of the last checkpoint, in bytes.",
    "pmfid_checkpoint_errors_total": "Checkpoints that could not be written.",
    "pmfid_checkpoint_made_seconds": "Time that the engine took to prepare the last checkpoint, in seconds.",
    "pmfid_checkpoint_seconds": "Time until the last checkpoint was on the disk, in seconds.",
    "pmfid_checkpoint_working": "1 if the last checkpoint was written, otherwise 0.",
    "pmfid_checkpoints_total": "Checkpoints on the disk.",
    "pmfid_deliveries_total": "Deliveries of sources that the engine has processed.",
    "pmfid_dropped_notices_total": "Notices lost because a sink was too slow or not connected.",
    "pmfid_dropped_rows_total": "Rows lost because a sink was too slow or not connected.",
    "pmfid_engine_busy_seconds_total": "Time that the engine spent working, in seconds.",
    "pmfid_events_total": "Events of axes, by kind.",
    "pmfid_inbox_deliveries": "Deliveries that wait for the engine.",
    "pmfid_deliveries_slower_total": "Deliveries whose estimates took longer than the limit in the label, in seconds.",
    "pmfid_latency_seconds": "Age of the oldest delivery in the last step, when its estimates were ready, in seconds.",
    "pmfid_lines_dropped_total": "Lines that are no samples, are repeated, or arrived too late.",
    "pmfid_page_refused_total": "Requests to the page that were refused, by reason.",
    "pmfid_refused_total": "Rows and notices that a sink could not write in any attempt.",
    "pmfid_samples_dropped_total": "Samples of blocks that are repeated or arrived too late.",
    "pmfid_samples_missing_total": "Samples that are missing in gaps.",
    "pmfid_samples_total": "Samples that a monitor processed.",
    "pmfid_samples_without_input_total": "Samples whose input is missing (NaN).",
    "pmfid_sink_errors_total": "Failed attempts of a sink to write; the sink tried the same data again.",
    "pmfid_sink_rows_total": "Rows that a sink has written.",
    "pmfid_sink_silent": "1 while an alarm is open because a sink accepts nothing, otherwise 0.",
    "pmfid_sink_waiting_rows": "Rows that wait for a sink.",
    "pmfid_sink_working": "1 if the sink's last attempt to write succeeded, otherwise 0.",
    "pmfid_source_silent": "1 while an alarm is open because a source delivers nothing, otherwise 0.",
    "pmfid_source_working": "0 while a source has a problem, 1 once it works again.",
    "pmfid_unusable_total": "Data that arrived and are no samples, by reason.",
}


def exposition(counters: Counters) -> str:
    """Return all counters and the figures of the process, with a HELP and a TYPE line for each family.

    A name that ends in `_total` is a counter, any other name a gauge.
    """
    registry = CollectorRegistry()
    registry.register(_Counted(counters))
    ProcessCollector(registry=registry)
    return generate_latest(registry).decode()


class _Counted(Collector):
    def __init__(self, counters: Counters) -> None:
        self._counters = counters

    def collect(self) -> Iterable[Metric]:
        families: dict[str, Metric] = {}
        for (name, labels), value in sorted(self._counters.values().items()):
            if name not in families:
                words = HELP.get(name, f"{name.removeprefix('pmfid_').replace('_', ' ').capitalize()}.")
                kind = CounterMetricFamily if name.endswith("_total") else GaugeMetricFamily
                families[name] = kind(name, words)
            # A lone surrogate, as in the name of a file, is no UTF-8.
            texts = {label: text.encode("utf-8", "replace").decode() for label, text in labels}
            families[name].add_sample(name, texts, value)
        return families.values()
