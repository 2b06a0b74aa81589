"""What is used of linear algebra of sparse matrices of SciPy."""

from typing import Any

import numpy as np

class SuperLU:
    perm_c: np.ndarray
    def solve(self, rhs: np.ndarray) -> np.ndarray: ...

def splu(
    A: Any,
    permc_spec: str | None = ...,
    diag_pivot_thresh: float | None = ...,
    *,
    options: dict[str, Any] | None = ...,
) -> SuperLU: ...
def __getattr__(name: str) -> Any: ...
