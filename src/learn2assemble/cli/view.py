"""``l2a view``: open the page of a finished plan."""

from __future__ import annotations

import argparse

from learn2assemble.cli.output import Output
from learn2assemble.planning.plan import Plan
from learn2assemble.viewer.page import write_page
from learn2assemble.viewer.server import serve


def run(options: argparse.Namespace) -> int:
    output = Output(options.json)
    plan_file = options.plan / "plan.json" if options.plan.is_dir() else options.plan
    plan = Plan.load(plan_file)
    page = plan_file.with_name("view.html")
    if not page.exists():
        write_page(plan, page)

    def tell(url: str) -> None:
        output.say(f"{url} (Ctrl-C ends it)")
        output.finish({"url": url, "page": str(page)})

    serve(page, options.port, not options.no_browser, tell)
    return 0
