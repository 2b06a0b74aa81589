"""Builds as files: assemblies for other programs and on paper, motions for robots."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from learn2assemble.progress import Progress
    from learn2assemble.registry import Registry

WITH_EVERY_PLAN = ("assembly", "bill", "cards")
"""Formats that are written beside every plan that has its blocks as polyhedra."""
PROGRAM_FORMATS = ("csv", "franka", "ros2", "urscript")
"""Formats of programs of robots (:mod:`.robot_programs`); the others are of assemblies."""


def asset(name: str) -> str:
    """The text of a file that comes with the formats."""
    return (resources.files(__name__) / "assets" / name).read_text(encoding="utf-8")


def register_export(exports: Registry[Any]) -> None:
    """Add the files of an assembly to what a plan can be saved as."""
    exports.register("assembly", _assembly)


def _assembly(plan: Any, folder: Path, progress: Progress) -> dict[str, Path]:
    from learn2assemble.export.formats import export_assembly

    # Without a proven order there is nothing to build from.
    names = WITH_EVERY_PLAN if plan.assembly.steps else WITH_EVERY_PLAN[:1]
    # Plan.save has looked whose files are there.
    return {name: export_assembly(plan.assembly, name, folder, overwrite=True) for name in names}
