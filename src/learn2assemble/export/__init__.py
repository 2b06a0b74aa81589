"""An assembly as files of other programs, and as paper to build from by hand."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from learn2assemble.registry import Registry

WITH_EVERY_PLAN = ("assembly", "bill", "cards")
"""Formats that are written beside every plan that has its blocks as polyhedra."""


def register_export(exports: Registry[Any]) -> None:
    """Add the files of an assembly to what a plan can be saved as."""
    exports.register("assembly", _assembly)


def _assembly(plan: Any, folder: Path) -> dict[str, Path]:
    from learn2assemble.export.formats import export_assembly

    # Without a proven order there is nothing to build from.
    names = WITH_EVERY_PLAN if plan.assembly.steps else WITH_EVERY_PLAN[:1]
    return {name: export_assembly(plan.assembly, name, folder) for name in names}
