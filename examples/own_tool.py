"""A suction tool of one's own: can it hold a brick, and fill a gap with it?"""

import tempfile
from pathlib import Path

import numpy as np

import learn2assemble as l2a
from learn2assemble.kinematics.cell import KinematicCell
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.bodies import Part, Shape
from learn2assemble.robot.holding import attitudes, why_not_held
from learn2assemble.robot.moves import Move, Scene

TOOL = """
kind = "suction"
length = 0.10       # m, from the flange to the lip
mass = 0.25         # kg
payload = 1.0       # kg
speed = [0.1, 0.1]  # s, to hold and to let go

[cup]
diameter = 0.02     # m
stroke = 0.0015     # m
pull_off = 18.8     # N: 60 kPa on the disc
shear = 9.4         # N: friction 0.5
torsion = 0.063     # N m: 2/3 * shear * radius

[[parts]]           # cylinders about the axis [m]
radius = 0.02
from = 0.0
to = 0.06

[[parts]]
radius = 0.01
from = 0.06
to = 0.0985
"""

folder = Path(tempfile.mkdtemp())
(folder / "tool.toml").write_text(TOOL, encoding="utf-8")
l2a.register_tool("small-cup", folder)

arm = get_arm("panda", tool="small-cup")
half = np.array([0.05, 0.025, 0.025])  # of a brick [m]


def box(size: np.ndarray) -> Shape:
    """A box with these half extents as the shape of a block."""
    return (Part((0.0, 0.0, 0.0), tuple(size.tolist())),)


for size, mass in ((half, 0.2), (half, 1.5), (0.3 * half, 0.01)):
    print(2e3 * size, "mm", mass, "kg:", why_not_held(arm, box(size), mass) or "can be held")

# Two bricks that stand, with a gap between them that is 0.2 mm wider than the brick that waits.
position = np.array([[-0.1001, 0, 0.025], [0.1001, 0, 0.025], [0.0, -0.3, 0.025]])
scene = Scene(position, np.zeros(3), np.arange(3), 2, np.tile(half, (3, 1)))
for tool in ("small-cup", "gripper"):
    arm = get_arm("panda", tool=tool)
    cell = KinematicCell(arm)
    for hand in attitudes(arm, box(half))[:1]:
        found = cell.attempt(scene, Move(2, np.array([0.0, 0, 0.025]), hand, hand))
        print(tool, found.outcome.label, found.detail)
