"""Brick text, as language models write it: a line ``2x4 (x,y,z)`` for each brick.

The first two numbers are the extents along x and y in studs, the others the smallest corner in
studs and bricks from the ground.
"""

from __future__ import annotations

import re

from learn2assemble.assembly.blocks import MAX_BLOCKS
from learn2assemble.assembly.bricks.model import Brick, BrickModel
from learn2assemble.errors import InputError

_LINE = re.compile(
    r"\s*(\d{1,3})\s*x\s*(\d{1,3})\s*\(\s*(-?\d{1,6})\s*,\s*(-?\d{1,6})\s*,\s*(-?\d{1,6})\s*\)\s*"
)
BEGIN = re.compile(rb"\s*\d{1,3}\s*[xX]\s*\d{1,3}\s*\(")
"""How such a file begins."""


def parse_brick_text(text: str, source: str, layers: int, name: str = "") -> BrickModel:
    """The bricks of brick text.

    Args:
        layers: of a brick.

    Raises:
        InputError: for a line that is none, with its number.
    """
    bricks = list[Brick]()
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip():
            continue
        where = f"{source}: line {number}"
        found = _LINE.fullmatch(line)
        if found is None:
            raise InputError(where, line, "a brick such as 2x4 (0,0,0)")
        a, b, x, y, z = map(int, found.groups())
        if z < 0:
            raise InputError(where, line, "a brick at or above the ground, z >= 0")
        bricks.append(Brick((x, y, layers * z), (a, b, layers), where))
        if len(bricks) > MAX_BLOCKS:
            raise InputError(source, "more bricks", f"at most {MAX_BLOCKS}")
    return BrickModel(tuple(bricks), name=name)
