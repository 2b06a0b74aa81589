"""Reports of a build: pages, pictures, the video, and a small server.

They plug into :meth:`learn2assemble.planning.plan.Plan.save`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from learn2assemble.planning.plan import Exporter, Plan
    from learn2assemble.progress import Progress
    from learn2assemble.registry import Registry

__all__ = ["register_export"]


def register_export(exports: Registry[Exporter]) -> None:
    """Add page and video to what a plan can be saved as."""
    exports.register("page", _page)
    exports.register("video", _video)


def _page(plan: Plan, folder: Path, progress: Progress) -> dict[str, Path]:
    from learn2assemble.viewer.page import write_plan_page
    from learn2assemble.viewer.picture import write_progress

    page, picture = folder / "view.html", folder / "progress.png"
    write_plan_page(plan, page)
    if plan.found_nothing:
        return {"page": page}  # There is nothing to draw.
    write_progress(plan, picture)
    return {"page": page, "picture": picture}


def _video(plan: Plan, folder: Path, progress: Progress) -> dict[str, Path]:
    from learn2assemble.viewer.video import write_video

    write_video(plan, plan.records, folder / "build.mp4", progress)
    return {"video": folder / "build.mp4"}
