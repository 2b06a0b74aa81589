"""The contract between the side that decides and a plant: nonsense never gets past the wall."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from learn2assemble.errors import InputError
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.plants.checked import Checked, covariance_is_sound
from learn2assemble.plants.plant import (
    BlockReading,
    Commands,
    Guard,
    Guards,
    Motion,
    PlantError,
    Readings,
    Report,
    Request,
    Stop,
    ToolCommand,
    ToolReading,
    standing,
)
from learn2assemble.plants.setup import BlockKind, Setup, open_plant
from learn2assemble.plants.trust import Trusted
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.bodies import Part

ARM = get_arm("panda", "suction")
HERE = np.array([0.4, 0.1, 0.02, 1.0, 0.0, 0.0, 0.0])
SEEN = BlockReading("b1", HERE, np.diag([1e-6] * 3 + [1e-5] * 3), 1.0)
GOOD = Readings(1.0, ARM.home.copy(), np.zeros(7), (SEEN,), ToolReading(vacuum=False), "panda")
DONE = Report(Stop.END, 1.0, ARM.home.copy(), 0.5)
MOTION = standing("home", ARM.home, 0.5)


class Scripted:
    """Answers what it was told to, and counts how often it was stopped."""

    def __init__(self, readings: object = GOOD, report: object = DONE) -> None:
        self.readings, self.report, self.stops = readings, report, 0

    def sense(self) -> object:
        return self._answer(self.readings)

    def execute(self, motion: Motion, commands: object = (), guards: object = ()) -> object:
        return self._answer(self.report)

    def request(self, request: Request) -> object:
        return self._answer(self.report)

    def stop(self) -> None:
        self.stops += 1

    def close(self) -> None:
        pass

    @staticmethod
    def _answer(answer: object) -> object:
        if isinstance(answer, Exception):
            raise answer
        return answer


def checked(plant: Scripted, **more: float) -> Checked:
    return Checked(plant, "panda", 7, {"b1", "b2"}, **more)


def test_answers_that_make_sense_pass_unchanged() -> None:
    plant = checked(Scripted())
    assert plant.sense() is not None
    assert plant.sense().blocks == (SEEN,)
    assert plant.execute(MOTION, (), (Guard(contact=1.0),)) == DONE
    assert plant.request(Request("present", "b1", "b1", HERE)) == DONE


def block(**fields: object) -> Readings:
    return GOOD._replace(blocks=(SEEN._replace(**fields),))


@pytest.mark.parametrize(
    ("readings", "what"),
    [
        (None, "instead of readings"),
        (GOOD._replace(time=np.nan), "without a time"),
        (GOOD._replace(arm="ur5e"), "an arm 'ur5e'"),
        (GOOD._replace(state="asleep"), "a state"),
        (GOOD._replace(joints=np.zeros(6)), "joints"),
        (GOOD._replace(velocity=np.full(7, np.inf)), "velocity"),
        (block(block="b7"), "does not exist"),
        (block(block=3), "does not exist"),
        (block(pose=np.full(7, np.nan)), "a pose of b1"),
        (block(pose=np.zeros(7)), "a pose of b1"),
        (block(pose=HERE.astype(np.float32)), "a pose of b1"),
        (block(covariance=-np.eye(6)), "a covariance of b1"),
        (block(covariance=np.triu(np.ones((6, 6)))), "a covariance of b1"),
        (block(time=2.0), "from the future"),
        (GOOD._replace(blocks=(SEEN, SEEN)), "two readings of b1"),
        (GOOD._replace(blocks=("b1",)), "a reading of type str"),
        (GOOD._replace(tool=None), "a tool"),
        (GOOD._replace(tool=ToolReading(vacuum="yes")), "a vacuum"),
        (GOOD._replace(tool=ToolReading(width=np.nan)), "a width"),
        (GOOD._replace(tool=ToolReading(force=(0.0, 0.0))), "a force"),
    ],
)
def test_readings_that_make_no_sense_stop_the_arm(readings: object, what: str) -> None:
    plant = Scripted(readings)
    with pytest.raises(PlantError, match=what) as error:
        checked(plant).sense()
    assert error.value.stop == Stop.REFUSED
    assert "\n" not in str(error.value)
    assert plant.stops == 1


@pytest.mark.parametrize(
    ("report", "stop", "what"),
    [
        ("done", Stop.REFUSED, "instead of a report"),
        (DONE._replace(stop="end of the world"), Stop.REFUSED, "an end"),
        (DONE._replace(done=1.5), Stop.REFUSED, "a share"),
        (DONE._replace(done=np.nan), Stop.REFUSED, "a share"),
        (DONE._replace(seconds=-1.0), Stop.REFUSED, "a motion of"),
        (DONE._replace(joints=np.zeros(6)), Stop.REFUSED, "joints"),
        (DONE._replace(stop=Stop.LOST), Stop.LOST, "lost"),
        (DONE._replace(stop=Stop.LATE, detail="5 s"), Stop.LATE, "5 s"),
        (TimeoutError("no answer\nin 5 s"), Stop.LATE, "no answer in 5 s"),
        (ConnectionResetError("reset"), Stop.LOST, "reset"),
        (EOFError(), Stop.LOST, "EOFError"),
    ],
)
def test_reports_that_make_no_sense_stop_the_arm(report: object, stop: Stop, what: str) -> None:
    plant = Scripted(report=report)
    for ask in (
        lambda p: p.execute(MOTION),
        lambda p: p.request(Request("return", "b1", "b1", HERE)),
    ):
        with pytest.raises(PlantError, match=what) as error:
            ask(checked(plant))
        assert error.value.stop == stop
        assert "\n" not in str(error.value)
    assert plant.stops == 2


def test_the_clock_does_not_go_back_and_late_readings_are_left_out() -> None:
    plant = Scripted(GOOD._replace(time=5.0))
    wall = checked(plant, oldest=2.0)
    assert wall.sense().blocks == ()  # Seen at 1 s.
    plant.readings = GOOD._replace(time=4.0)
    with pytest.raises(PlantError, match="clock went back by 1"):
        wall.sense()


def test_values_and_errors_travel() -> None:
    again = pickle.loads(pickle.dumps(GOOD))
    assert again.blocks[0].block == "b1"
    assert np.array_equal(again.blocks[0].covariance, SEEN.covariance)
    error = pickle.loads(pickle.dumps(PlantError(Stop.LATE, "5 s")))
    assert (error.stop, str(error)) == (Stop.LATE, "plant late: 5 s")


@pytest.mark.parametrize(
    ("matrix", "sound"),
    [
        (np.zeros((6, 6)), True),
        (np.eye(6), True),
        (np.outer(range(6), range(6)).astype(float), True),
        (np.eye(5), False),
        (np.diag([1.0, 1, 1, 1, 1, -1e-6]), False),
        (np.full((6, 6), np.nan), False),
        (None, False),
    ],
)
def test_covariances(matrix: object, sound: bool) -> None:
    assert covariance_is_sound(matrix) == sound


@pytest.mark.parametrize("address", ["panda", "", "teleport://moon"])
def test_addresses_nobody_knows(address: str) -> None:
    with pytest.raises(InputError) as error:
        open_plant(address, None)
    assert "\n" not in str(error.value)


# Blocks that nobody sees are taken to be where they were put, and what clutches goes along.


class Blind:
    """A plant that moves at once, and whose cup holds whatever it is told to."""

    def __init__(self) -> None:
        self.joints, self.time = ARM.home.copy(), 0.0

    def sense(self) -> Readings:
        self.time += 1.0
        return Readings(self.time, self.joints, 0 * self.joints, (), ToolReading(), ARM.name)

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        self.joints = motion.joints[-1].copy()
        return Report(Stop.END, 1.0, self.joints, motion.seconds, "", ToolReading(vacuum=True))

    def request(self, request: Request) -> Report:
        return Report(Stop.END, 1.0, self.joints, 0.0)

    def stop(self) -> None: ...

    def close(self) -> None: ...


def test_what_clutches_a_block_in_the_hand_goes_along_until_it_is_let_go() -> None:
    tip, _ = forward(get_chain(ARM), ARM.home)
    kind = BlockKind((Part((0.0, 0.0, 0.0), (0.02, 0.02, 0.01)),), 600.0)
    x, y, z = tip.tolist()
    places = {
        "lead": np.array([x, y, z - 0.01, 1, 0, 0, 0]),
        "other": np.array([x, y, z - 0.03, 1, 0, 0, 0]),
        "apart": np.array([x + 0.2, y, z - 0.01, 1, 0, 0, 0]),
    }
    plant = Trusted(Blind(), Setup(ARM, dict.fromkeys(places, kind), places))
    plant.request(Request("join", "other", "lead", places["other"]))
    plant.execute(standing("pick", ARM.home, 0.5), (ToolCommand(vacuum=True),))
    there = ARM.home + np.array([0.4, 0, 0, 0, 0, 0, 0])
    plant.execute(standing("carry", there, 0.5))
    seen = {one.block: one.pose for one in plant.sense().blocks}
    point, _ = forward(get_chain(ARM), there)
    assert np.allclose(seen["lead"][:3], point - [0, 0, 0.01], atol=1e-9)
    assert np.allclose(seen["other"][:3], point - [0, 0, 0.03], atol=1e-9)
    assert (seen["apart"] == places["apart"]).all()
    assert plant.state()["poses"].keys() == {"apart"}
    plant.execute(standing("release", there, 0.5), (ToolCommand(vacuum=False),))
    plant.execute(standing("retreat", ARM.home, 0.5))
    after = {one.block: one.pose for one in plant.sense().blocks}
    assert all((after[name] == seen[name]).all() for name in places)
