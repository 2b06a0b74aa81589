"""Let a simulated arm build a design: ``python examples/build_with_arm.py [ARM]``."""

import sys
from pathlib import Path

import learn2assemble as l2a

arm = sys.argv[1] if len(sys.argv) > 1 else "panda"
design = Path(__file__).parent / "designs" / "stepped_tower.json"
plan = l2a.build(design, arm=arm, progress=print)
assert plan.arm is not None
assert plan.record is not None
print(plan.status, f"{plan.arm.attempts} attempts, the arm took {plan.arm.seconds} s")
print("first attempt, joint positions [rad]:", plan.record.steps[0].samples.joints.shape)
plan.save("out/build_with_arm")
