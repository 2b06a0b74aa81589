"""Read a plan, look into it, and write its page: ``python examples/page.py [PLAN]``."""

import sys
from pathlib import Path

import learn2assemble as l2a

own = Path(__file__).parents[1] / "tests" / "data" / "example_plan"
plan = l2a.load_plan(sys.argv[1] if len(sys.argv) > 1 else own)
print(plan.design.name, plan.status, len(plan.steps), "steps, smallest margin", plan.margin_g)
files = plan.save("out/page")
print("open", files["page"])
