"""Plan a design, prove every step, let a simulated arm build it, and read the plan again.

``python examples/build.py [DESIGN [ARM]]``; without an arm nothing is carried out.
"""

import sys
from pathlib import Path

import learn2assemble as l2a

EXAMPLES = Path(__file__).parent
design = sys.argv[1] if len(sys.argv) > 1 else EXAMPLES / "designs" / "stepped_tower.json"
arm = sys.argv[2] if len(sys.argv) > 2 else None
plan = l2a.build(design, arm=arm, seed=0, progress=print)
for step in plan.steps:
    print(step.step, step.relation, step.position, f"margin {step.margin_g} g")
print(plan.status, plan.reason or "", f"{plan.coverage:.1%} of the target covered")
if plan.arm is not None and plan.record is not None:
    print(f"{plan.arm.attempts} attempts, the arm took {plan.arm.seconds} s")
    print("first attempt, joint positions [rad]:", plan.record.steps[0].samples.joints.shape)
files = plan.save("out/build")
print("open", files["page"])
again = l2a.load_plan("out/build")
print(again.design.name, again.status, len(again.steps), "steps, smallest margin", again.margin_g)
