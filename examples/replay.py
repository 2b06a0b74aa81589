"""Repeat recorded transitions in this project's world and compare."""

import sys
from pathlib import Path

from l2a_lab.replay import replay_file
from learn2assemble.tasks.physics.rigid import RigidPhysics

own = Path(__file__).parents[1] / "tests" / "data" / "transitions_sample.jsonl"
file = sys.argv[1] if len(sys.argv) > 1 else own
report = replay_file(Path(file), RigidPhysics).to_dict()
for name in ("lines", "mask_exact", "complete_exact", "valid_static", "valid_rigid"):
    print(name, report[name])
