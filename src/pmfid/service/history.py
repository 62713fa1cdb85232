"""What configurations the axes had, since when: part of a checkpoint, and told to the sinks."""

from __future__ import annotations

import time

from pmfid.service.engine import Engine

__all__ = ["remember", "tell_configurations"]

#: Of the last so many it is known whether they are there already, and so many are kept.
RECENT, MOST = 100, 1000


def remember(engine: Engine) -> None:
    """What configurations there are since when."""
    known = {entry["digest"] for entry in engine.history[-RECENT:]}
    for group in engine.groups:
        if group.prepared.digest not in known:
            entry = {"wall": time.time(), "config": group.kindred.config, "digest": group.prepared.digest}
            nominal = dict(zip(group.kindred.names, group.kindred.nominal.tolist(), strict=True))
            engine.history.append({**entry, "nominal": nominal})
    del engine.history[:-MOST]


def tell_configurations(engine: Engine) -> None:
    """To the sinks: they keep what differs from the time before."""
    present = {group.prepared.digest for group in engine.groups}
    for entry in engine.history:
        if entry["digest"] in present:
            told = {key: entry[key] for key in ("config", "digest", "nominal")}
            engine.notices.own("", {"event": "configuration", **told})
