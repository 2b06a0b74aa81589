"""Designs: what a user hands over to be built, as a value and as a JSON file.

The file format is documented in ``docs/designs.md``. This module reads and writes it; the value
itself is in :mod:`~learn2assemble.world.design_model` and what it asks of the blocks in
:mod:`~learn2assemble.world.design_bounds` and
:mod:`~learn2assemble.world.design_towers`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from learn2assemble.errors import InputError
from learn2assemble.world.design_bounds import (
    explain_refusal,
    minimum_blocks,
    required_share,
    unsupported_cells,
)
from learn2assemble.world.design_model import Design, Elevation
from learn2assemble.world.design_pixels import Cell
from learn2assemble.world.design_schema import (
    FORMAT,
    VERSION,
    design_from,
)
from learn2assemble.world.design_towers import inside_cells, needed_cells
from learn2assemble.world.json_input import load_json, printable, read_text

__all__ = [
    "Cell",
    "Design",
    "Elevation",
    "dump_design",
    "explain_refusal",
    "inside_cells",
    "minimum_blocks",
    "needed_cells",
    "parse_design",
    "read_design",
    "required_share",
    "unsupported_cells",
    "write_design",
]


def parse_design(text_or_obj: str | Mapping[str, Any], source: str) -> Design:
    """The design in JSON text, or in an object already parsed from JSON.

    Args:
        text_or_obj: the text of a design file, or its content as a mapping.
        source: what messages call it, for example the file name.

    Raises:
        InputError: one line that names ``source`` and the JSON path of the fault.
    """
    source = printable(source)
    value = load_json(text_or_obj, source, FORMAT) if isinstance(text_or_obj, str) else text_or_obj
    return design_from(value, source)


def read_design(path: Path) -> Design:
    """The design in the file ``path``.

    Raises:
        InputError: for a file that is missing, unreadable, larger than 1 MB or not UTF-8, and
            for everything :func:`parse_design` refuses.
    """
    text, source = read_text(path, "design file")
    return parse_design(text, source)


def dump_design(design: Design) -> str:
    """The design as JSON text; :func:`parse_design` gives back an equal design."""
    head: dict[str, Any] = {"format": FORMAT, "version": VERSION, "name": design.name}
    if design.description:
        head["description"] = design.description
    head["units"] = "m"
    if design.num_blocks is not None:
        head["blocks"] = design.num_blocks
    head["first_block"] = {"elevation": design.first_elevation}
    head["success_threshold"] = design.success_threshold
    head["supports"] = design.supports
    lines = [f"  {_json(key)}: {_json(value)},\n" for key, value in head.items()]
    sides = [
        f'    {{"name": {_json(side.name)}, "outline": {_json(side.outline.tolist())}}}'
        for side in design.elevations
    ]
    return "{\n" + "".join(lines) + '  "elevations": [\n' + ",\n".join(sides) + "\n  ]\n}\n"


def write_design(design: Design, path: Path) -> None:
    """Write the design to a new file ``path``.

    Raises:
        InputError: where something of that name exists already, or the file cannot be written.
    """
    path = Path(path)
    try:
        with path.open("x", encoding="utf-8", newline="\n") as file:
            file.write(dump_design(design))
    except FileExistsError:
        raise InputError(printable(str(path)), "an existing file", "a new file name") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        expected = "a file name that can be written"
        raise InputError(printable(str(path)), reason, expected) from None


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)
