"""A source that fails is started again, and notices report both events."""

from __future__ import annotations

import time
from typing import Any

from pmfid.service.context import Take
from pmfid.service.running import Running
from pmfid.stream.delivery import Delivery
from pmfid.stream.engine import Inbox


class Failing:
    """A source that fails at the first call."""

    name = "hall"

    def __init__(self) -> None:
        self.calls = 0

    def run(self, take: Take) -> None:
        self.calls += 1
        if self.calls == 1:
            raise RuntimeError("broken")
        take(Delivery(self.name, ()))

    def stop(self) -> None:
        """Do nothing: the source ends by itself."""


def test_a_source_that_begins_again_is_said_to_work_once_something_comes() -> None:
    reported = list[dict[str, Any]]()
    running = Running(Failing(), Inbox(), reported.append)
    running.start()
    while not running.ended:
        time.sleep(0.01)
    assert [event["problem"].partition(":")[0] for event in reported] == ["RuntimeError", ""]
