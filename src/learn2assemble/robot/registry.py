"""Names of the arms. Adding one is a folder with an ``arm.toml``."""

from __future__ import annotations

from pathlib import Path

from learn2assemble.errors import InputError
from learn2assemble.registry import Registry

ASSETS = Path(__file__).resolve().parents[1] / "assets" / "arms"
ARMS: Registry[Path] = Registry(
    "arm", {name: ASSETS / name / "arm.toml" for name in ("panda", "ur5e")}
)
"""Every arm by name, and its file."""


def register_arm(name: str, folder: str | Path, *, replace: bool = False) -> None:
    """Make an arm known by its name, with its tool.

    Args:
        folder: holds ``arm.toml`` and the MJCF it names, see the arms shipped with the package.
        replace: take the place of an arm of this name.

    Raises:
        InputError: where there is no ``arm.toml``, and for a name that is taken.
    """
    file = Path(folder).resolve() / "arm.toml"
    if not file.is_file():
        raise InputError("arm folder", str(folder), "a folder with an arm.toml")
    ARMS.register(name, file, replace=replace)
