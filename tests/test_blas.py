"""Whether matrices of joints and blocks are left to one thread, and no longer than that."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from learn2assemble.blas import by_one_thread


def threads() -> set[int]:
    """Of the libraries of linear algebra that are loaded."""
    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}


def test_linear_algebra_uses_one_thread_within_and_as_many_as_before_afterwards() -> None:
    np.linalg.solve(np.eye(3), np.ones(3))

    @by_one_thread
    def inside(number: int, fail: bool = False) -> tuple[int, set[int]]:
        if fail:
            raise ValueError("meant")
        return number, threads()

    with threadpool_limits(2, user_api="blas"):
        if threads() != {2}:
            pytest.skip("a library that uses one thread whatever it is told")
        assert inside(7) == (7, {1})
        assert threads() == {2}
        with pytest.raises(ValueError, match="meant"):
            inside(7, fail=True)
        assert threads() == {2}
