"""Names of the arms. Adding one is a folder with an ``arm.toml`` and a line."""

from __future__ import annotations

from pathlib import Path

ASSETS = Path(__file__).resolve().parents[1] / "assets" / "arms"
ARMS: dict[str, Path] = {name: ASSETS / name / "arm.toml" for name in ("panda", "ur5e")}
"""Every arm by name, and its file."""
