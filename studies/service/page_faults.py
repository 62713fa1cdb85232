"""Faults of browsers and of the process itself: a browser that stops reading, 200 browsers, a stopped process."""

from __future__ import annotations

import json
import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from studies.service.finding import Finding, changes, others_unchanged, sentences, without_alarm
from studies.service.hall import Hall, Metrics, hall, name_of
from studies.service.processes import BROKER, Use, use_of

BROWSERS, LOOKING = 200, 20.0
#: Time for which the process is stopped [s], in real time.
STOPPED = 60.0
#: A broker with little room for an absent service.
SMALL = """\
listener {port} 127.0.0.1
allow_anonymous true
persistence false
max_queued_messages 500
"""


def _as_it_is(place: Path) -> None:
    """Leave the plant unchanged."""


def _slower(metrics: Metrics) -> float:
    """Return the number of deliveries whose estimates took longer than 0.1 s."""
    return metrics.get('pmfid_deliveries_slower_total{than="0.1"}', 0.0)


@dataclass(frozen=True)
class Share:
    """Cores of the service in a stretch of time, and the fraction of deliveries that took longer than 0.1 s."""

    cores: float
    slow: float


@contextmanager
def shared(there: Hall) -> Iterator[Callable[[], Share]]:
    """Yield a function that returns the cost of the time so far."""
    pid, begin, before = there.served.process.pid, time.monotonic(), there.served.metrics()
    use: Use = use_of(pid)

    def share() -> Share:
        now = there.served.metrics()
        taken = max(1.0, there.total("pmfid_deliveries_total", now) - there.total("pmfid_deliveries_total", before))
        return Share((use_of(pid).cpu - use.cpu) / (time.monotonic() - begin), (_slower(now) - _slower(before)) / taken)

    yield share


def _no_later(share: Share, alone: Share) -> tuple[str, bool]:
    text = f"{100 * share.slow:.1f} % of the estimates later than 0.1 s, {100 * alone.slow:.1f} % without"
    return text, share.slow < alone.slow + 0.02


def stuck_browser(there: Hall) -> Finding:
    """Test a browser that requests the rows of an axis, reads nothing, and stays."""
    before, since = there.served.metrics(), there.at
    there.notices()
    with shared(there) as share:
        there.play(50.0)
        alone = share()
    with socket.socket() as line:
        line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        line.connect(("127.0.0.1", there.served.port))
        host = f"127.0.0.1:{there.served.port}"
        request = f"GET /api/news?axis={name_of(0)} HTTP/1.1\r\nHost: {host}\r\n"
        line.sendall(f"{request}Authorization: Bearer {there.served.token}\r\n\r\n".encode())
        with shared(there) as share:
            there.play(150.0)
            during = share()
    after, reported = there.through(), there.notices()
    claims = [
        others_unchanged(there, since),
        without_alarm(reported),
        _no_later(during, alone),
    ]
    return Finding("a browser that stops reading", sentences(reported), changes(before, after), claims)


@dataclass
class Looking:
    """Browsers that ask for news, as the page does; `answers` counts the answers by browser."""

    there: Hall
    answers: list[int] = field(default_factory=list)
    ended: threading.Event = field(default_factory=threading.Event)

    def look(self, k: int) -> None:
        query, pause = (f"axis={name_of(k % self.there.axes)}", 0.25) if k % 2 else ("", 0.5)
        version = 0
        while not self.ended.wait(pause):
            version = json.loads(self.there.served.get(f"/api/news?since={version}&{query}"))["version"]
            self.answers[k] += 1


def many_browsers(there: Hall) -> Finding:
    """Test BROWSERS browsers, half of them at all axes and half at one axis."""
    before, since, looking = there.served.metrics(), there.at, Looking(there)
    there.notices()
    with shared(there) as share:
        there.play(LOOKING, speed=1.0)
        alone = share()
    looking.answers = [0] * BROWSERS
    browsers = [threading.Thread(target=_quietly, args=(looking.look, k), daemon=True) for k in range(BROWSERS)]
    for browser in browsers:
        browser.start()
    with shared(there) as share:
        there.play(LOOKING, speed=1.0)
        with_them = share()
    looking.ended.set()
    answers = list(looking.answers)
    after, reported = there.through(), there.notices()
    refused = there.total("pmfid_page_refused_total", after) - there.total("pmfid_page_refused_total", before)
    claims = [
        others_unchanged(there, since),
        without_alarm(reported),
        (f"each got {min(answers)} to {max(answers)} answers in {LOOKING:g} s", min(answers) > LOOKING),
        (f"{refused:g} were refused", refused == 0),
        (f"the service took {with_them.cores:.2f} cores, {alone.cores:.2f} alone", with_them.cores < 1),
        _no_later(with_them, alone),
    ]
    return Finding(
        f"{BROWSERS} browsers, half of them at one axis", sentences(reported), changes(before, after), claims
    )


def _quietly(action: Callable[..., None], *given: object) -> None:
    """Run an action; an answer that ends during a read is no error here."""
    try:
        action(*given)
    except (OSError, ValueError, AttributeError):
        return


def _few_under_way(place: Path) -> None:
    """Make the service request few messages at once, so that most messages wait at the broker and not on the line."""
    plant = place / "plant.toml"
    plant.write_text(plant.read_text().replace('kind = "mqtt"', 'kind = "mqtt"\nreceive_maximum = 50'))


def stopped(place: Path, fault: str, losing: bool) -> Finding:
    """Stop the process for a minute of samples in real time. With `losing`, the broker has no room for a minute of
    samples.
    """
    limits = SMALL if losing else BROKER
    with hall(place, 6, STOPPED + 40.0, limits=limits, ready=_few_under_way if losing else _as_it_is) as there:
        there.play(5.0)
        there.through()
        there.notices()
        before = there.served.metrics()
        os.kill(there.served.process.pid, signal.SIGSTOP)
        there.play(STOPPED, speed=1.0)
        os.kill(there.served.process.pid, signal.SIGCONT)
        there.play(20.0)
        after, reported = there.through(), there.notices()
        missing = there.total("pmfid_samples_missing_total", after)
        claims = [
            (f"{there.sent} sent, {there.accounted(after):g} accounted for", there.accounted(after) == there.sent),
            (f"{missing:g} are said to be missing", (missing > 0) == losing),
            without_alarm(reported),
        ]
        if not losing:
            claims.append(others_unchanged(there))
        return Finding(fault, sentences(reported), changes(before, after), claims)
