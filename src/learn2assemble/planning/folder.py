"""The folder that a plan is saved in: names of its files, and whose those are that are there."""

from __future__ import annotations

from pathlib import Path

from learn2assemble.errors import InputError

FORMAT = "learn2assemble-plan"
"""What ``plan.json`` says it is."""
OWN = (
    "plan.json",
    "assembly.json",
    "bill.csv",
    "cards.html",
    "view.html",
    "progress.png",
    "build.mp4",
    "trajectory*.json",
    "trajectory*.csv",
)
"""What the files of a plan are called in its folder."""


def trajectory_names(arms: int) -> list[str]:
    """What the files of the motions of so many arms are called, without their ends."""
    return ["trajectory"] if arms == 1 else [f"trajectory-{n}" for n in range(1, arms + 1)]


def check_own(folder: Path) -> None:
    """Refuse a folder with files that a plan would replace and that are not of a plan.

    Raises:
        InputError: where there is one of them, and no ``plan.json`` of this program beside it.
    """
    found = next((path.name for name in OWN for path in folder.glob(name)), "")
    if found:
        plan, head = folder / "plan.json", ""
        if plan.is_file():
            with plan.open(encoding="utf-8", errors="replace") as file:
                head = file.read(200)
        if f'"{FORMAT}"' not in head:
            expected = "a folder without such files, or one that a plan was saved in"
            raise InputError("folder", f"{folder}, with another {found}", expected)
