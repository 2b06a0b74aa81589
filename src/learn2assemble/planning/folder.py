"""The folder that a plan is saved in: its files beside ``plan.json``, and whose those there are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from learn2assemble.errors import InputError

if TYPE_CHECKING:
    from learn2assemble.assembly.blocks import Assembly
    from learn2assemble.motion.record import BuildRecord

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


def read_beside(plan: Path, arms: int) -> tuple[tuple[BuildRecord, ...], Assembly | None]:
    """The motions of so many arms, where all of them are there, and the blocks beside a plan."""
    records: tuple[BuildRecord, ...] = ()
    blocks = None
    motions = [plan.with_name(f"{name}.json") for name in trajectory_names(arms)]
    if all(motion.exists() for motion in motions):
        from learn2assemble.motion.files import read_record

        records = tuple(map(read_record, motions))
    if (file := plan.with_name("assembly.json")).exists():
        from learn2assemble.assembly.files import read_assembly

        blocks = read_assembly(file)
    return records, blocks


def write_records(folder: Path, records: Sequence[BuildRecord]) -> dict[str, Path]:
    """The motions of arms, as records and as tables; which file is what."""
    files = dict[str, Path]()
    for name, record in zip(trajectory_names(len(records)), records, strict=True):
        from learn2assemble.motion.files import write_csv, write_record

        what = name.replace("-", " ")
        files[what], files[f"{what} table"] = (folder / f"{name}{x}" for x in (".json", ".csv"))
        write_record(record, files[what])
        write_csv(record, files[f"{what} table"])
    return files
