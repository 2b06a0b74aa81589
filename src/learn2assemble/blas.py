"""Matrices of some hundred rows, as those of joints and blocks, are solved by one thread.

A linear algebra library gives such a matrix to all cores, and its threads then wait for one another
in a loop: alone on a machine that gains nothing, beside other work a system of 160 unknowns takes
23 ms instead of 0.3.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, wraps
from typing import Any, ParamSpec, TypeVar

# Its library has to be there before it is told.
import scipy.linalg  # noqa: F401  # pyright: ignore[reportMissingTypeStubs, reportUnusedImport]
from threadpoolctl import ThreadpoolController  # pyright: ignore[reportMissingTypeStubs]

P = ParamSpec("P")
R = TypeVar("R")


@lru_cache(maxsize=1)
def _libraries() -> Any:
    return ThreadpoolController()


def by_one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """A function in which linear algebra uses one thread; afterwards it uses as many as before."""

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with _libraries().limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
