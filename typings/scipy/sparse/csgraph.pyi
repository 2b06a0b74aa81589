"""What is used of graphs of SciPy."""

from typing import Any

import numpy as np

def connected_components(
    csgraph: Any, directed: bool = ..., connection: str = ...
) -> tuple[int, np.ndarray]: ...
def __getattr__(name: str) -> Any: ...
