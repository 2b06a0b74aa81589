"""``l2a view``: open the page of a finished plan."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from learn2assemble.cli.output import Output
from learn2assemble.errors import InputError
from learn2assemble.robot.record_files import read_record
from learn2assemble.viewer import serve, write_page


def run(options: argparse.Namespace) -> int:
    output = Output(options.json)
    plan_file = options.plan / "plan.json" if options.plan.is_dir() else options.plan
    plan = _read(plan_file)
    page = plan_file.with_name("view.html")
    if not page.exists():
        trajectory = plan_file.with_name("trajectory.json")
        write_page(plan, page, read_record(trajectory) if trajectory.exists() else None)

    def tell(url: str) -> None:
        output.say(f"{url} (Ctrl-C ends it)")
        output.finish({"url": url, "page": str(page)})

    serve(page, options.port, not options.no_browser, tell)
    return 0


def _read(file: Path) -> dict[str, Any]:
    try:
        plan = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not JSON"
        raise InputError("PLAN", str(file), f"a plan.json or its folder ({reason})") from None
    if not isinstance(plan, dict) or plan.get("format") != "learn2assemble-plan":
        raise InputError("PLAN", str(file), "a plan written by l2a build")
    return plan
