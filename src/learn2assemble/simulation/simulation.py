"""The cell in motion: drives follow joint paths, every contact is watched, and NaN ends it.

:class:`SimulatedState` is what all arms of a cell share, :class:`Simulation` one arm in it.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from learn2assemble.errors import SimulationDivergedError
from learn2assemble.geometry.rotations import rotate_vectors
from learn2assemble.kinematics.time_law import (
    PathSamples,
)
from learn2assemble.plants.plant import Played
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.moves import STAGES, Failure, Outcome, Trajectory
from learn2assemble.simulation.clutch import Clutch
from learn2assemble.simulation.contacts import SimulatedContacts, Watch
from learn2assemble.simulation.cup import Vacuum
from learn2assemble.simulation.disturbances import Straying
from learn2assemble.simulation.drives import Drives
from learn2assemble.simulation.model import TIMESTEP, ArmParts, SimulatedWorld
from learn2assemble.simulation.objects import Objects


def diverged(
    world: SimulatedWorld,
    data: mujoco.MjData,
    time: float,
    folder: Path | None,
    **more: np.ndarray | str,
) -> SimulationDivergedError:
    """Write model and state into a folder, by default a new one, and return the error to raise."""
    folder = folder or Path(tempfile.mkdtemp(prefix="l2a-diverged-"))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.xml").write_text(world.spec.to_xml(), encoding="utf-8")
    state: dict[str, Any] = {
        "qpos": data.qpos,
        "qvel": data.qvel,
        "ctrl": data.ctrl,
        "time": time,
        **more,
    }
    np.savez(folder / "state.npz", **state)
    return SimulationDivergedError(time, folder)


SLIP = 0.01
"""What is held has been lost when it has moved so far in the hand [m]."""
HOLDS = 0.5
"""Both fingers press what is in the hand with this much at least [N]: half a block's weight."""
NOBODY = -9
"""Number of an object that is none."""
LOOSE = 3
"""Looks in a row, 20 ms apart, at which they do not, before what is held counts as lost: between
boxes that are nearly parallel MuJoCo misses the contact for some steps at times."""
BLOCK = 10
"""Steps whose commands are computed at once; also between two looks at what need not be seen
at once."""


class Trace(NamedTuple):
    """What a simulation leaves."""

    sample_steps: int = 10
    """Steps of 2 ms between samples of the trajectory."""
    dump: Path | None = None
    """Folder for model and state should the simulation diverge; a new one by default."""


class SimulatedState:
    """What all arms of a simulation share: where things are, and the time.

    Args:
        world: model of the cell.
        poses: float64[b, 7] of the objects: position [m] and quaternion (w, x, y, z).
        names: what to call them in messages.
        begun: steps that are over already, where another simulation went before.
        dump: see :class:`Trace`.
    """

    world: SimulatedWorld
    names: list[str]
    steps: int
    dump: Path | None
    model: mujoco.MjModel
    data: mujoco.MjData

    def __init__(
        self,
        world: SimulatedWorld,
        poses: np.ndarray,
        names: list[str],
        begun: int = 0,
        dump: Path | None = None,
    ) -> None:
        self.world, self.names, self.steps, self.dump = world, names, begun, dump
        self.model, self.data = world.model, mujoco.MjData(world.model)
        self.poses: np.ndarray = self.data.qpos[world.pose :].reshape(-1, 7)
        """float64[b, 7]: poses of the objects now; a view."""
        self.poses[:] = poses
        self.began: np.ndarray = self.poses.copy()
        self.stage = STAGES[0]
        """What an arm does, for a look into a simulation that diverged."""
        self.clutch: Clutch | None = None
        """The joints of studs, where there are some."""

    @property
    def time(self) -> float:
        """Since the beginning [s]."""
        return self.steps * TIMESTEP

    def step(self) -> None:
        """Everything goes on by one step."""
        mujoco.mj_step(self.model, self.data)
        self.count()
        if self.clutch is not None:
            self.clutch.step()

    def count(self) -> None:
        """A step is done; a simulation that diverged is stopped, with everything needed to look
        into it."""
        self.steps += 1
        d = self.data
        if self.steps % BLOCK == 0 and not (
            np.isfinite(d.qpos).all() and np.isfinite(d.qvel).all()
        ):
            more = {"began": self.began, "stage": self.stage}
            raise diverged(self.world, d, self.time, self.dump, **more)


class Simulation:
    """One arm in a simulation.

    Args:
        state: what it shares with others.
        arm: the robot.
        joints: float64[n] it begins with [rad].
        width: opening the gripper begins with [m]; for a suction tool whether the vacuum is on,
            also wherever openings are told.
        target: number of the object to be moved.
        trace: what it leaves.
        number: of the arm in the model.
    """

    arm: Arm
    number: int
    trace: Trace
    joints: np.ndarray
    velocity: np.ndarray
    width: float
    state: SimulatedState
    target: int
    world: SimulatedWorld
    model: mujoco.MjModel
    data: mujoco.MjData
    parts: ArmParts
    poses: np.ndarray
    drives: Drives
    contacts: SimulatedContacts
    cup: Vacuum | None

    def __init__(
        self,
        state: SimulatedState,
        arm: Arm,
        joints: np.ndarray,
        width: float,
        target: int,
        trace: Trace,
        number: int = 0,
    ) -> None:
        self.arm, self.number, self.trace = arm, number, trace
        self.straying: Straying | None = None
        """How joints are elsewhere than they are told; None: they are not."""
        self.step: Callable[[], None] = lambda: self.state.step()
        """Lets everything go on by one step; afterwards the arm may share another state."""
        self.stage: str = "approach"
        self._samples: list[tuple[Any, ...]] = []
        self.joints, self.velocity, self.width = joints.copy(), np.zeros_like(joints), width
        self.feels_slip = True
        """Whether it is known at once when what is held moves between the pads; else only when
        they press no more."""
        self._grip: np.ndarray | None = None
        self._loose = 0
        """Looks in a row at which the pads did not press."""
        self._stands: np.ndarray | None = None
        """float64[u]: what the drives are told while the arm idles."""
        self.enter(state, target)
        if not state.steps:
            self._record()

    def enter(self, state: SimulatedState, target: int) -> None:
        """From now on the arm is part of this state, at rest where it was told to be, with an empty
        cup.

        Args:
            target: number of the object to be moved.
        """
        self.state, self.target = state, target
        self.world, self.model, self.data = state.world, state.model, state.data
        self.parts, self.poses = state.world.arms[self.number], state.poses
        self._own = self.parts.actuators
        if len(self.parts.finger):
            self.data.qpos[self.parts.finger] = self.width / len(self.parts.finger)
        self.put_arm(self.joints)
        self.drives = Drives(self.arm, self.world, self.data, self.number)
        self.contacts = SimulatedContacts(self.world, self.data, state.names, target, self.number)
        suction = self.arm.suction
        self.cup = None
        if suction is not None:
            self.cup = Vacuum(suction, self.world, self.data, self.number)

    def leave(self, state: SimulatedState) -> tuple[SimulatedContacts, Drives, Vacuum | None]:
        """The arm is part of another state of the same moment now; what it was in the one before,
        for :meth:`go_on`."""
        before = self.contacts, self.drives, self.cup
        self.enter(state, NOBODY)
        return before

    def go_on(
        self, before: tuple[SimulatedContacts, Drives, Vacuum | None], held: int | None
    ) -> None:
        """Go on as before in the other state.

        Args:
            held: number of the object in the hand; None: there is none.
        """
        contacts, drives, cup = before
        self.contacts.along = contacts.along
        self.drives.payload, self.drives.push = drives.payload, drives.push
        if self.cup is not None and cup is not None:
            self.cup.take_over(cup, held)

    @property
    def clutch(self) -> Clutch | None:
        """The joints of studs, where there are some."""
        return self.state.clutch

    @property
    def steps(self) -> int:
        """Since the beginning."""
        return self.state.steps

    @property
    def time(self) -> float:
        """Since the beginning [s]."""
        return self.state.time

    # ------------------------------------------------------------ state

    def put_arm(self, joints: np.ndarray) -> None:
        """The arm is at joints float64[n] [rad], at rest."""
        d, joint = self.data, self.parts.joint
        d.qpos[joint], d.qvel[joint] = joints, 0.0
        if self.straying is not None:
            d.qpos[joint] += self.straying.zero
        mujoco.mj_forward(self.model, d)

    def measured(self) -> np.ndarray:
        """float64[n]: the joints as their encoders have them [rad]."""
        there = self.data.qpos[self.parts.joint].copy()
        return there if self.straying is None else there - self.straying.zero

    @property
    def opening(self) -> float:
        """Between the pads [m]."""
        return float(self.data.qpos[self.parts.finger].sum())

    def tool(self) -> tuple[np.ndarray, np.ndarray]:
        """Pose of the tool float64[3] [m] and float64[3, 3], of the same instant as the objects
        (a step leaves its own one behind)."""
        mujoco.mj_kinematics(self.model, self.data)
        d, tool = self.data, self.parts.tool
        return d.site_xpos[tool].copy(), d.site_xmat[tool].reshape(3, 3).copy()

    def in_hand(self) -> np.ndarray:
        """float64[3]: the target object in the tool frame [m]."""
        position, rotation = self.tool()
        return rotation.T @ (self.poses[self.target, :3] - position)

    def asleep(self, besides: bool = False) -> bool:
        """Whether every object rests, or every one but the target."""
        rest = self.data.tree_asleep[self.world.tree :] >= 0
        return bool(rest.all() or (besides and np.delete(rest, self.target).all()))

    def speed(self, number: int) -> float:
        """Of an object [m/s]."""
        first = self.model.nv - 6 * (len(self.poses) - number)
        return float(np.linalg.norm(self.data.qvel[first : first + 3]))

    def mass(self, number: int) -> float:
        """Of an object [kg]."""
        return float(self.model.body_mass[self.world.first + number])

    # ------------------------------------------------------------ motion

    def run(
        self,
        run: PathSamples,
        widths: np.ndarray,
        stage: str,
        watch: Watch,
        payloads: np.ndarray | None = None,
    ) -> bool:
        """Follow samples one step apart, with openings of the gripper float64[k] [m] and, if
        given, payloads float64[k] [kg]."""
        self.stage = stage
        return self._judge(self.play(run, 0, len(widths), watch, widths, payloads)[0])

    def squeeze(self, widths: np.ndarray, stage: str, watch: Watch) -> bool:
        """Stand still while the tool is told one opening [m] after the other, a step each."""
        still = np.zeros((2, len(widths), len(self.joints)))
        there = np.tile(self.joints, (len(widths), 1))
        run = PathSamples(np.zeros((len(widths), 3)), there, *still)
        return self.run(run, widths, stage, watch)

    def wait(self, steps: int, stage: str, watch: Watch) -> bool:
        """Stand still for a number of steps, or until the watch ends it."""
        return self.squeeze(np.full(steps, self.width), stage, watch)

    def skip(self, run: PathSamples) -> None:
        """Let the time of a motion pass for the arm alone: the objects rest and it meets none."""
        for position, velocity in zip(run.position, run.velocity, strict=True):
            self.state.count()
            self._count(position, velocity)
        self.put_arm(run.position[-1])

    def aim(self, target: int) -> None:
        """From now on it is this object that is moved; -9: none."""
        if target != self.target:
            self.target = target
            self.contacts.aim(target)

    def hold(self, place: np.ndarray | None = None) -> None:
        """From now on the target must stay where it is in the hand, or at a place in it, float64[3]
        in the tool frame [m]."""
        self._grip = self.in_hand() if place is None else place

    def let_go(self) -> None:
        """The target may leave the hand."""
        self._grip = None

    def play(
        self,
        run: PathSamples,
        begin: int,
        end: int,
        watch: Watch,
        widths: np.ndarray | None = None,
        payloads: np.ndarray | None = None,
    ) -> tuple[Failure | bool | None, int]:
        """Samples begin..end of a motion; what broke it off (True: the watch), and at which."""
        thresholds = watch.rules.thresholds()
        self.state.stage, self._stands = self.stage, None
        for first in range(begin, end, BLOCK):
            part = slice(first, min(first + BLOCK, end))
            if payloads is not None:
                self.drives.payload = float(payloads[part][-1])
            rows = self.drives.commands(
                self._followed(run.position[part], run.velocity[part]),
                run.velocity[part],
                run.acceleration[part],
                np.array(self.width) if widths is None else widths[part],
            )
            for k, row in enumerate(rows, first):
                self.data.ctrl[self._own] = row
                self.step()
                if widths is not None:
                    self.width = float(widths[k])
                if self.cup is not None:
                    self.cup.step(self.width)
                self._count(run.position[k], run.velocity[k])
                ended = self._look(thresholds, watch.until)
                if ended is not None:
                    return ended, k
        return None, end

    def _followed(self, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """float64[k, n]: where joints go that are told these positions [rad] and velocities."""
        if self.straying is None:
            return position
        time = self.time + TIMESTEP * np.arange(1, len(position) + 1)
        return position + self.straying.of(time, velocity)

    def stand(self) -> None:
        """Tell the drives to hold, for the next step."""
        if self._stands is None or self.steps % BLOCK == 0:
            still = np.zeros((1, len(self.joints)))
            there = self._followed(self.joints[None], still)
            self._stands = self.drives.commands(there, still, still, np.array(self.width))[0]
        self.data.ctrl[self._own] = self._stands

    def stood(self) -> None:
        """A step is done in which the arm stood."""
        if self.cup is not None:
            self.cup.step(self.width)
        self._count(self.joints, np.zeros_like(self.joints))

    def _look(
        self, thresholds: np.ndarray, until: Callable[[], bool] | None
    ) -> Failure | bool | None:
        if self.data.ncon:
            hit = self.contacts.collision(thresholds)
            if hit is not None:
                grasping = self.stage in ("approach", "pick", "lift")
                touch = Outcome.GRASP_COLLISION if grasping else Outcome.PLACE_COLLISION
                return Failure(touch, self.stage, hit)
        lost = ""
        name = self.contacts.names[self.target] if self._grip is not None else ""
        if self.cup is not None and self._grip is not None and self.cup.held != self.target:
            lost = f"{name} {self.cup.lost}"
        elif self._grip is not None and self.steps % BLOCK == 0:
            if self.feels_slip:
                moved = np.linalg.norm(self.in_hand() - self._grip)
                lost = f"{name} moved by {1e3 * moved:.0f} mm in the hand" if moved > SLIP else ""
            elif self.cup is None:
                pressed = self.contacts.grip() >= HOLDS
                self._loose = 0 if pressed else self._loose + 1
                lost = "the fingers hold nothing any more" if self._loose >= LOOSE else ""
        if lost:
            return Failure(Outcome.GRASP_LOST, self.stage, lost)
        return True if until is not None and until() else None

    @staticmethod
    def _judge(ended: Failure | bool | None) -> bool:
        if isinstance(ended, Failure):
            raise ended
        return ended is not None

    # ------------------------------------------------------------ bookkeeping

    def _count(self, position: np.ndarray, velocity: np.ndarray) -> None:
        """A step is done."""
        self.joints, self.velocity = position, velocity
        if self.steps % self.trace.sample_steps == 0:
            self._record()

    def _record(self) -> None:
        self._samples.append(
            (
                self.time,
                self.joints,
                self.velocity,
                self.opening,
                self.width,
                STAGES.index(self.stage),
                self.poses.copy(),
            )
        )

    def samples(self) -> int:
        """How many there are."""
        return len(self._samples)

    def played(self, first: int) -> Played:
        """Samples from number ``first`` on."""
        n, some = len(self.joints), self._samples[first:]
        if not some:
            none = np.empty((0, n))
            return Played(np.empty(0), none, none, np.empty(0), np.empty(0))
        time, joints, velocity, width, command = map(
            np.array, zip(*(s[:5] for s in some), strict=True)
        )
        return Played(time, joints, velocity, width, command)

    def forget(self) -> None:
        """Drop the samples there are."""
        self._samples.clear()

    def trajectory(self, objects: Objects) -> Trajectory:
        """All samples, with the poses of the cells of ``objects``."""
        *numbers, stage, poses = map(np.array, zip(*self._samples, strict=True))
        always = np.broadcast_to(objects.still, (len(poses), *objects.still.shape))
        pose = np.concatenate([poses, always], 1)[:, objects.owner]
        pose[..., :3] += rotate_vectors(pose[..., 3:], objects.offset)
        return Trajectory._make([*numbers, stage.astype(np.int8), pose])
