"""The files that ``l2a build`` writes about a build by an arm."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from learn2assemble.robot.record import BuildRecord, require_sound
from learn2assemble.robot.record_files import write_csv, write_record
from learn2assemble.viewer.video import write_video


def write_arm_files(
    plan: dict[str, Any],
    record: BuildRecord,
    folder: Path,
    progress: Callable[[str], None] = lambda text: None,
    video: bool = True,
) -> dict[str, Path]:
    """Write ``trajectory.json``, ``trajectory.csv`` and ``build.mp4``; which file is what.

    Where the arm did nothing there is nothing to film.

    The trajectory is written before it is checked, so that a faulty one can be looked at.

    Raises:
        InputError: where the trajectory breaks a limit of the arm or contradicts itself.
        MissingExtraError: without the extra ``video``.
    """
    files = {
        "trajectory": folder / "trajectory.json",
        "trajectory table": folder / "trajectory.csv",
    }
    write_record(record, files["trajectory"])
    write_csv(record, files["trajectory table"])
    require_sound(record)
    if record.steps and video:
        files["video"] = folder / "build.mp4"
        progress("drawing the video")
        write_video(plan, record, files["video"])
    return files
