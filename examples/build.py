"""Plan a design and prove every step: ``python examples/build.py``."""

import sys
from pathlib import Path

import learn2assemble as l2a

EXAMPLES = Path(__file__).parent
design = sys.argv[1] if len(sys.argv) > 1 else EXAMPLES / "designs" / "stepped_tower.json"
plan = l2a.build(design, seed=0, progress=print)
for step in plan.steps:
    print(step.step, step.relation, step.position, f"margin {step.margin_g} g")
print(plan.status, plan.reason or "", f"{plan.coverage:.1%} of the target covered")
print(plan.save("out/build"))
