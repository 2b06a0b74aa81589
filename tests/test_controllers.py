"""Arms behind controllers: the real client libraries against fake controllers on this machine."""

from __future__ import annotations

import importlib.util
import socket
import sys
import threading
import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fake_controller import FakeProcess
from fake_ur import Script, ScriptError
from learn2assemble.controllers.common import CLOSE, Address, ControllerClock, felt, thinned
from learn2assemble.controllers.ur import STATE, UrPlant
from learn2assemble.controllers.ur_motion import motion_script
from learn2assemble.errors import InputError, MissingExtraError
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.kinematics.inverse import solve
from learn2assemble.motion.driver import driver_of
from learn2assemble.plants.plant import (
    Guard,
    Motion,
    Plant,
    PlantError,
    Stop,
    ToolCommand,
    between,
    standing,
)
from learn2assemble.plants.settings import ProgramSettings
from learn2assemble.plants.setup import BlockKind, Setup, Surroundings, open_plant
from learn2assemble.robot.arm import Arm, get_arm
from learn2assemble.robot.bodies import Part
from learn2assemble.robot.moves import IMMOVABLE

ARM = get_arm("ur5e", "suction")
PATIENT = 1e3
"""How long the other side may be silent where nothing is asked of that [s]."""
WIDE, THIN, BLOCK = 0.05, 0.02, 0.16
"""Half the width and half the height of a block that waits at home [m], and its mass [kg]."""


def under_the_cup(arm: Arm) -> Setup:
    """A cell in which a block lies under the cup of an arm that is at home."""
    tip, _ = forward(get_chain(arm), arm.home)
    high = float(tip[2])
    low = high - 2 * THIN
    block = BlockKind((Part((0.0, 0.0, 0.0), (WIDE, WIDE, THIN)),), BLOCK / (8 * WIDE**2 * THIN))
    post = BlockKind((Part((0.0, 0.0, 0.0), (WIDE, WIDE, low / 2)),), IMMOVABLE)
    x, y = tip[:2].tolist()
    fixed = ((post, np.array([x, y, low / 2, 1.0, 0.0, 0.0, 0.0])),)
    waiting = {"a": np.array([x, y, high - THIN, 1.0, 0.0, 0.0, 0.0])}
    return Setup(arm, {"a": block}, waiting, fixed)


CELL = under_the_cup(ARM)
SAME = 1e-4
"""Joints of an arm that has not moved differ by less [rad]."""
NEEDS = {"ur": "rtde_receive", "ros2": "roslibpy"}


def free(host: str, port: int) -> bool:
    try:
        socket.create_server((host, port)).close()
    except OSError:
        return False
    return True


def begin(kind: str) -> FakeProcess:
    """A fake controller, or the reason why there can be none here."""
    if importlib.util.find_spec(NEEDS[kind]) is None:
        pytest.skip(f"the library {NEEDS[kind]} is not installed")
    # The ports of a controller are fixed, but a machine may have many addresses of its own.
    hosts = [f"127.0.0.{k}" for k in range(1, 9)] if kind == "ur" else ["127.0.0.1"]
    ports = (STATE, 29999) if kind == "ur" else ()
    for host in hosts:
        if all(free(host, port) for port in ports):
            return FakeProcess(kind, host)
    pytest.skip("the ports of a controller are in use on this machine")


class Fake:
    """A fake controller, and plants at it.

    Args:
        kind: ``ur`` or ``ros2``.
    """

    def __init__(self, kind: str) -> None:
        self.kind, self.process = kind, begin(kind)
        self.ask, self.clock = self.process.ask, self.process.clock

    def plant(self, **around: Any) -> Plant:
        """A new connection."""
        port = self.process.ports["script" if self.kind == "ur" else "bridge"]
        told = {"patience": 2.0, "silence": PATIENT, "clock": self.clock, **around}
        address = f"{self.kind}://{self.process.host}:{port}"
        return open_plant(address, Setup(ARM, {}, {}, around=Surroundings(**told)))

    def until(self, **wanted: Any) -> dict[str, Any]:
        """Its state when these are so."""
        for _ in range(2000):
            state = self.ask("state")
            if all(state[key] == value for key, value in wanted.items()):
                return state
            self.process.go(0.05)
        raise AssertionError(f"never {wanted}: {state}")

    def after(self, seconds: float) -> dict[str, Any]:
        """Its state after so long [s of the robot]."""
        self.process.go(seconds)
        return self.ask("state")

    def stands(self) -> np.ndarray:
        """Where the arm stands; it has to come to rest."""
        return np.array(self.until(moves=False)["joints"])


class Fakes:
    """One fake controller of each kind, begun when it is first asked for: tests in any order begin
    none twice."""

    def __init__(self) -> None:
        self.made = dict[str, Fake]()

    def of(self, kind: str) -> Fake:
        if kind not in self.made:
            self.made[kind] = Fake(kind)
        return self.made[kind]

    def close(self) -> None:
        for fake in self.made.values():
            fake.process.close()


@pytest.fixture(scope="module")
def fakes() -> Iterator[Fakes]:
    made = Fakes()
    yield made
    made.close()


@pytest.fixture(params=NEEDS)
def fake(request: pytest.FixtureRequest, fakes: Fakes) -> Fake:
    return fakes.of(request.param)


@pytest.fixture
def plant(fake: Fake) -> Iterator[Plant]:
    fake.process.cell(CELL)
    made = fake.plant()
    yield made
    made.close()


def motion(way: float, seconds: float = 1.0, start: np.ndarray | None = None) -> Motion:
    """All joints turn by so much [rad], from home, up."""
    first = ARM.home if start is None else start
    time_ = np.linspace(0, seconds, 101)
    s = time_ / seconds
    share, rate = s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2 / seconds
    step = way * np.array([1, -0.5, -0.3, 0.3, -0.3, 1.0])
    return Motion("cross", time_, first + share[:, None] * step, rate[:, None] * step)


# ---------------------------------------------------------------- motions


def test_a_motion_with_few_samples_is_the_same_motion() -> None:
    whole = motion(1.0)
    few = thinned(whole, [0.333])
    assert len(few.time) < 40
    assert 0.333 in few.time
    there = between(few, whole.time)[0]
    assert np.abs(there - whole.joints).max() <= CLOSE
    assert (few.joints[[0, -1]] == whole.joints[[0, -1]]).all()


def test_a_motion_arrives(fake: Fake, plant: Plant) -> None:
    before = plant.sense()
    assert before.arm == "ur5e"
    assert np.allclose(before.joints, ARM.home, atol=1e-6)
    asked = motion(0.4)
    report = plant.execute(asked)
    assert report.stop is Stop.END, report.detail
    assert report.done == 1
    assert np.abs(report.joints - asked.joints[-1]).max() <= 1e-3
    assert np.abs(fake.stands() - asked.joints[-1]).max() <= 1e-3
    # Not faster than asked; slower by no more than it takes to arrive and to be told.
    assert 0.9 <= report.seconds <= 1.0 + 0.5


def take_the_block(fake: Fake, plant: Plant) -> None:
    """Take hold of the block at home."""
    on = [ToolCommand(0.0, vacuum=True), ToolCommand(0.1, load=BLOCK)]
    report = plant.execute(standing("pick", ARM.home, 3.0), on, [Guard(hold="made")])
    assert report.stop is Stop.HELD, report.detail
    assert plant.sense().tool.vacuum
    fake.until(held="a")


def test_the_tool_is_told_in_time(fake: Fake, plant: Plant) -> None:
    """A block under the cup hangs on it from the moment the vacuum is made."""
    take_the_block(fake, plant)
    report = plant.execute(motion(0.2), (), [Guard(hold="kept")])
    assert report.stop is Stop.END, report.detail
    held = fake.until(held="a", moves=False)
    tip, _ = forward(get_chain(ARM), np.array(held["joints"]))
    assert np.linalg.norm(np.array(held["poses"]["a"][:3]) - tip) == pytest.approx(THIN, abs=5e-4)
    plant.execute(Motion("release", *[np.zeros(0)] * 3), [ToolCommand(vacuum=False)])
    fallen = fake.after(1.0)
    assert fallen["held"] is None
    assert fallen["poses"]["a"][2] < tip[2] - 2 * THIN


def test_forces_are_those_of_the_cell(fake: Fake, plant: Plant) -> None:
    """What is pressed on something pushes back, and a guard ends that."""
    take_the_block(fake, plant)
    assert np.abs(plant.sense().tool.force).max() < 8
    tip, turn = forward(get_chain(ARM), ARM.home)
    below = solve(ARM, tip - np.array([0.0, 0.0, 0.02]), turn, ARM.home)
    assert below.ok
    step = below.joints - ARM.home
    share = np.linspace(0, 1, 51)[:, None]
    time_, told = 3.0 * share[:, 0], ARM.home + (3 * share**2 - 2 * share**3) * step
    down = Motion("place", time_, told, 6 * (share - share**2) * step / 3.0)
    report = plant.execute(down, (), [Guard(contact=20.0)])
    assert report.stop is Stop.CONTACT, report.detail
    assert 0 < report.done < 0.9
    # The arm has braked, and stands on it.
    assert plant.sense().tool.force[2] > 1.0


# ---------------------------------------------------------------- what goes wrong


def test_a_protective_stop_is_said(fake: Fake, plant: Plant) -> None:
    fake.ask("later", what="protective", after=0.5)
    report = plant.execute(motion(0.5))
    assert report.stop is Stop.PROTECTIVE
    assert 0 < report.done < 1
    for _ in range(100):  # What is published of the state may be older than the report.
        if plant.sense().state == "stopped":
            break
        time.sleep(0.02)
    assert plant.sense().state == "stopped"
    where = fake.stands()
    assert plant.execute(motion(0.1, start=where)).stop is Stop.PROTECTIVE
    fake.ask("protective", on=False)
    for _ in range(100):
        if plant.sense().state == "ready":
            break
        time.sleep(0.02)
    back = motion(-0.1, start=where)
    assert plant.execute(back).stop is Stop.END


def test_what_comes_off_the_cup_stops_the_arm(fake: Fake, plant: Plant) -> None:
    take_the_block(fake, plant)
    fake.ask("later", what="drop", after=2.0, carried=0.5)
    asked = motion(0.8, 6.0)
    report = plant.execute(asked, (), [Guard(hold="kept")])
    assert report.stop is Stop.VACUUM, report.detail
    assert report.done < 1
    assert np.abs(fake.stands() - asked.joints[-1]).max() > 0.05
    assert fake.until(held=None)["vacuum"]


def test_a_motion_that_is_not_taken_is_refused(fake: Fake, plant: Plant) -> None:
    fake.ask("refuse")
    report = plant.execute(motion(0.5))
    assert report.stop is Stop.REFUSED
    assert report.detail
    assert np.abs(fake.stands() - ARM.home).max() < SAME
    assert plant.execute(motion(0.1)).stop is Stop.END


def test_a_motion_from_elsewhere_is_refused(fake: Fake, plant: Plant) -> None:
    report = plant.execute(motion(0.5, start=ARM.home + 0.2))
    assert report.stop is Stop.REFUSED
    assert "0.200 rad from where the motion begins" in report.detail
    assert np.abs(fake.stands() - ARM.home).max() < SAME


def test_a_slow_controller_is_late_and_the_arm_stands(fake: Fake, plant: Plant) -> None:
    fake.ask("slow", factor=8.0)
    report = plant.execute(motion(0.5, 1.0))
    assert report.stop is Stop.LATE
    fake.ask("slow", factor=1.0)
    fake.stands()


@pytest.mark.parametrize("by", [-5.0, 10_000.0])
def test_a_clock_that_jumps_is_a_lost_connection(fake: Fake, plant: Plant, by: float) -> None:
    fake.ask("later", what="clock", after=1.0, by=by)
    report = plant.execute(motion(0.5, 4.0))
    assert report.stop is Stop.LOST
    assert "clock" in report.detail
    assert np.abs(fake.stands() - motion(0.5).joints[-1]).max() > 0.05


def test_a_lost_connection_is_said_and_a_new_one_goes_on(fake: Fake, plant: Plant) -> None:
    fake.ask("later", what="cut", after=1.0)
    report = plant.execute(motion(0.5, 4.0))
    assert report.stop is Stop.LOST
    with pytest.raises(PlantError, match="lost"):
        plant.sense()
    where = fake.stands()
    again = fake.plant()
    assert again.sense().state == "ready"
    assert again.execute(motion(-0.1, start=where)).stop is Stop.END
    again.close()


def test_stop_and_close_may_be_called_at_any_time(fake: Fake, plant: Plant) -> None:
    plant.stop()
    plant.stop()
    plant.close()
    plant.close()


def test_what_was_closed_is_asked_nothing(fakes: Fakes) -> None:
    fake = fakes.of("ur")
    fake.process.cell(CELL)
    plant = fake.plant()
    plant.close()
    with pytest.raises(PlantError, match="lost"):
        plant.sense()


def test_an_arm_that_nobody_watches_stops_by_itself(fakes: Fakes) -> None:
    """What watches is the program in the controller; so it also does where we have crashed."""
    fake = fakes.of("ur")
    fake.process.cell(CELL)
    plant = fake.plant(patience=0.4)
    fake.ask("later", what="cut", seconds=30.0, after=1.0)
    asked = motion(1.0, 12.0)
    assert plant.execute(asked).stop is Stop.LOST
    where = fake.stands()
    assert np.abs(where - asked.joints[0]).max() > 1e-4
    assert np.abs(where - asked.joints[-1]).max() > 0.5
    plant.close()


# ---------------------------------------------------------------- who is there


@pytest.mark.parametrize(
    "address",
    [
        "",
        "ur",
        "ur:",
        "ur://",
        "ur://a b",
        "ur://host:0",
        "ur://host:x",
        "ur://host/path",
        "ros2://:1",
    ],
)
def test_an_address_that_is_none_is_refused(address: str) -> None:
    if importlib.util.find_spec("roslibpy") is None and address.startswith("ros2"):
        pytest.skip("the library roslibpy is not installed")
    with pytest.raises(InputError):
        open_plant(address, Setup(ARM, {}, {}))


def test_a_scheme_nobody_knows_names_the_nearest() -> None:
    with pytest.raises(InputError, match="did you mean 'ros2'"):
        open_plant("ros://host", Setup(ARM, {}, {}))


def test_places() -> None:
    assert Address.read("ur", "10.0.0.2", 30002) == ("10.0.0.2", 30002)
    assert Address.read("ur", "robot:31", 30002) == ("robot", 31)


@pytest.mark.parametrize("kind", ["ur", "ros2"])
def test_a_host_that_does_not_answer(kind: str) -> None:
    if importlib.util.find_spec(NEEDS[kind]) is None:
        pytest.skip(f"the library {NEEDS[kind]} is not installed")
    host = "127.0.0.9" if kind == "ur" else "127.0.0.1:1"
    with pytest.raises(PlantError, match="lost") as error:
        open_plant(f"{kind}://{host}", Setup(ARM, {}, {}))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "answer", [b"", b"HTTP/1.1 400 Bad Request\r\n\r\n", b"\0\4V\0", b"\0\4V\1\0"]
)
def test_something_else_behind_the_address(answer: bytes) -> None:
    if importlib.util.find_spec("rtde_receive") is None:
        pytest.skip("the library ur-rtde is not installed")
    host = next((h for h in ("127.0.0.1", "127.0.0.7") if free(h, STATE)), None)
    if host is None:
        pytest.skip("the port of a controller is in use on this machine")
    with socket.create_server((host, STATE)) as listener:

        def serve() -> None:
            connection, _ = listener.accept()
            with connection:
                connection.recv(100)
                connection.sendall(answer)

        thread = threading.Thread(target=serve)
        thread.start()
        with pytest.raises(PlantError, match="refused"):
            UrPlant(host, Setup(ARM, {}, {}))
        thread.join()


def test_joints_of_another_robot_are_refused() -> None:
    fake = Fake("ros2")
    try:
        fake.ask("names", names=["joint_a", "joint_b", "joint_c", "joint_d", "joint_e", "joint_f"])
        with pytest.raises(PlantError, match="shoulder_pan_joint"):
            fake.plant()
    finally:
        fake.process.close()


def test_another_arm_than_the_controller_is_for_is_refused() -> None:
    with pytest.raises(InputError, match="panda"):
        UrPlant("127.0.0.1", Setup(get_arm("panda", "suction"), {}, {}))


def test_without_the_extra_the_error_names_it(monkeypatch: pytest.MonkeyPatch) -> None:

    for module, address, name in (
        ("rtde_receive", "ur://127.0.0.1", "ur"),
        ("roslibpy", "ros2://127.0.0.1", "ros2"),
    ):
        monkeypatch.setitem(sys.modules, module, None)
        with pytest.raises(MissingExtraError, match=rf"\[{name}\]"):
            open_plant(address, Setup(ARM, {}, {}))


def test_a_robot_feels_only_what_is_more_than_noise() -> None:
    guards = [Guard(1.0, force=30.0), Guard(contact=1.0, force=0.5, held=40.0)]
    first, second = felt(guards, 8.0)
    assert (first.begin, first.contact, first.force, first.held) == (0.0, 8.0, 20.0, None)
    assert (second.begin, second.contact, second.force) == (1.0, None, 30.0)


def test_clocks() -> None:
    clock = ControllerClock(0.5)
    assert not clock.odd(5.0, 100.0)
    assert not clock.odd(5.1, 100.1)
    assert not clock.odd(5.1, 100.5)
    assert "no state" in clock.odd(5.1, 100.7)
    assert "back" in clock.odd(4.0, 100.8)
    assert "jumped" in clock.odd(400.0, 100.9)


# ---------------------------------------------------------------- programs


def script(settings: ProgramSettings | None = None) -> str:
    asked = thinned(motion(0.3), [0.25])
    told = [ToolCommand(0.25, vacuum=True), ToolCommand(0.25, load=0.5)]
    guards = [Guard(force=30.0), Guard(0.25, contact=5.0, hold="kept")]
    return motion_script(asked, told, guards, driver_of(ARM), settings or ProgramSettings(), 7, 0.2)


def test_a_program_is_what_a_controller_takes() -> None:
    text = script()
    lines = text.splitlines()
    # One function, and nothing else in the first column: so a controller knows where it ends.
    assert (lines[0], lines[-1]) == ("def l2a_motion():", "end")
    assert all(line.startswith("  ") for line in lines[1:-1])
    assert text.isascii()
    Script(text)
    assert "set_tool_digital_out(0, True)" in text
    told = ProgramSettings().output._replace(bank="standard", number=3, on=False)
    held = ProgramSettings().input._replace(bank="standard", number=1, threshold=2.5)
    other = script(ProgramSettings(output=told, input=held))
    assert "set_standard_digital_out(3, False)" in other
    assert "get_standard_analog_in(1) >= 2.5" in other
    Script(other)


def test_the_reader_of_programs_finds_faults() -> None:
    text = script()
    for old, new in (
        ("servoj(", "servo("),
        ("l2a_finish(1)", "l2a_finish(1, 2)"),
        ("global l2a_time", "local l2a_times"),
        ("  end\n  def l2a_to", "  def l2a_to"),
        ("lookahead_time", "look_ahead"),
        ("set_payload(", "set_payload(1, "),
    ):
        assert old in text
        with pytest.raises(ScriptError):
            Script(text.replace(old, new, 1))


# ---------------------------------------------------------------- a stand-in of franky


class FrankyStandIn:
    """The part of ``franky`` that is used, with a robot that is where it was sent."""

    def __init__(self, ends: str = "") -> None:
        self.calls: list[tuple[str, Any]] = []
        self.ends, self.clock, self.target = ends, 0.0, get_arm("panda").home
        mode = SimpleNamespace(name="Idle")
        stand_in = self

        class Robot:
            def __init__(self, host: str) -> None:
                if host == "nobody":
                    raise OSError("no route to host")
                stand_in.calls.append(("robot", host))

            @property
            def state(self) -> Any:
                stand_in.clock += 0.05
                return SimpleNamespace(
                    q=stand_in.target,
                    dq=np.zeros(7),
                    O_F_ext_hat_K=np.zeros(6),
                    robot_mode=mode,
                    time=SimpleNamespace(to_sec=lambda: stand_in.clock),
                )

            def move(self, motion: Any, asynchronous: bool = False) -> None:
                assert asynchronous
                stand_in.calls.append(("move", motion))
                stand_in.target, stand_in.left = motion[-1][0][0], 5

            def poll_motion(self) -> bool:
                if stand_in.ends:
                    raise RuntimeError(stand_in.ends)
                stand_in.left -= 1
                return stand_in.left > 0

            def set_load(self, mass: float, centre: Any, inertia: Any) -> None:
                assert (len(centre), len(inertia)) == (3, 9)
                stand_in.calls.append(("load", mass))

            def stop(self) -> None:
                stand_in.calls.append(("stop", None))

        class Gripper:
            def __init__(self, host: str) -> None:
                self.state = SimpleNamespace(width=0.05, is_grasped=False)

            def grasp_async(self, width: float, speed: float, force: float, *more: float) -> None:
                stand_in.calls.append(("grasp", (width, force)))
                self.state.is_grasped = True

            def move_async(self, width: float, speed: float) -> None:
                stand_in.calls.append(("open", width))

        self.Robot, self.Gripper = Robot, Gripper
        self.JointState = lambda q, v: (q, v)
        self.Duration = int
        self.JointWaypoint = lambda state, minimum_time: (state, minimum_time)
        self.JointWaypointMotion = list


def franka(monkeypatch: pytest.MonkeyPatch, ends: str = "") -> tuple[Plant, FrankyStandIn]:
    stand_in = FrankyStandIn(ends)
    monkeypatch.setitem(sys.modules, "franky", stand_in)
    return open_plant("franka://robot", Setup(get_arm("panda"), {}, {})), stand_in


def panda_motion() -> Motion:
    time_ = np.linspace(0, 1.0, 51)
    share, rate = time_**2 * (3 - 2 * time_), 6 * time_ * (1 - time_)
    step = np.full(7, 0.1)
    joints = get_arm("panda").home + share[:, None] * step
    return Motion("cross", time_, joints, rate[:, None] * step)


def test_franka_calls_in_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    plant, stand_in = franka(monkeypatch)
    asked = panda_motion()
    told = [ToolCommand(0.0, load=0.3), ToolCommand(1.0, width=0.04, force=20.0)]
    report = plant.execute(asked, told)
    assert report.stop is Stop.END, report.detail
    assert (report.joints == asked.joints[-1]).all()
    names = [name for name, _ in stand_in.calls]
    assert names == ["robot", "move", "load", "grasp"]
    points = stand_in.calls[1][1]
    assert sum(least for _, least in points) == pytest.approx(1000, abs=len(points))
    report = plant.execute(Motion("release", *[np.zeros(0)] * 3), [ToolCommand(width=0.08)])
    assert report.stop is Stop.END
    assert stand_in.calls[-1] == ("open", 0.08)
    grasped = plant.execute(standing("pick", asked.joints[-1], 9.0), (), [Guard(hold="made")])
    assert grasped.stop is Stop.HELD
    plant.close()


def test_what_franka_raises_is_a_protective_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    plant, stand_in = franka(monkeypatch, "libfranka: communication_constraints_violation")
    stand_in.left = 5
    report = plant.execute(panda_motion())
    assert report.stop is Stop.PROTECTIVE
    assert "communication" in report.detail


def test_franka_needs_its_arm_and_somebody_who_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "franky", FrankyStandIn())
    with pytest.raises(InputError, match="the arm panda with its gripper"):
        open_plant("franka://robot", Setup(ARM, {}, {}))
    with pytest.raises(PlantError, match="no route to host"):
        open_plant("franka://nobody", Setup(get_arm("panda"), {}, {}))


def test_the_stand_in_has_what_the_library_has() -> None:
    if importlib.util.find_spec("franky") is None:
        pytest.skip("the library franky-control is not installed")
    import franky

    lib: Any = franky
    for name in ("move", "poll_motion", "set_load", "stop", "state"):
        assert hasattr(lib.Robot, name)
    for name in ("grasp_async", "move_async", "state"):
        assert hasattr(lib.Gripper, name)
    state = lib.JointState(np.zeros(7), np.zeros(7))
    point = lib.JointWaypoint(state, minimum_time=lib.Duration(10))
    assert lib.JointWaypointMotion([point])
    assert lib.Duration(1500).to_sec() == 1.5
    assert lib.RobotMode.Idle.name == "Idle"
