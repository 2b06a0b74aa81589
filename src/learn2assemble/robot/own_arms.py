"""Arms of one's own that every command knows: folders in a folder that the environment names."""

from __future__ import annotations

import os
from pathlib import Path

from learn2assemble.errors import InputError
from learn2assemble.registry import Registry, is_plain_name

PLACE = "LEARN2ASSEMBLE_ARMS"
"""Environment variable: a folder with a folder for each arm, with its ``arm.toml``."""


def register_arm(table: Registry[Path]) -> None:
    """Add the arms there, by the names of their folders.

    Raises:
        InputError: where the variable names no folder, and for an arm whose name is taken.
    """
    told = os.environ.get(PLACE)
    if not told:
        return
    place = Path(told)
    if not place.is_dir():
        raise InputError(PLACE, told, "a folder with a folder for each arm")
    for file in sorted(place.glob("*/arm.toml")):
        name = file.parent.name
        if name in table:
            expected = "a folder whose name no other arm has"
            raise InputError(PLACE, str(file.parent), expected)
        if is_plain_name(name):
            table.register(name, file.resolve())
