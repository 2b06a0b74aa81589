"""Say what a structure is for, and have it invented: ``python examples/goals.py [GOALS]``."""

import sys
from pathlib import Path

import learn2assemble as l2a
from learn2assemble.design.goals import read_goals

own = Path(__file__).parent / "goals" / "over_the_water.json"
goals = read_goals(sys.argv[1] if len(sys.argv) > 1 else own)
plan = l2a.build(goals, seconds=20, progress=print)
for step in plan.steps:
    print(step.step, step.action, step.kind, step.position, f"margin {step.margin_g} g")
print(plan.status, plan.reason or "", f"{plan.blocks.used} blocks, {plan.verified_by}")
print(plan.save("out/goals"))
