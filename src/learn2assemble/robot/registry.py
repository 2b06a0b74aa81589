"""Names of the arms and of their tools. Adding one is a folder with an ``arm.toml`` or a
``tool.toml``."""

from __future__ import annotations

from pathlib import Path

from learn2assemble.errors import InputError
from learn2assemble.files import as_path
from learn2assemble.registry import Registry, add_plugin

ASSETS = Path(__file__).resolve().parents[1] / "assets"
ARMS: Registry[Path] = Registry(
    "arm", {name: ASSETS / "arms" / name / "arm.toml" for name in ("panda", "ur5e")}
)
"""Every arm by name, and its file."""
add_plugin("learn2assemble.robot.own_arms", "arm")
TOOLS: Registry[Path] = Registry(
    "tool",
    {
        name: ASSETS / "tools" / name / "tool.toml"
        for name in (
            "gripper",
            "suction",
            "suction-side",
            "suction-wide",
            "socket",
            "socket-large",
        )
    },
)
"""Every tool by name, and its file; ``gripper`` are the fingers an arm comes with."""


def register_arm(name: str, folder: str | Path, *, replace: bool = False) -> None:
    """Make an arm known by its name, with its tool.

    Args:
        folder: holds ``arm.toml`` and the MJCF it names, see the arms shipped with the package.
        replace: take the place of an arm of this name.

    Raises:
        InputError: where there is no ``arm.toml``, and for a name that is taken.
    """
    ARMS.register(name, _file_in(folder, "arm"), replace=replace)


def register_tool(name: str, folder: str | Path, *, replace: bool = False) -> None:
    """Make a suction tool known by its name, for every arm.

    Args:
        folder: holds ``tool.toml``, see the tool ``suction`` shipped with the package.
        replace: take the place of a tool of this name.

    Raises:
        InputError: where there is no ``tool.toml``, or its limits are impossible, and for a name
            that is taken.
    """
    from learn2assemble.robot.tool import load_suction

    file = _file_in(folder, "tool")
    load_suction(file)
    TOOLS.register(name, file, replace=replace)


def _file_in(folder: str | Path, kind: str) -> Path:
    file = as_path(folder, f"{kind} folder") / f"{kind}.toml"
    if "\0" in str(file) or not file.is_file():
        raise InputError(f"{kind} folder", str(folder), f"a folder with {kind}.toml")
    file = file.resolve()
    return file
