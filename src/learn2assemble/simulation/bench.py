"""An arm in a simulation that does what a plant is asked for: motions, commands, guards."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.kinematics.time_law import PathSamples, load_ruckig
from learn2assemble.motion.program import LOAD_TIME
from learn2assemble.plants.plant import Commands, Guard, Guards, Motion, Report, Stop, ToolReading
from learn2assemble.robot.moves import Failure, Outcome
from learn2assemble.simulation.contacts import BLIND, Rules, Watch
from learn2assemble.simulation.model import TIMESTEP
from learn2assemble.simulation.simulation import BLOCK, HOLDS, Simulation

GRIPPED = 0.8
"""The grasp holds when both fingers press with this share of their force."""
BORNE, BORNE_RATE = 0.9, 0.2
"""Share of a press that the controller bears, and how quickly it follows the sensor, each step."""
EASES, EASED = 12, 0.4
"""After a press: how often the drives are told where they are, and on which share of the way."""
LAST = 20
"""Samples before the end of a motion from which the way is told along which it ends."""
STILL = 1e-9
"""An arm that is told to move slower stands [rad/s]."""
_EVEN = 1e-9
"""Samples at the steps of the simulation are off by less [s]."""


class Bench:
    """Carries motions out in a simulation.

    Args:
        sim: in which the arm stands; whoever owns the bench may exchange it while it does.
        skip_free: let time pass instead of simulating what the empty hand does on its ways.
    """

    sim: Simulation
    skip_free: bool
    hardest: float

    def __init__(self, sim: Simulation, skip_free: bool = False) -> None:
        self.sim, self.skip_free = sim, skip_free
        self._wanted = (sim.width, math.inf)
        """What the tool was told last, and how fast [m/s]."""
        self._load = (sim.drives.payload, 0.0)
        """Mass at the tool that it was told last [kg], and how fast that comes to hold [kg/s]."""
        self._force = self.hardest = 0.0
        self._kept: np.ndarray | None = None
        """float64[3]: where the object was in the hand when it was taken hold of [m]."""

    @property
    def holding(self) -> bool:
        """Whether something is in the hand."""
        sim = self.sim
        if sim.cup is not None:
            return sim.cup.held is not None
        return self._force > 0 and sim.contacts.grip() >= HOLDS

    def feel(self) -> ToolReading:
        """What the tool feels."""
        sim = self.sim
        x, y, z = sim.contacts.pressure(self.holding).tolist()
        push = x, y, z
        if sim.cup is not None:
            return ToolReading(vacuum=sim.cup.held is not None, force=push)
        grip = sim.contacts.grip()
        return ToolReading(width=float(sim.opening), grip=grip, force=push)

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        sim = self.sim
        first, begun, run = sim.samples(), sim.time, sampled(motion)
        count = len(run.position)
        sim.stage = motion.stage
        widths, loads = self._told(count, commands)
        ended, k, stop = None, count - 1, Stop.END
        if self.skip_free and count and not self.holding and motion.stage in ("approach", "home"):
            sim.skip(run)
            guards, count = (), 0
        opens = any(
            command.vacuum is False or (command.width is not None and not command.force)
            for command in commands
        )
        if opens and sim.clutch is not None:
            sim.clutch.take(sim.number)
        guards = guards or (Guard(),)
        begins = [math.ceil(guard.begin / TIMESTEP - 1e-6) for guard in guards]
        begins = [0, *(min(begin, count) for begin in begins[1:]), count]
        for guard, begin, end in zip(guards, begins[:-1], begins[1:], strict=True):
            self._hold(guard)
            if guard.contact is not None:
                sim.contacts.along = self._way(run)
            watch = Watch(Rules(guard.force, guard.taken, guard.held), 0.0, self._until(guard))
            ended, k = sim.play(run, begin, end, watch, widths, loads)
            if ended is not None:
                stop = self._why(ended, guard)
                sim.let_go()
                self.brake(run.acceleration[k])
                if guard.bears:
                    self._ease()
                break
        sim.drives.push = 0.0
        if stop in (Stop.VACUUM, Stop.WIDTH):
            self._kept = None
        if opens and sim.clutch is not None:
            sim.clutch.draw(sim.number)
        return Report(
            stop,
            1.0 if stop == Stop.END else (k + 1) / max(count, 1),
            sim.joints.copy(),
            sim.time - begun,
            ended.detail if isinstance(ended, Failure) else "",
            self.feel(),
            sim.played(first),
        )

    def brake(self, acceleration: np.ndarray | None = None) -> None:
        """Bring the arm to rest from whatever it was told last.

        Args:
            acceleration: float64[n] that it was told then [rad/s^2]; None: none.
        """
        sim = self.sim
        if np.abs(sim.velocity).max() <= STILL:
            return
        a = np.zeros_like(sim.velocity) if acceleration is None else acceleration
        rest = braked(sim.arm.bounds, sim.joints, sim.velocity, a)
        still = np.full(len(rest.position), sim.width)
        sim.play(rest, 0, len(still), BLIND, still)

    def _ease(self) -> None:
        """After a press, stay where the arm is: step by step its drives are told the joints that
        they have, until the hand pushes and turns what it holds no more."""
        sim = self.sim
        for _ in range(EASES):
            there = sim.measured()
            sim.drives.push *= 1 - EASED
            told = np.tile(sim.joints + EASED * (there - sim.joints), (BLOCK, 1))
            still = np.zeros((2, BLOCK, len(there)))
            run = PathSamples(np.zeros((BLOCK, 3)), told, *still)
            sim.play(run, 0, BLOCK, BLIND, np.full(BLOCK, sim.width))

    def _told(self, count: int, commands: Commands) -> tuple[np.ndarray, np.ndarray | None]:
        """Openings float64[count] [m] (or whether the vacuum is on) and loads [kg] of all steps."""
        sim, gripper = self.sim, self.sim.arm.gripper
        widths = np.full(count, sim.width)
        loads = np.full(count, sim.drives.payload)
        told = any(command.load is not None for command in commands)
        told = told or sim.drives.payload != self._load[0]
        load = sim.drives.payload
        marks = [min(count, round(command.at / TIMESTEP)) for command in commands]
        now = sim.width
        for begin, end, command in zip(
            [0, *marks], [*marks, count], [None, *commands], strict=True
        ):
            if command is not None and command.vacuum is not None:
                self._wanted = (float(command.vacuum), math.inf)
                if not command.vacuum:
                    self._kept = None
            if command is not None and command.width is not None:
                pressing = command.force / gripper.stiffness
                self._wanted = command.width - pressing, command.speed or gripper.speed
                self._force = command.force
                if not command.force:
                    self._kept = None
            if command is not None and command.load is not None:
                self._load = command.load, abs(command.load - load) / LOAD_TIME
            wanted, speed = self._wanted
            steps = np.arange(1, end - begin + 1)
            loads[begin:end] = _towards(load, *self._load, steps)
            widths[begin:end] = (
                _towards(now, wanted, speed, steps) if math.isfinite(speed) else wanted
            )
            if end > begin:
                now, load = float(widths[end - 1]), float(loads[end - 1])
        return widths, loads if told else None

    def _hold(self, guard: Guard) -> None:
        """What is held must be kept, or need not."""
        if guard.hold == "kept" and self._kept is not None:
            self.sim.hold(self._kept)
        else:
            self.sim.let_go()

    def _until(self, guard: Guard) -> Callable[[], bool] | None:
        sim = self.sim
        if guard.hold == "made":
            return self._made
        if guard.contact is not None:
            least = guard.contact

            def rests() -> bool:
                force = sim.contacts.support()
                self.hardest = max(self.hardest, force)
                if guard.bears:
                    push = BORNE * max(force, 0.0)
                    sim.drives.push += BORNE_RATE * (push - sim.drives.push)
                if force < least:
                    return False
                if guard.bears and sim.clutch is not None:
                    sim.clutch.join(sim.number)
                return True

            return rests
        if guard.width is not None:
            low, high = guard.width
            return lambda: not low <= sim.opening <= high
        return None

    def _made(self) -> bool:
        """Whether the tool has taken hold."""
        sim = self.sim
        if sim.cup is not None:
            held = sim.cup.held
            if held is None:
                return False
            sim.aim(held)
        elif (
            abs(sim.width - self._wanted[0]) > 1e-9
            or not self._force
            or (sim.contacts.grip() < GRIPPED * self._force)
        ):
            return False
        self._kept = sim.in_hand()
        return True

    def _why(self, ended: Failure | bool, guard: Guard) -> Stop:
        if isinstance(ended, Failure):
            if ended.outcome != Outcome.GRASP_LOST:
                return Stop.FORCE
            return Stop.VACUUM if self.sim.cup is not None else Stop.WIDTH
        if guard.hold == "made":
            return Stop.HELD
        return Stop.CONTACT if guard.contact is not None else Stop.WIDTH

    def _way(self, run: PathSamples) -> np.ndarray | None:
        """float64[3]: unit vector along which the tool comes to the end of a motion; None where it
        stands."""
        if not len(run.position):
            return None
        chain = get_chain(self.sim.arm)
        before = run.position[max(0, len(run.position) - 1 - LAST)]
        way = forward(chain, run.position[-1])[0] - forward(chain, before)[0]
        length = float(np.linalg.norm(way))
        return way / length if length > 1e-6 else None


def _towards(now: float, wanted: float, rate: float, steps: np.ndarray) -> np.ndarray:
    """float64[k]: what changes from ``now`` to ``wanted`` at a rate [1/s], after steps int64[k]."""
    away = wanted - now
    near = rate * TIMESTEP * steps
    return np.where(near < abs(away) - 1e-12, now + np.sign(away) * near, wanted)


def sampled(motion: Motion) -> PathSamples:
    """A motion at the steps of the simulation, the first one a step after its beginning."""
    count = math.ceil(motion.seconds / TIMESTEP - 1e-6)
    n = motion.joints.shape[1] if len(motion.time) else 0
    if not count:
        return PathSamples(np.empty((0, 3)), *np.empty((3, 0, n)))
    even = TIMESTEP * np.arange(count + 1)
    if len(motion.time) == count + 1 and np.abs(motion.time - even).max() < _EVEN:
        q, v = motion.joints, motion.velocity
    else:
        q, v = motion.at(even)
    a = np.empty((count, n))
    a[:-1] = (v[2:] - v[:-2]) / (2 * TIMESTEP)
    a[-1] = (v[-1] - v[-2]) / TIMESTEP
    return PathSamples(np.zeros((count, 3)), q[1:], v[1:], a)


def braked(limits: Any, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> PathSamples:
    """From a state of the joints to rest as soon as the limits allow, all joints together.

    Args:
        limits: of the joints.
        q: float64[n] [rad]; v: [rad/s]; a: [rad/s^2].
    """
    ruckig = load_ruckig()
    n = len(q)
    wanted, found = ruckig.InputParameter(n), ruckig.Trajectory(n)
    wanted.control_interface = ruckig.ControlInterface.Velocity
    wanted.current_position, wanted.current_velocity = q.tolist(), v.tolist()
    most = limits.acceleration
    wanted.current_acceleration = np.clip(a, -most, most).tolist()
    wanted.target_velocity = [0.0] * n
    wanted.max_acceleration, wanted.max_jerk = most.tolist(), limits.jerk.tolist()
    wanted.max_velocity = limits.velocity.tolist()
    ruckig.Ruckig(n).calculate(wanted, found)
    count = max(1, math.ceil(found.duration / TIMESTEP - 1e-9))
    times = np.minimum(TIMESTEP * np.arange(1, count + 1), found.duration)
    rows = [found.at_time(time)[:3] for time in times.tolist()]
    position, velocity, acceleration = (np.array(part) for part in zip(*rows, strict=True))
    velocity[-1] = acceleration[-1] = 0.0
    return PathSamples(np.zeros((count, 3)), position, velocity, acceleration)
