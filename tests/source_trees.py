"""Files of the project as trees of their syntax, each read once for all tests of a process."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path


@cache
def tree_of(path: Path) -> ast.Module:
    """The tree of a file of Python."""
    return ast.parse(path.read_text(encoding="utf-8"))
