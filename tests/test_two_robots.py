"""A plan carried out by two robots, each with a clock and a speed of its own, on threads that run
as the machine lets them."""

from __future__ import annotations

import contextlib
import json
import os
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import learn2assemble as l2a
from learn2assemble.acting.carry_out import setup_of
from learn2assemble.cell.pieces import pieces_of
from learn2assemble.cell.site import Site
from learn2assemble.cell.site_arms import SiteArm
from learn2assemble.cell.workcell import Workcell
from learn2assemble.cli import main
from learn2assemble.errors import InputError, Learn2AssembleError
from learn2assemble.jobs.run import Ran, run
from learn2assemble.kinematics.capsules import apart, capsules_of
from learn2assemble.kinematics.capsules import placed as lines_at
from learn2assemble.kinematics.chain import get_chain
from learn2assemble.planning.plan import Plan
from learn2assemble.plants.plant import (
    BlockReading,
    Commands,
    Guards,
    Motion,
    Plant,
    PlantError,
    Readings,
    Report,
    Request,
    Stop,
    WrappedPlant,
    standing,
)
from learn2assemble.plants.remote import in_process
from learn2assemble.plants.robots import Robots
from learn2assemble.plants.setup import PlantClock, Setup, Surroundings, open_plant
from learn2assemble.simulation.kinematic_plant import KinematicPlant
from learn2assemble.team.members import set_up_team
from learn2assemble.team.pair import gather
from learn2assemble.team.traffic import Traffic
from test_controllers import PATIENT, begin

FAST = 60.0
"""Seconds of a robot in one of this machine."""
KEPT = 0.010
"""The arms keep so far from each other [m]; as they are told to move, 15 mm."""
ARMS = ("ur5e", "panda")


@lru_cache(maxsize=4)
def pair_plan(wide: int = 12, high: int = 4) -> Plan:
    """A wall for two arms: its plan, which nobody has carried out."""
    cells = np.ones((wide, 2, high), bool)
    plan = l2a.build(cells, kit="bricks-lintels", arm=ARMS, physics="kinematic", cell=0.032)
    assert plan.complete, plan.reason
    return plan


def setups_of(plan: Plan) -> list[Setup]:
    """Of each arm alone, where it begins."""
    assert plan.assembly is not None
    site, workcell = Site(), Workcell(ARMS[0])
    arms = [SiteArm(one.name, one.arm, one.tool, one.base) for one in plan.arms]
    crew = gather(plan, set_up_team(plan.assembly, arms, site), workcell)
    return [setup_of(one.job, workcell, one.structure) for one in crew.found]


class Here:
    """What two robots share: the time of the world, and blocks in it.

    Args:
        fast: seconds of it in one of this machine.
    """

    def __init__(self, fast: float = FAST) -> None:
        self.fast = fast
        self.begun, self.lock = time.monotonic(), threading.RLock()
        self.first: KinematicPlant | None = None

    def now(self) -> float:
        """[s of the robots]"""
        return self.fast * (time.monotonic() - self.begun)


class Went(NamedTuple):
    """What a robot did, or does."""

    motion: Motion
    until: float
    """So much of it [s]."""
    begin: float
    """[s of the world]"""
    end: float

    def at(self, now: float) -> np.ndarray:
        """float64[n] [rad]"""
        share = (now - self.begin) / max(self.end - self.begin, 1e-9)
        return self.motion.at(np.array([np.clip(share, 0.0, 1.0) * self.until]))[0][0]


class Robot:
    """A robot that takes as long as its motions do, at a speed that changes; blocks follow its hand
    and stay where they are let go, and it sees none.

    Args:
        here: where it is.
        setup: with its arm.
        late: how much later its clock is [s].
        seed: of its speed.
    """

    def __init__(self, here: Here, setup: Setup, late: float, seed: int) -> None:
        self.here, self.late = here, late
        self.chances = np.random.default_rng(seed)
        self.cell, self.arm = KinematicPlant(setup), setup.arm
        here.first = here.first or self.cell
        self.cell.things = here.first.things
        self.moves: list[Went] = []
        self.doing: Went | None = None
        self.halted = False
        self.fails: Callable[[Motion], bool] = lambda motion: False
        """Whether the controller loses a motion."""
        self.stopped = 0

    def at(self, moments: np.ndarray) -> np.ndarray:
        """float64[m, n] where it was at times float64[m] of the world [rad]."""
        now, found, left = self.moves[0].at(0.0), list[np.ndarray](), list(self.moves)
        for moment in moments.tolist():
            while left and left[0].end <= moment:
                one = left.pop(0)
                now = one.at(one.end)
            found.append(left[0].at(moment) if left and left[0].begin <= moment else now)
        return np.array(found)

    def latest(self) -> Readings:
        """See :class:`~learn2assemble.plants.robots.OneOfRobots`."""
        now, state = self.here.now(), "ready" if self.doing is None else "moving"
        where = self.cell.joints.copy() if self.doing is None else self.doing.at(now)
        tool = self.cell.sense().tool
        return Readings(now + self.late, where, 0 * where, (), tool, self.arm.name, state)

    def sense(self) -> Readings:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        assert self.doing is None, "one thread at a time uses a plant"
        return self.latest()

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        assert self.doing is None, "one thread at a time uses a plant"
        if self.fails(motion):
            return Report(Stop.LOST, 0.0, self.cell.joints.copy(), 0.0, "the line is dead")
        begin, slower = self.here.now(), float(self.chances.uniform(0.5, 2.0))
        with self.here.lock:
            report = self.cell.execute(motion, commands, guards)
            end = begin + slower * report.seconds
            self.doing = went = Went(motion, report.seconds, begin, end)
        while not self.halted and (left := end - self.here.now()) > 0:
            time.sleep(min(left / self.here.fast, 0.02))
        now = min(self.here.now(), end)
        self.doing, until = None, report.seconds * (now - begin) / max(end - begin, 1e-9)
        self.moves.append(went._replace(until=until, end=now))
        return report._replace(seconds=max(self.here.now() - begin, 0.0), played=None)

    def request(self, request: Request) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        raise AssertionError("who serves the cell does it")

    def stop(self) -> None:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        self.stopped += 1
        self.halted = self.doing is not None

    def close(self) -> None:
        """See :class:`~learn2assemble.plants.plant.Plant`."""


class Two:
    """Two robots, and a run of them.

    Args:
        plan: that they carry out.
        seed: of their speeds.
        fast: seconds of the robots in one of this machine; what is planned takes as long as it
            takes.
    """

    def __init__(self, plan: Plan, seed: int = 0, fast: float = FAST) -> None:
        self.plan, self.here = plan, Here(fast)
        one, other = setups_of(plan)
        self.robots = Robot(self.here, one, 40.0, seed), Robot(self.here, other, -7.0, seed + 100)
        clock = PlantClock(self.here.now)
        self.around = Surroundings(trust_placements=True, clock=clock, serve=self.serve)
        self.asked: list[str] = []

    def serve(self, request: Request) -> None:
        """A magazine, or a person."""
        what, name, kind, pose = request
        self.asked.append(f"{what} {name}")
        with self.here.lock:
            for robot, arm in zip(self.robots, ARMS, strict=True):
                if name == f"hand of {arm}":
                    assert robot.cell.hand is not None
                    name = robot.cell.hand[0]
                if what == "remove" and robot.cell.hand and robot.cell.hand[0] == name:
                    robot.cell.hand = None
            self.robots[0].cell.request(Request(what, name, kind, pose))

    def run(self, **given: Any) -> Ran:
        """Carry the plan out."""
        return run(self.plan, self.robots, **{"around": self.around, **given})

    def least(self) -> float:
        """Least distance of the arms at moments of all their motions [m]."""
        ends = [m for robot in self.robots for one in robot.moves for m in (one.begin, one.end)]
        moments = np.arange(min(ends), max(ends), 0.05)
        bodies = list[np.ndarray]()
        for robot in self.robots:
            joints = robot.at(moments)
            bodies.append(lines_at(get_chain(robot.arm), capsules_of(robot.arm), joints))
        sizes = [capsules_of(robot.arm).radius for robot in self.robots]
        return min(apart(a, sizes[0], b, sizes[1]) for a, b in zip(*bodies, strict=True))

    def together(self) -> float:
        """Share of the time of moving in which both move."""
        ends = [m for robot in self.robots for one in robot.moves for m in (one.begin, one.end)]
        moments = np.arange(min(ends), max(ends), 0.05)
        both = [np.abs(np.diff(robot.at(moments), axis=0)).max(1) > 1e-4 for robot in self.robots]
        return float((both[0] & both[1]).sum() / (both[0] | both[1]).sum())

    def placed(self) -> set[str]:
        """Names of the blocks that stand in places of the plan."""
        assert self.plan.assembly is not None
        wanted = [one.vertices for one in self.plan.assembly.blocks]
        middles = np.array([(one.min(0) + one.max(0)) / 2 for one in wanted])
        things = self.robots[0].cell.things.items()
        away = {name: np.linalg.norm(middles - one.pose[:3], axis=1).min() for name, one in things}
        return {name for name, far in away.items() if far < 1e-3}

    def errors(self) -> list[float]:
        """How far from its place the nearest block is [m], for each of the plan."""
        there = np.array([thing.pose[:3] for thing in self.robots[0].cell.things.values()])
        assert self.plan.assembly is not None
        wanted = [one.vertices for one in self.plan.assembly.blocks]
        middles = [(one.min(0) + one.max(0)) / 2 for one in wanted]
        return [float(np.linalg.norm(there - one, axis=1).min()) for one in middles]


def test_two_robots_build_at_the_same_time_and_keep_apart() -> None:
    """Whatever their clocks say, and however fast each goes."""
    two, said = Two(pair_plan(20, 2), fast=8.0), list[str]()
    ran = two.run(progress=said.append)
    assert ran.complete, ran.reason
    assert ran.stop is Stop.END
    assert max(two.errors()) < 1e-3
    count = len(ran.plan.steps)
    assert ran.blocks == count
    assert {step.arm for step in ran.plan.steps} == set(ARMS)
    assert [link.motions > 5 for link in ran.links] == [True, True]
    assert "0 steps left" in said[-1]
    # Both were on their ways at once, so the distance says something.
    assert two.together() > 0
    assert two.least() > KEPT


def test_without_rules_of_the_way_the_arms_would_meet(monkeypatch: pytest.MonkeyPatch) -> None:
    """That the distance could have come out bad."""
    monkeypatch.setattr(Traffic, "_clear", lambda *given: True)
    monkeypatch.setattr("learn2assemble.team.traffic.clear", lambda *given: True)
    for seed in range(8):
        two = Two(pair_plan(), seed)
        two.run()
        if two.least() < 0:
            return
    raise AssertionError("they never met")


def test_a_run_of_two_pauses_and_goes_on(tmp_path: Path) -> None:
    state, two, asked = tmp_path / "run.jsonl", Two(pair_plan()), list[str]()

    def confirm(done: int, what: str) -> bool:
        asked.append(what)
        return done < 3

    first = two.run(state=state, confirm=confirm)
    assert (first.reason, first.stop, first.blocks) == ("paused", Stop.END, 3)
    assert {what.split(" (")[1] for what in asked} == {"ur5e)", "panda)"}
    for name in ARMS:  # Nobody is asked twice about the same.
        own = [what for what in asked if name in what]
        assert all(one != other for one, other in pairwise(own))
    there = two.placed()
    assert len(there) == 3
    second = two.run(state=state)
    assert second.complete, second.reason
    assert second.blocks == len(second.plan.steps) - 3
    assert there <= two.placed()
    assert max(two.errors()) < 1e-3


def test_the_command_runs_two_arms_in_the_simulation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pair_plan(12, 2).save(tmp_path, page=False)
    assert main(["run", str(tmp_path), "--json", "--until", "2"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["reason"], said["blocks"]) == ("paused", 2)
    assert main(["run", str(tmp_path), "--json", "--resume"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["complete"]
    assert said["blocks"] == len(pair_plan(12, 2).steps) - 2
    assert said["seconds"] > 0
    assert [link["motions"] > 5 for link in said["links"]] == [True, True]
    assert main(["run", str(tmp_path), "--robot", "ur://127.0.0.1:9"]) == 2
    assert "one for each arm of the plan: ur5e, panda" in capsys.readouterr().err


@pytest.mark.parametrize("option", [["--step"], ["--until", "2"]])
def test_a_run_that_cannot_be_gone_on_with_is_not_paused(
    option: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = pair_plan(12, 2)
    held = replace(plan, steps=(*plan.steps[:1], replace(plan.steps[1], by_hand=True)))
    held.save(tmp_path, page=False)
    assert main(["run", str(tmp_path), *option]) == 2
    assert "so such a run cannot be gone on with" in capsys.readouterr().err


@pytest.mark.parametrize("stage", ["cross", "retreat"])
def test_where_one_controller_is_lost_the_other_arm_goes_on(stage: str, tmp_path: Path) -> None:
    two, state = Two(pair_plan()), tmp_path / "run.jsonl"
    lost = two.robots[1]
    lost.fails = lambda motion: motion.stage == stage and len(lost.moves) > 12
    first = two.run(state=state)
    if first.complete:
        # Which arm brings how many hangs on the machine: the other one has done all that was left.
        assert len(two.placed()) == len(pair_plan().steps)
        assert two.least() > KEPT
        return
    assert first.stop is Stop.LOST
    assert "panda: the line is dead" in (first.reason or "")
    assert lost.stopped
    done = len(lost.moves)
    # It works, or looks every 0.1 s whether it can.
    assert two.robots[0].moves[-1].end > lost.moves[-1].end - 0.2
    assert two.least() > KEPT
    lost.fails = lambda motion: False
    again = two.run(state=state)
    assert again.complete, again.reason
    assert len(lost.moves) > done
    assert max(two.errors()) < 1e-3
    # What the hand held is taken out of it by whoever serves the cell.
    assert ("remove hand of panda" in two.asked) == (stage == "cross")


def test_an_error_of_the_side_that_decides_stops_both() -> None:
    two = Two(pair_plan())

    def progress(text: str) -> None:
        if "place" in text:
            raise RuntimeError("a bug")

    with pytest.raises(RuntimeError, match="a bug"):
        two.run(progress=progress)
    assert all(robot.doing is None for robot in two.robots)
    assert len(two.placed()) < 4


# ---------------------------------------------------------------- real client libraries


class FakeControllers:
    """Two fake controllers of Universal Robots, each with a dynamic cell of its own, in which what
    the other arm has put down is put, too.

    Args:
        plan: that they carry out.
    """

    def __init__(self, plan: Plan) -> None:
        assert plan.assembly is not None
        self.own, self.lock = setups_of(plan), threading.RLock()
        self.targets = {piece.id: piece.target for piece in pieces_of(plan.assembly)}
        self.fakes = [begin("ur") for _ in self.own]
        for fake, setup in zip(self.fakes, self.own, strict=True):
            fake.cell(setup)
            fake.ask = self.locked(fake.ask)

    def locked(self, ask: Callable[..., Any]) -> Callable[..., Any]:
        """Threads of both runs ask."""

        def one_at_a_time(op: str, **given: Any) -> Any:
            with self.lock:
                return ask(op, **given)

        return one_at_a_time

    def plants(self) -> list[Plant]:
        """A connection to each."""
        found = list[Plant]()
        for fake, setup in zip(self.fakes, self.own, strict=True):
            told = Surroundings(patience=50.0, silence=PATIENT, answer=PATIENT, clock=fake.clock)
            address = f"ur://{fake.host}:{fake.ports['script']}"
            found.append(open_plant(address, Setup(setup.arm, {}, {}, around=told)))
        return found

    def poses(self, who: int) -> dict[str, np.ndarray]:
        """float64[3] of the blocks in a cell [m]."""
        return {n: np.array(p[:3]) for n, p in self.fakes[who].ask("state")["poses"].items()}

    def error(self, name: str, pose: np.ndarray) -> float:
        """How far a block is from its place [m]."""
        return float(np.linalg.norm(pose - self.targets[name]))

    def serve(self, request: Request) -> None:
        """A magazine of one of the arms: the one whose base is nearer."""
        what, name, kind, pose = request
        away = [np.linalg.norm(s.arm.base_position[:2] - pose[:2]) for s in self.own]
        who = int(np.argmin(away))
        mine, other = self.fakes[who], self.poses(1 - who)
        there = self.poses(who)
        for block, at in other.items():
            if block not in there and self.error(block, at) < 3e-3:
                where = [*at.tolist(), 1.0, 0.0, 0.0, 0.0]
                mine.ask("request", what="place", block=block, kind=block, pose=where)
        mine.ask("request", what=what, block=name, kind=kind, pose=pose.tolist())


def test_two_controllers_of_universal_robots_build_together() -> None:
    cells = np.ones((20, 2, 1), bool)
    plan = l2a.build(
        cells, kit="bricks-lintels", arm=("ur5e", "ur5e"), physics="kinematic", cell=0.032
    )
    two = FakeControllers(plan)
    plants = two.plants()
    try:
        around = Surroundings(trust_placements=True, serve=two.serve)
        ran = run(plan, plants, around=around)
        assert ran.complete, ran.reason
        assert ran.blocks == len(plan.steps)
        assert [link.motions > 0 for link in ran.links] == [True, True]
        found = two.poses(0) | two.poses(1)
        assert found.keys() == two.targets.keys()
        assert max(two.error(*one) for one in found.items()) < 3e-3
        assert [fake.ask("state")["odd"] for fake in two.fakes] == [[], []]
    finally:
        for plant in plants:
            plant.close()
        for fake in two.fakes:
            fake.close()


# ---------------------------------------------------------------- one decides at a time


class Slow(WrappedPlant):
    """A plant that needs this machine's time."""

    def __init__(self, plant: Plant) -> None:
        super().__init__(plant)
        self.inside = 0.0

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        self.inside = 1.0
        time.sleep(0.1)
        self.inside = 0.0
        return self.plant.execute(motion, commands, guards)


def cell_of_two(**around: Any) -> tuple[Robots, list[Slow]]:
    """A cell of two robots that take a tenth of a second for everything."""
    slow = [Slow(KinematicPlant(setup)) for setup in setups_of(pair_plan())]
    return Robots(slow, Surroundings(**around)), slow


def test_robots_move_at_once_and_one_thread_decides() -> None:
    cell, slow = cell_of_two()
    inside, seen = [0], list[float]()

    def job(who: int) -> str:
        for _ in range(4):
            inside[0] += 1
            assert inside[0] == 1
            time.sleep(0.001)
            inside[0] -= 1
            one = cell.plants[who]
            one.execute(standing("home", one.sense().joints, 0.1))
            seen.append(slow[1 - who].inside)
            # Of one that moves it is known where it was seen last, by another thread, too.
            assert len(cell.plants[1 - who].sense().joints) == len(slow[1 - who].sense().joints)
        return "done"

    began = time.monotonic()
    assert cell.run([lambda: job(0), lambda: job(1)]) == ["done", "done"]
    assert time.monotonic() - began < 0.75  # One after the other it would be 0.8 s.
    assert any(seen)


def test_a_person_comes_when_both_stand() -> None:
    served = list[tuple[str, float]]()
    cell, slow = cell_of_two(
        serve=lambda request: served.append((request.what, sum(one.inside for one in slow)))
    )
    pose = np.array([0.0, 0, 0, 1, 0, 0, 0])

    def works() -> None:
        for _ in range(5):
            one = cell.plants[0]
            one.execute(standing("home", one.sense().joints, 0.1))

    def asks() -> None:
        for what in ("place", "present", "remove", "present"):
            time.sleep(0.01)
            one = cell.plants[1]
            one.execute(standing("home", one.sense().joints, 0.1))
            one.request(Request(what, "a", "a", pose))

    cell.run([works, asks])
    assert [what for what, _ in served] == ["place", "present", "remove", "present"]
    assert all(inside == 0.0 for what, inside in served if what != "present")


def test_all_readings_are_on_one_clock() -> None:
    here = Here()
    own = setups_of(pair_plan())
    two = [Robot(here, own[0], 1e6, 0), Robot(here, own[1], -50.0, 0)]
    block = BlockReading("a", two[0].cell.joints[:1].repeat(7), np.zeros((6, 6)), here.now() + 1e3)
    around = Surroundings(clock=PlantClock(here.now), look=lambda: [block])
    cell = Robots(two, around)
    one, other = (plant.sense() for plant in cell.plants)
    assert abs(one.time - here.now()) < FAST
    assert abs(other.time - one.time) < FAST
    # Nothing is seen later than the robot was.
    assert one.blocks[0].time == one.time


# ---------------------------------------------------------------- a process of its own


class Watched(WrappedPlant):
    """A plant of which others see where it is, and that others stop.

    Args:
        told: a file to which it is written that it was stopped.
        setup: of it.
    """

    def __init__(self, told: Path, setup: Setup) -> None:
        super().__init__(KinematicPlant(setup))
        self.told, self.halted, self.begun = told, threading.Event(), 0.0

    def latest(self) -> Readings:
        """See :class:`~learn2assemble.plants.robots.OneOfRobots`."""
        return self.plant.sense()._replace(time=self.begun, state="moving")

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        self.halted.clear()
        self.begun += 1.0
        stop = Stop.REFUSED if self.halted.wait(motion.seconds) else Stop.END
        return Report(stop, 0.5, motion.joints[0], 0.1)

    def stop(self) -> None:
        self.halted.set()
        with self.told.open("a") as file:
            file.write("stopped\n")


def test_a_robot_in_a_process_of_its_own_is_watched_and_stopped_at_once(tmp_path: Path) -> None:
    told, setup = tmp_path / "told", setups_of(pair_plan())[0]
    far, found = in_process(partial(Watched, told), setup), list[Report]()
    here = far.sense().joints

    def goes(seconds: float) -> None:
        with contextlib.suppress(EOFError, OSError):
            found.append(far.execute(standing("home", here, seconds)))

    thread = threading.Thread(target=goes, args=(60.0,))
    thread.start()
    while (latest := far.latest()) is None or latest.time < 1.0:
        assert thread.is_alive()
        time.sleep(0.01)
    far.stop()
    thread.join(30.0)
    assert [one.stop for one in found] == [Stop.REFUSED]
    # Nobody is at the other end any more, as after a crash: it stops in the middle of its motion.
    far.connection.send(("execute", (standing("home", here, 60.0), (), ())))
    while (latest := far.latest()) is None or latest.time < 2.0:
        assert far.heard(30.0)
    count = told.read_text().count("stopped")
    far.connection.close()
    until = time.monotonic() + 30.0
    while told.read_text().count("stopped") == count and time.monotonic() < until:
        time.sleep(0.01)
    assert told.read_text().count("stopped") > count


class Dies(WrappedPlant):
    """A plant whose process ends at the first motion."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(KinematicPlant(setup))

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        os._exit(3)


def test_the_end_of_the_process_that_drives_a_robot_is_told() -> None:
    far = in_process(Dies, setups_of(pair_plan())[0])
    joints = far.sense().joints
    for _ in range(2):
        with pytest.raises(PlantError, match="the process that drives it has ended"):
            far.execute(standing("home", joints, 0.1))
    far.stop()
    far.close()


def test_what_is_wrong_with_a_robot_in_its_process_is_said_here() -> None:
    setup = setups_of(pair_plan())[0]
    with pytest.raises(Learn2AssembleError, match="the arm panda with its gripper"):
        in_process(partial(open_plant, "franka://192.0.2.1"), setup)


# ---------------------------------------------------------------- input


def test_what_two_robots_cannot_do_is_said() -> None:
    plan = pair_plan()
    with pytest.raises(InputError, match="one for each arm of the plan: ur5e, panda"):
        run(plan, "ur://192.0.2.1")
    with pytest.raises(InputError, match="it alone, for both arms"):
        run(plan, ["sim://", "ur://192.0.2.1"])
    with pytest.raises(InputError, match="did you mean 'ur'"):
        run(plan, ["url://192.0.2.1", "ur://192.0.2.1"])
    one = replace(plan, arms=plan.arms[:1])
    with pytest.raises(InputError, match="2 robots"):
        run(one, ["ur://192.0.2.1", "ur://192.0.2.2"])
    held = replace(plan, steps=(replace(plan.steps[0], action="hold"), *plan.steps[1:]))
    with pytest.raises(InputError, match="steps hold a block"):
        run(held, ["ur://192.0.2.1", "franka://192.0.2.2"])
    other = Site(arms=(SiteArm("ur5e", "panda"), SiteArm("panda", "panda")))
    with pytest.raises(InputError, match="as planned"):
        run(plan, layout=other)
    with pytest.raises(InputError, match="got 'panda', expected one of pandas"):
        run(plan, layout=Site(arms=(SiteArm("ur5e", "ur5e"), SiteArm("pandas", "panda"))))


def test_a_robot_that_is_not_at_home_keeps_both_from_moving() -> None:
    two = Two(pair_plan())
    two.robots[1].cell.joints[0] += 0.3
    ran = two.run()
    assert (ran.stop, ran.blocks) == (Stop.REFUSED, 0)
    assert "panda: the arm is not at home" in (ran.reason or "")
    assert not any(robot.moves for robot in two.robots)
