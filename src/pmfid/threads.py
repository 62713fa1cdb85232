"""The number of threads of linear algebra."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def use_one_thread(call: Callable[P, R]) -> Callable[P, R]:
    """Return a function whose linear algebra has one thread, because threads on small matrices wait for each other.

    A page in a browser has one thread anyway.
    """
    if sys.platform == "emscripten":
        return call

    @wraps(call)
    def call_limited(*args: P.args, **keys: P.kwargs) -> R:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1, "blas"):
            return call(*args, **keys)

    return call_limited
