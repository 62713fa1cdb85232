"""A brake on guesses: wrong tokens are counted by the address that they come from, in bounded memory."""

from __future__ import annotations

import ipaddress
import time
from collections.abc import Callable
from dataclasses import dataclass, field

__all__ = ["Brake"]

#: Wrong tokens that an address may send within so much time [s], and addresses that are remembered.
FREE, WINDOW, ADDRESSES = 10, 60.0, 4096


@dataclass
class Brake:
    """clock: monotonic [s]. It is asked about wrong tokens alone, so a good one always opens, whoever else guesses from
    the same address."""

    clock: Callable[[], float] = time.monotonic
    _wrong: dict[str, tuple[int, float]] = field(default_factory=dict, init=False)  # number, since when; oldest first

    def wrong(self, address: str) -> float:
        """Counts a wrong token. Time until the address is answered as before [s]; 0 while it is."""
        now, key = self.clock(), _network(address)
        number, since = self._wrong.pop(key, (0, now))
        if now - since >= WINDOW:
            number, since = 0, now
        self._wrong[key] = number + 1, since
        if len(self._wrong) > ADDRESSES:
            del self._wrong[next(iter(self._wrong))]
        return since + WINDOW - now if number >= FREE else 0.0


def _network(address: str) -> str:
    """Of IPv6 the first 64 bits: whoever has one address there has them all."""
    try:
        parsed = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    return str(parsed) if parsed.version == 4 else str(ipaddress.ip_network((parsed, 64), strict=False))
