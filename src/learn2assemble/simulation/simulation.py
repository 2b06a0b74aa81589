"""The cell in motion: drives follow joint paths, every contact is watched, and NaN ends it."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numba import njit

from learn2assemble.errors import Learn2AssembleError
from learn2assemble.geometry.rotations import rotate_vectors
from learn2assemble.motion.plant import Played
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.moves import STAGES, Outcome, Trajectory
from learn2assemble.simulation.clutch import Clutch
from learn2assemble.simulation.cup import Vacuum
from learn2assemble.simulation.model import (
    ARM,
    PAD,
    TABLE,
    TIMESTEP,
    Failure,
    Objects,
    SimulatedWorld,
)
from learn2assemble.simulation.trajectory import (
    PathSamples,
)

TOUCH = 0.5
"""Smallest force between things that must not meet that counts as a collision [N]: half the weight
of a block. A brush without force is none; a block that it moves nevertheless is noticed later."""
PUSH = 5.0
"""The same between the open hand and the block it is about to grasp [N]: a finger that slides a
free block (friction holds it with 1 N) is none, one that lands on it is."""
SLIDES = 0.1
"""What the target moves along rather than against: cosine of the angle between its way and the
normal of a contact."""
_CLASSES = _TABLE, _ARM, _PAD, _TARGET, _OTHER = range(5)
_SUBJECT = (4, 0, 0, 1, 3)
"""Which of two things touches the other, by class."""


class Rules(NamedTuple):
    """Smallest forces [N] that count as a collision; None where contact is allowed."""

    arm: float | None = TOUCH
    """Arm or hand with table, other blocks or itself."""
    target: float | None = None
    """Arm or hand with the object that is to be moved."""
    held: float | None = None
    """That object with table or other blocks."""

    def thresholds(self) -> np.ndarray:
        """float64[5, 5]: the forces [N] by classes of the two geoms."""
        arm, target, held = (np.inf if force is None else force for force in self)
        table = np.full((len(_CLASSES), len(_CLASSES)), np.inf)
        for part in (_ARM, _PAD):
            table[part, [_TABLE, _OTHER, _ARM]] = arm
            table[part, _TARGET] = target
        table[_TARGET, [_TABLE, _OTHER]] = held
        return np.minimum(table, table.T)


class Watch(NamedTuple):
    """What is looked for from some point of a path on."""

    rules: Rules
    start: float = 0.0
    """s from which this holds."""
    until: Callable[[], bool] | None = None
    """Brake as soon as this is so."""


BLIND = Watch(Rules(None, None, None))
"""Nothing is looked for."""


class SimulatedContacts:
    """The contacts of a simulation as they matter when one object is moved.

    Args:
        world: model of the cell.
        data: its state.
        names: what to call the objects.
        target: number of the object that is moved.
    """

    def __init__(
        self, world: SimulatedWorld, data: mujoco.MjData, names: list[str], target: int
    ) -> None:
        self.world, self.data, self.names = world, data, names
        self.along: np.ndarray | None = None
        """float64[3]: unit vector along which the target comes to its place; what it slides along
        does not count as its support. None: everything does."""
        self._wrench = np.empty(6)
        self.aim(target)

    def aim(self, target: int) -> None:
        """From now on it is this object that is moved; -9: none."""
        kind = self.world.kind
        self._class = np.select(
            [kind == TABLE, kind == ARM, kind == PAD, kind == target],
            [_TABLE, _ARM, _PAD, _TARGET],
            _OTHER,
        )

    def collision(self, thresholds: np.ndarray) -> str | None:
        """The first collision in words, by thresholds of :meth:`Rules.thresholds`, or None."""
        begin = 0
        while begin < self.data.ncon:
            pairs = self.data.contact.geom
            begin = _first(pairs, self._class, thresholds, begin)
            if begin < len(pairs):
                first, second = pairs[begin]
                force = self.force(begin)
                if force >= thresholds[self._class[first], self._class[second]]:
                    if _SUBJECT[self._class[second]] < _SUBJECT[self._class[first]]:
                        first, second = second, first
                    names = f"{self.name(first)} touches {self.name(second)}"
                    return f"{names} with {force:.1f} N"
            begin += 1
        return None

    def grip(self, pads: tuple[str, ...]) -> float:
        """What the weaker of these pads presses the target with [N]."""
        force = dict.fromkeys((self.world.model.geom(pad).id for pad in pads), 0.0)
        for k, pair in enumerate(self._pairs()):
            if _TARGET in self._class[pair]:
                for geom in pair.tolist():
                    if geom in force:
                        force[geom] += self.force(k)
        return min(force.values())

    def support(self) -> float:
        """What the target and everything but the hand press on each other [N]."""
        total = 0.0
        for k, (a, b) in enumerate(self._class[self._pairs()].tolist()):
            if _TARGET in (a, b) and {a, b} & {_TABLE, _OTHER}:
                share = 1.0
                if self.along is not None:
                    share = abs(float(self.data.contact.frame[k, :3] @ self.along))
                if share >= SLIDES:
                    total += share * self.force(k)
        return total

    def pressure(self) -> np.ndarray:
        """float64[3]: what the target gets from everything but the hand; without a target what the
        arm gets from everything but itself; world frame [N]."""
        total, frame = np.zeros(3), self.data.contact.frame if self.data.ncon else ()
        mine = (_TARGET,) if (self._class == _TARGET).any() else (_ARM, _PAD)
        for k, (a, b) in enumerate(self._class[self._pairs()].tolist()):
            if (a in mine) == (b in mine) or {a, b} & {_ARM, _PAD} - set(mine):
                continue
            mujoco.mj_contactForce(self.world.model, self.data, k, self._wrench)
            # The frame's normal points from the first geom to the second.
            push = self._wrench[:3] @ frame[k].reshape(3, 3)
            total += push if b in mine else -push
        return total

    def force(self, contact: int) -> float:
        """Normal force of a contact [N]."""
        mujoco.mj_contactForce(self.world.model, self.data, int(contact), self._wrench)
        return float(self._wrench[0])

    def name(self, geom: int) -> str:
        """The block or part of the arm a geom belongs to."""
        kind, m = int(self.world.kind[geom]), self.world.model
        if kind >= 0:
            return self.names[kind]
        return "table" if kind == TABLE else m.body(m.geom_bodyid[geom]).name

    def _pairs(self) -> np.ndarray:
        return self.data.contact.geom if self.data.ncon else np.empty((0, 2), np.int32)


@njit(cache=True)
def _first(pairs, classes, thresholds, begin):
    """Index of the first contact from ``begin`` on that may be a collision, or their number."""
    for k in range(begin, pairs.shape[0]):
        if thresholds[classes[pairs[k, 0]], classes[pairs[k, 1]]] < np.inf:
            return k
    return pairs.shape[0]


class Drives:
    """Commands of the actuators.

    The drives are position servos, torque = k (command - q) - d q'. The command is the wanted
    position plus what it takes for the joint to be there: damping, inertia, Coriolis forces and
    the payload over k, as the controller of any real arm adds. The arm's own weight is
    compensated by the model.

    Args:
        arm: the robot.
        world: model of the cell.
        data: its state.
    """

    payload = 0.0
    """Mass at the tool point the controller was told of [kg]."""
    push = 0.0
    """With which it pushes down there, as its sensor of forces says [N]."""

    def __init__(self, arm: Arm, world: SimulatedWorld, data: mujoco.MjData) -> None:
        self.arm, self.world, self.data = arm, world, data
        m, joint = world.model, world.joint
        self._damping = world.damping + m.dof_damping[joint]
        self._entry = self._inertia_entries(joint)
        self._jacobian = np.empty((3, m.nv))

    def commands(
        self,
        position: np.ndarray,
        velocity: np.ndarray,
        acceleration: np.ndarray,
        width: np.ndarray,
    ) -> np.ndarray:
        """Commands float64[k, u] of the next k steps, the inertia taken as it is now.

        Args:
            position: float64[k, n] wanted after each step [rad]; ``velocity`` [rad/s] and
                ``acceleration`` [rad/s^2] likewise.
            width: float64[k] openings of the gripper [m], or one for all.
        """
        w, d = self.world, self.data
        inertia = d.M[self._entry]
        load = d.qfrc_bias[w.joint] - d.qfrc_gravcomp[w.joint]
        if self.payload or self.push:
            mujoco.mj_jacSite(w.model, d, self._jacobian, None, w.tool)
            jacobian = self._jacobian[:, w.joint]
            inertia = inertia + self.payload * jacobian.T @ jacobian
            load += (self.payload * -w.model.opt.gravity[2] - self.push) * jacobian[2]
        load = load + acceleration @ inertia + velocity * self._damping
        out = np.zeros((len(position), w.model.nu))
        out[:, w.drive] = position + load / w.stiffness
        if w.gripper < 0:
            return out
        gripper = self.arm.gripper
        closed = gripper.command(0.0)
        out[:, w.gripper] = closed + (gripper.command(1.0) - closed) * width
        return out

    def _inertia_entries(self, joint: np.ndarray) -> np.ndarray:
        """int64[n, n]: where the joints' inertia is in the sparse matrix of MuJoCo."""
        m = self.world.model
        entry = np.empty((len(joint), len(joint)), np.int64)
        for a, row in enumerate(joint):
            begin = m.M_rowadr[row]
            columns = m.M_colind[begin : begin + m.M_rownnz[row]].tolist()
            for b in range(a + 1):
                entry[a, b] = entry[b, a] = begin + columns.index(joint[b])
        return entry


class SimulationDivergedError(Learn2AssembleError, ArithmeticError):
    """Some position or velocity is not finite any more.

    Args:
        time: since the attempt began [s].
        folder: has ``scene.xml``, the model, and ``state.npz``: ``qpos``, ``qvel``, ``ctrl``,
            ``time``, ``stage`` and ``began``, the poses of the objects at the beginning.
    """

    def __init__(self, time: float, folder: Path) -> None:
        super().__init__(f"simulation diverged at {time:.3f} s; model and state are in {folder}")
        self.time, self.folder = time, folder


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
    state = {"qpos": data.qpos, "qvel": data.qvel, "ctrl": data.ctrl, "time": time, **more}
    np.savez(folder / "state.npz", **state)
    return SimulationDivergedError(time, folder)


SLIP = 0.01
"""What is held has been lost when it has moved so far in the hand [m]."""
HOLDS = 0.5
"""Both fingers press what is in the hand with this much at least [N]: half a block's weight."""
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
    begun: int = 0
    """Steps that are over already, where another simulation went before, which has taken the sample
    of its end."""


class Simulation:
    """One attempt in the making.

    Args:
        arm: the robot.
        world: model of the cell.
        poses: float64[b, 7] of the objects: position [m] and quaternion (w, x, y, z).
        names: what to call them in messages.
        target: number of the object to be moved.
        joints: float64[n] the arm begins with [rad].
        width: opening the gripper begins with [m]; for a suction tool whether the vacuum is on,
            also wherever openings are told.
        trace: what it leaves.
    """

    def __init__(
        self,
        arm: Arm,
        world: SimulatedWorld,
        poses: np.ndarray,
        names: list[str],
        target: int,
        joints: np.ndarray,
        width: float,
        trace: Trace,
    ) -> None:
        self.arm, self.world, self.target, self.trace = arm, world, target, trace
        self.model, self.data = world.model, mujoco.MjData(world.model)
        self.poses = self.data.qpos[world.pose :].reshape(-1, 7)
        """float64[b, 7]: poses of the objects now; a view."""
        self.poses[:] = poses
        if len(world.finger):
            self.data.qpos[world.finger] = width / len(world.finger)
        self.put_arm(joints)
        self.drives = Drives(arm, world, self.data)
        self.contacts = SimulatedContacts(world, self.data, names, target)
        self.stage, self.steps = "approach", trace.begun
        self._samples: list[tuple[Any, ...]] = []
        self.joints, self.velocity, self.width = joints.copy(), np.zeros_like(joints), width
        self.cup = None if arm.suction is None else Vacuum(arm.suction, world, self.data)
        self.clutch: Clutch | None = None
        """The joints of studs, where there are some."""
        self.feels_slip = True
        """Whether it is known at once when what is held moves between the pads; else only when
        they press no more."""
        self._grip: np.ndarray | None = None
        self._loose = 0
        """Looks in a row at which the pads did not press."""
        if not trace.begun:
            self._record()

    @property
    def time(self) -> float:
        """Since the beginning [s]."""
        return self.steps * TIMESTEP

    # ------------------------------------------------------------ state

    def put_arm(self, joints: np.ndarray) -> None:
        """The arm is at joints float64[n] [rad], at rest."""
        d, joint = self.data, self.world.joint
        d.qpos[joint], d.qvel[joint] = joints, 0.0
        mujoco.mj_forward(self.model, d)

    @property
    def opening(self) -> float:
        """Between the pads [m]."""
        return float(self.data.qpos[self.world.finger].sum())

    def tool(self) -> tuple[np.ndarray, np.ndarray]:
        """Pose of the tool float64[3] [m] and float64[3, 3], of the same instant as the objects
        (a step leaves its own one behind)."""
        mujoco.mj_kinematics(self.model, self.data)
        d, tool = self.data, self.world.tool
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
        for first in range(begin, end, BLOCK):
            part = slice(first, min(first + BLOCK, end))
            if payloads is not None:
                self.drives.payload = float(payloads[part][-1])
            rows = self.drives.commands(
                run.position[part],
                run.velocity[part],
                run.acceleration[part],
                np.array(self.width) if widths is None else widths[part],
            )
            for k, row in enumerate(rows, first):
                self.data.ctrl[:] = row
                mujoco.mj_step(self.model, self.data)
                if widths is not None:
                    self.width = float(widths[k])
                if self.cup is not None:
                    self.cup.step(self.width)
                if self.clutch is not None:
                    self.clutch.step()
                self._count(run.position[k], run.velocity[k])
                ended = self._look(thresholds, watch.until)
                if ended is not None:
                    return ended, k
        return None, end

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
                pressed = self.contacts.grip(self.arm.gripper.pads) >= HOLDS
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
        self.steps += 1
        if self.steps % BLOCK == 0:
            self._guard()
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

    def _guard(self) -> None:
        """Stops a simulation that diverged, with everything needed to look into it."""
        d = self.data
        if not (np.isfinite(d.qpos).all() and np.isfinite(d.qvel).all()):
            began = self._samples[0][-1] if self._samples else self.poses
            raise diverged(self.world, d, self.time, self.trace.dump, began=began, stage=self.stage)
