"""Read a plan, look into it, and write its page: ``python examples/page.py [PLAN]``."""

import sys

import learn2assemble as l2a

plan = l2a.load_plan(sys.argv[1] if len(sys.argv) > 1 else "tests/data/example_plan")
print(plan.design.name, plan.status, len(plan.steps), "steps, smallest margin", plan.margin_g)
files = plan.save("out/page")
print("open", files["page"])
