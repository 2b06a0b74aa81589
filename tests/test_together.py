"""Two arms that share a site: who may move, and builds of both."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from itertools import pairwise

import mujoco
import numpy as np
import pytest

from l2a_lab.shapes import wall
from learn2assemble.assembly.kit import load_kit
from learn2assemble.cell.site import Site
from learn2assemble.cell.together import Pair, Together, gather, opposite
from learn2assemble.cell.traffic import APART, ArmInTraffic, Leg, Route, Traffic
from learn2assemble.cell.workcell import Workcell
from learn2assemble.design.cells import CellDesign
from learn2assemble.errors import InputError
from learn2assemble.motion.plant import Guard, Motion, PlantError, Report, Stop, standing
from learn2assemble.motion.record import find_fault
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.robot.arm import Arm, get_arm
from learn2assemble.robot.bodies import Part
from learn2assemble.robot.capsules import capsules_of, in_hand, solid_capsules
from learn2assemble.robot.sweeps import clear, still, sweep
from learn2assemble.simulation.model import Failure
from learn2assemble.simulation.plant import DynamicPlant

LEFT = get_arm("ur5e", "suction", (-0.42, 0.0, 0.0, 0.0))
RIGHT = get_arm("panda", "suction", (0.42, 0.0, 0.0, np.pi))
ARMS = LEFT, RIGHT
BRICK = (Part((0.0, 0.0, 0.0), (0.03, 0.02, 0.02)),)
AWAY = still(solid_capsules(BRICK, np.array([0.0, 3.0, 0.0]), np.eye(3)))
KIT = load_kit("bricks")


def motion(stage: str, start: np.ndarray, end: np.ndarray) -> Motion:
    joints = start + np.linspace(0, 1, 9)[:, None] * (end - start)
    return Motion(stage, np.linspace(0, 1, 9), joints, np.zeros_like(joints))


def route(arm: Arm, corners: list[np.ndarray]) -> Route:
    """From home through some corners and back, a leg each."""
    stops = [arm.home, *corners, arm.home]
    legs = tuple(
        Leg(f"leg {k}", sweep(arm, capsules_of(arm), np.array(stops[k : k + 2])))
        for k in range(len(stops) - 1)
    )
    held = in_hand(arm, solid_capsules(BRICK, np.array([0.0, 0.0, 0.02]), np.eye(3)))
    return Route("a", held, legs, AWAY)


@pytest.mark.parametrize("seed", range(6))
def test_whatever_happens_when_both_come_to_their_ends(seed: int) -> None:
    """Random courses that cross each other, legs that take any time: nobody waits for ever, and
    what two arms are on never comes near."""
    rng, traffic = np.random.default_rng(seed), Traffic(ARMS)
    jobs: list[list[list[np.ndarray]]] = []
    for arm in ARMS:
        lower, upper = arm.limits()
        jobs.append(
            [
                [np.clip(arm.home + rng.normal(0, 0.45, len(arm.home)), lower, upper) for _ in "12"]
                for _ in range(3)
            ]
        )
    moving: list[tuple[int, np.ndarray] | None] = [None, None]
    left: list[list[Motion]] = [[], []]
    waited, together, skipped, done = 0, 0, 0, 0
    for _ in range(2000):
        progress = False
        for who in rng.permutation(2).tolist():
            arm = ARMS[who]
            now = moving[who]
            if now is not None:
                if rng.random() < 0.5:
                    traffic.stands(who, now[1], False)
                    moving[who] = None
                    if not left[who]:
                        traffic.over(who)
                        done += 1
                progress = True
            elif left[who]:
                if traffic.enter(who, left[who][0]):
                    one = left[who].pop(0)
                    moving[who], progress = (who, one.joints[-1]), True
                    assert clear(traffic.lanes[0].here, traffic.lanes[1].here, APART)
                    together += moving[1 - who] is not None
                else:
                    waited += 1
                    assert not traffic.stuck(who)
            elif jobs[who]:
                corners = jobs[who][0]
                if traffic.announce(who, route(arm, corners)):
                    stops = [arm.home, *jobs[who].pop(0), arm.home]
                    left[who] = [
                        motion(f"leg {k}", stops[k], stops[k + 1]) for k in range(len(stops) - 1)
                    ]
                    progress = True
                elif traffic.other(who).route is None:
                    # Not even alone: the other arm stands there.
                    jobs[who].pop(0)
                    skipped += 1
                    progress = True
        if not any((*left, *jobs, *[m for m in moving if m])):
            break
        assert progress, "both wait"
    assert not any(left)
    assert done + skipped == 6
    assert done >= 3
    assert together + waited > 0


class Still:
    """A plant that does as it is told."""

    def __init__(self, arm: Arm) -> None:
        self.joints, self.told = arm.home, list[Motion]()

    def execute(self, motion: Motion, commands: object = (), guards: object = ()) -> Report:
        self.told.append(motion)
        self.joints = motion.joints[-1]
        return Report(Stop.END, 1.0, self.joints, motion.seconds)


def test_an_arm_off_its_course_whose_way_is_never_free_says_so() -> None:
    traffic, plant = Traffic(ARMS), Still(LEFT)
    mine = ArmInTraffic(plant, traffic, 0)  # pyright: ignore[reportArgumentType]
    lower, upper = LEFT.limits()
    rng = np.random.default_rng(0)
    while True:
        end = np.clip(LEFT.home + rng.normal(0, 1.0, 6), lower, upper)
        way = motion("cross", LEFT.home, end)
        if not clear(sweep(LEFT, capsules_of(LEFT), way.joints), traffic.lanes[1].here, APART):
            break
    with pytest.raises(Failure, match="other arm is in the way"):
        mine.execute(way, (), (Guard(),))
    assert np.abs(plant.joints - LEFT.home).max() == 0
    # To stand is always possible.
    assert mine.execute(standing("home", LEFT.home, 0.1)).stop == Stop.END


# ---------------------------------------------------------------- builds


class Watched(DynamicPlant):
    """A cell whose arms' distance MuJoCo measures, from one solid to the other."""

    least = np.inf
    looks = 0

    def _advance(self, moving: frozenset[int]) -> None:
        super()._advance(moving)
        state = self.simulated
        if state.steps % 50:
            return
        m, d, world = state.model, mujoco.MjData(state.model), state.world
        d.qpos[:] = state.data.qpos
        mujoco.mj_kinematics(m, d)
        solid = (m.geom_contype | m.geom_conaffinity) > 0
        one, two = (np.flatnonzero(solid & np.isin(world.kind, p.kinds)) for p in world.arms)
        far = (
            np.linalg.norm(d.geom_xpos[one][:, None] - d.geom_xpos[two], axis=2)
            - m.geom_rbound[one][:, None]
            - m.geom_rbound[two]
        )
        for a, b in np.argwhere(far < 0.1).tolist():
            gap = mujoco.mj_geomDistance(m, d, int(one[a]), int(two[b]), 0.1, None)
            self.least = min(self.least, gap)
        self.looks += 1


def design(x: int, y: int, z: int) -> Plan:
    cells = wall(x, y, z)
    plan = plan_cells(CellDesign("wall", cells, KIT.pitch, None, 0.0, None, "", None), KIT)
    assert plan.complete
    return plan


@pytest.fixture(scope="module")
def crew() -> Pair:
    return gather(design(10, 2, 3), (Workcell("ur5e"), Workcell("panda")), KIT.joint_gap)


def test_two_arms_build_together(crew: Pair) -> None:
    both = Together(crew, Watched)
    told: list[str] = []
    assert both.run(told.append) is None
    assert both.complete
    assert {turn.arm for turn in both.turns} == {0, 1}
    first, second = ([t for t in both.turns if t.arm == who] for who in range(2))
    # Both at the same time, and each one thing after the other.
    assert any(a.begin < b.end and b.begin < a.end for a in first for b in second)
    for mine in (first, second):
        assert all(a.end <= b.begin + 1e-9 for a, b in pairwise(mine))
    job = crew.found[0].job
    truth = both.plant.truth()
    for piece in job.pieces:
        assert np.linalg.norm(truth[piece.id][:3] - piece.pose[:3]) < 1e-3
    assert both.plant.looks > 50
    assert both.plant.least >= 0.010
    for record in both.records:
        assert find_fault(record) is None
        assert record.spans()[-1][1] <= both.seconds + 0.1


def test_an_arm_that_is_stopped_leaves_the_other_one_safe(crew: Pair) -> None:
    """The first arm stops on its way across: it stands there, with what it holds, and the other one
    keeps its distance and does not place that block."""
    both = Together(crew, Watched)
    mine, execute = both.plant.plants[0], both.plant.plants[0].execute

    def stopped(motion: Motion, *told: object) -> Report:
        if motion.stage == "cross" and len(both.turns) > 1:
            raise PlantError(Stop.PROTECTIVE, "somebody has pressed the button")
        return execute(motion, *told)  # pyright: ignore[reportArgumentType]

    mine.execute = stopped  # pyright: ignore[reportAttributeAccessIssue]
    why = both.run()
    assert why is not None
    assert "pressed the button" in why
    assert both.reasons[0] == why
    held = mine.held()
    assert held is not None
    assert both.lost == {both.buildings[1].world.names.index(held)}
    # The other one ends with a reason of its own, at rest.
    other = both.plant.plants[1]
    assert both.reasons[1]
    assert np.abs(other.sense().velocity).max() < 1e-2
    assert both.plant.least >= 0.010
    # It hangs in the air: where it waits its middle is half of its height above the table.
    piece = crew.found[0].job.pieces[min(both.lost)]
    assert both.plant.truth()[held][2] > piece.half.min() + 0.02


def test_bases_on_one_spot_are_refused() -> None:
    base = (0.0, -0.5, 0.0, np.pi / 2)
    cells = tuple(Workcell("ur5e", site=Site(base)) for _ in range(2))
    with pytest.raises(InputError, match="bases"):
        gather(design(4, 2, 1), (cells[0], cells[1]), KIT.joint_gap)


def test_the_second_arm_stands_opposite() -> None:
    arm = get_arm("ur5e", "suction")
    x, y, _, facing = opposite(arm)
    assert np.allclose([x, y], -arm.base_position[:2])
    assert abs(abs(facing) - np.pi) < 1e-9
