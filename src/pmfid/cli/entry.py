"""The entry point of the command `pmfid`, where Ctrl-C ends any command at once."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from contextlib import suppress

from pmfid.cli.terminal import CLEAR
from pmfid.errors import INTERRUPTED

#: Time after Ctrl-C in which the command can remove incomplete files [s].
GRACE = 0.3


def main() -> None:
    """Run the command, so that a library call without return cannot delay Ctrl-C."""
    # The threads of BLAS wait actively for each other, which took a quarter of the processor time of a fleet.
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    try:
        _watch()
        from pmfid.cli.main import main as command

        command()
    except KeyboardInterrupt:
        _leave("pmfid: interrupted\n")
    except SystemExit as end:
        if end.code != INTERRUPTED:
            raise
        _leave("")


def _watch() -> None:
    """Start a second thread that receives signals from a socket, because Python's handlers wait for the main thread."""
    hears, speaks = socket.socketpair()
    speaks.setblocking(False)
    signal.set_wakeup_fd(speaks.fileno(), warn_on_full_buffer=False)
    threading.Thread(target=_leave_late, args=(hears, speaks), daemon=True).start()


def _leave_late(hears: socket.socket, speaks: socket.socket) -> None:
    """End the process a short time after Ctrl-C.

    The argument `speaks` only keeps the socket open, because a socket without a reference is closed.
    """
    while number := hears.recv(1):
        # A command with its own handler ends by its own rules.
        if number[0] == signal.SIGINT and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            threading.Event().wait(GRACE)
            _leave("pmfid: interrupted\n")


def _leave(message: str) -> None:
    """End the process without the shutdown of the interpreter, which would wait for threads at work."""
    if "multiprocessing" in sys.modules:
        import multiprocessing

        for child in multiprocessing.active_children():
            child.kill()
    with suppress(OSError):
        os.write(2, (CLEAR + message if os.isatty(2) else message).encode())
    os._exit(INTERRUPTED)
