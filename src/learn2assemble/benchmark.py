"""How fast this machine runs the pieces; each measurement is one function.

Timings are seconds of the processor on one core: PyTorch is held to one thread. Ratios within one
run are more trustworthy than the numbers themselves. What needs an extra that is not installed
raises :class:`~learn2assemble.errors.MissingExtraError`.
"""

from __future__ import annotations

import importlib.metadata
import platform
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import Assembly, Block
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.bricks.model import Brick, BrickModel, assembly_of
from learn2assemble.assembly.kit import load_kit
from learn2assemble.constants import EDGE, HALF
from learn2assemble.errors import extra
from learn2assemble.handling.dynamic_cell import DynamicCell
from learn2assemble.planning.tiling.exact import plan_exact
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.grasps import get_grasps
from learn2assemble.robot.moves import GAP, Attempt, Move, Scene
from learn2assemble.statics.rigid_blocks import check
from learn2assemble.tasks.learning.config import CONFIGS
from learn2assemble.tasks.physics.rigid import RigidPhysics
from learn2assemble.tasks.search.config import SearchConfig
from learn2assemble.tasks.search.mcts import search
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import get_task
from learn2assemble.tasks.world.layouts import waiting_places

PITCH = EDGE + GAP


class WallReport(NamedTuple):
    """One wall."""

    attempts: list[Attempt]
    """One per cube, in order; the last one is the first that failed, if any."""
    seconds: list[float]
    """Processor time of each [s]."""
    target: np.ndarray
    """float64[k, 3]: where the cubes should be [m]."""

    @property
    def errors(self) -> np.ndarray:
        """float64[k]: distance of each cube from its target once everything stands [m]."""
        last = self.attempts[-1].after
        assert last is not None
        return np.linalg.norm(last.position[: len(self.target)] - self.target, axis=1)


def build_wall(cell: DynamicCell, columns: int = 5, rows: int = 4) -> WallReport:
    """Build a wall along x from cubes that wait in the paper's rows, the farthest
    first; every attempt begins with what the one before left behind."""
    count = columns * rows
    waiting = waiting_places("slanted-rows", count).position[::-1]
    scene = Scene(waiting.copy(), np.zeros(count), np.arange(count), 0)
    x, z = np.arange(count) % columns - columns // 2, np.arange(count) // columns
    target = np.stack([x * PITCH, np.zeros(count), HALF + EDGE * z], -1)
    attempts: list[Attempt] = []
    seconds: list[float] = []
    joints = quaternion = None
    for k in range(count):
        move, begun = Move(k, target[k], *get_grasps("along-y")[0]), time.process_time()
        done = cell.attempt(scene, move, joints=joints, quaternion=quaternion)
        attempts.append(done)
        seconds.append(time.process_time() - begun)
        if not done.reached:
            break
        assert done.after is not None
        scene, quaternion, joints = done.after, done.quaternion, done.joints
    return WallReport(attempts, seconds, target[: len(attempts)])


TASK = "two-sided-3x3-20-24"
OBJECTS = "objects-two-sided-5x5-20-24"
ARM_TASK = "robot-two-sided-3x3-10-14"
BATCH = 256


def static_batch_actions_per_s(seconds: float) -> float:
    """Step, coverage, reward, auto-reset and graph features; random legal actions."""
    return _random_play(Simulator(get_task(TASK)), BATCH, seconds)


def objects_batch_actions_per_s(seconds: float) -> float:
    """The same with objects of several cells and 20 actions."""
    return _random_play(Simulator(get_task(OBJECTS)), BATCH, seconds)


def static_single_steps_per_s(seconds: float) -> float:
    """Single environment through Gymnasium, random legal actions, resets included."""
    return _steps(TASK, seconds, actions="flat")


def placements_single_steps_per_s(seconds: float) -> float:
    """The same with one action for every distinct placement."""
    return _steps(TASK, seconds, actions="placements")


def designs_single_steps_per_s(seconds: float) -> float:
    """The environment of random designs of cubes, episodes drawn from 5 problems."""
    return _steps("designs-cubes-60", seconds, pool=5)


def designs_fresh_steps_per_s(seconds: float) -> float:
    """The same, each episode a design that was not met before."""
    return _steps("designs-cubes-60", seconds)


def goals_single_steps_per_s(seconds: float) -> float:
    """The environment in which a bridge is invented."""
    return _steps("goals-bridge", seconds)


def _steps(task: str, seconds: float, **options: Any) -> float:
    with extra("gymnasium", "learn"):
        import gymnasium

    from learn2assemble.envs import env_id

    env = gymnasium.make(env_id(task), **options)
    rng = np.random.default_rng(0)
    _, info = env.reset(seed=0)

    def step() -> int:
        nonlocal info
        action = int(rng.choice(np.flatnonzero(info["action_masks"])))
        _, _, terminated, _, info = env.step(action)
        if terminated:
            _, info = env.reset()
        return 1

    return rate(step, seconds)


def rigid_actions_per_s(seconds: float) -> float:
    """Random stable placements, each settled in MuJoCo, until the blocks are used up."""
    return _placements(Simulator(get_task(TASK), RigidPhysics()), seconds)


def kinematic_actions_per_s(seconds: float) -> float:
    """Attempts of the Panda without dynamics: random legal placements that would stand, in two
    walls on the way up; those that fail are tried again with another."""
    return _placements(Simulator(get_task(ARM_TASK)), seconds)


def _placements(simulator: Simulator, seconds: float) -> float:
    rng = np.random.default_rng(0)
    state = simulator.new(1, rng)

    def step() -> int:
        good = np.argwhere(simulator.physics_mask(state)[0])
        if len(good):
            reference, action = good[rng.integers(len(good))]
            unplaced = int(rng.integers(int(state.num_unplaced[0])))
            trial = state.copy()
            done = simulator.step(trial, np.array([[unplaced, reference, action]]))
            if done.verdict[0] == 0:
                state.put(np.array([0]), trial)
        if not len(good) or state.terminated[0]:
            simulator.reset(state, np.array([0]), rng)
        return min(len(good), 1)

    return rate(step, seconds)


def dynamic_move_s(seconds: float) -> float:
    """Processor time of one pick and place of the Panda, simulated whole: a wall of cubes."""
    cell, spent = DynamicCell(get_arm("panda")), list[float]()
    build_wall(cell, 1, 1)  # compiles
    while sum(spent) < seconds:
        spent += build_wall(cell, 3, 2).seconds
    return float(np.mean(spent))


def exact_plan_s(seconds: float) -> float:
    """Blocks, order and proof of a wall of 30 x 2 x 20 cells with a door and a window."""
    wanted, kit = np.ones((30, 2, 20), bool), load_kit("bricks-lintels")
    wanted[5:9, :, :12], wanted[17:23, :, 7:13] = False, False
    return 1 / rate(lambda: int(plan_exact(wanted, kit)[0].status == "complete"), seconds)


def check_s(seconds: float) -> float:
    """Whether a wall of 200 bricks stands, with its margin."""
    bricks: list[Block] = []
    for course, column in np.ndindex(20, 10):
        x, z = 0.2 * column + 0.05 * (course % 2), 0.1 * course
        bricks.append(box_block(f"{course}-{column}", (x, 0, z), (x + 0.2, 0.2, z + 0.1)))
    return 1 / rate(lambda: int(check(Assembly(tuple(bricks))).margin_g > 0), seconds)


def brick_check_s(seconds: float) -> float:
    """Whether a wall of 258 bricks that clutch stands, the making of it included."""
    kit = load_kit("lego")
    rows = [
        Brick((4 * column + 2 * (course % 2), 0, 3 * course), (4, 2, 3), "a brick")
        for course, column in np.ndindex(22, 12)
    ]

    def stands() -> int:
        made = assembly_of(BrickModel(tuple(rows[:258])), kit, "wall")
        return int(check(made).verdict == "stands")

    return 1 / rate(stands, seconds)


def decision_ms(seconds: float) -> float:
    """One decision of our own network with budget 10 on N = 30 nodes, a single world."""
    return 1000 / _decisions("relational", 1, seconds)


def _decisions(config: str, worlds: int, seconds: float) -> float:
    """Decisions a second with budget 10 on N = 30 nodes, of so many worlds at once, one thread."""
    with extra("torch", "learn"):
        import torch

    from learn2assemble.tasks.networks.agent import make_network
    from learn2assemble.tasks.world_model import WorldModel, lookahead_actions

    torch.set_num_threads(1)
    simulator = Simulator(get_task(TASK))
    rng = np.random.default_rng(0)
    model = WorldModel(simulator, make_network(CONFIGS[config].network).eval())
    states = simulator.new(64, rng)
    for _ in range(3):
        # Worlds a few blocks on are like those that searches meet.
        simulator.step(states, lookahead_actions(simulator, states))
    states = states.take(np.flatnonzero(~states.terminated))

    def step() -> int:
        search(
            model,
            states.take(rng.integers(0, len(states.num_placed), worlds)),
            SearchConfig(budget=10),
            rng,
        )
        return worlds

    return rate(step, seconds)


def _gradient_samples(config: str, seconds: float) -> float:
    """Transitions a second in gradient steps of a configuration with its own network and batch
    size; the memory is filled by its first steps."""
    with extra("torch", "learn"):
        import torch

    from learn2assemble.tasks.learning.trainer import Trainer

    torch.set_num_threads(1)
    trainer = Trainer(get_task(TASK), CONFIGS[config], seed=0)
    while trainer.replay.length < 1024:
        trainer.collect()

    def step() -> int:
        trainer.update()
        return trainer.config.batch_size

    return rate(step, seconds)


MEASUREMENTS: dict[str, Callable[[float], float]] = {
    "static_batch_actions_per_s": static_batch_actions_per_s,
    "static_single_steps_per_s": static_single_steps_per_s,
    "placements_single_steps_per_s": placements_single_steps_per_s,
    "designs_single_steps_per_s": designs_single_steps_per_s,
    "designs_fresh_steps_per_s": designs_fresh_steps_per_s,
    "goals_single_steps_per_s": goals_single_steps_per_s,
    "rigid_actions_per_s": rigid_actions_per_s,
    "kinematic_actions_per_s": kinematic_actions_per_s,
    "dynamic_move_s": dynamic_move_s,
    "objects_batch_actions_per_s": objects_batch_actions_per_s,
    "exact_plan_s": exact_plan_s,
    "check_s": check_s,
    "brick_check_s": brick_check_s,
    "decision_ms": decision_ms,
    "decisions_per_s": partial(_decisions, "relational", 64),
    "decisions_per_s_published": partial(_decisions, "published", 64),
    "gradient_samples_per_s": partial(_gradient_samples, "relational"),
    "gradient_samples_per_s_published": partial(_gradient_samples, "published"),
    "gradient_samples_per_s_paper": partial(_gradient_samples, "paper"),
}


def machine() -> dict[str, Any]:
    """What was measured on; no ``torch`` where it is not installed."""
    found: dict[str, Any] = {"python": platform.python_version()}
    with suppress(importlib.metadata.PackageNotFoundError):
        found["torch"] = importlib.metadata.version("torch")
    return {**found, "machine": platform.machine(), "batch": BATCH}


def _random_play(simulator: Simulator, batch: int, seconds: float) -> float:
    rng = np.random.default_rng(0)
    state = simulator.new(batch, rng)

    def step() -> int:
        ended = np.flatnonzero(
            simulator.step(state, simulator.random_actions(state, rng)).terminated
        )
        simulator.reset(state, ended, rng)
        simulator.observe(state)
        return batch

    return rate(step, seconds)


def rate(step: Callable[[], int], seconds: float) -> float:
    """Units of work that ``step`` counts in a second of the processor, after a warm-up; so what
    else runs on the machine counts little."""
    for _ in range(3):
        step()
    done, started = 0, time.process_time()
    while (used := time.process_time() - started) < seconds:
        done += step()
    return done / used
