"""Plans carried out by robots: simulated ones, and the real client libraries against fake
controllers, with everything that goes wrong on the way."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from learn2assemble.acting.carry_out import prepare, setup_of
from learn2assemble.assembly.kit import DEFAULT_KIT, load_kit
from learn2assemble.cell.site import Site
from learn2assemble.cell.workcell import Job, Workcell
from learn2assemble.cli import main
from learn2assemble.design.cells import CellDesign
from learn2assemble.errors import InputError
from learn2assemble.files import claim_folder
from learn2assemble.jobs.driven import IN_HAND, Timed
from learn2assemble.jobs.run import Ran, run
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.reports import ArmReport
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.plants.plant import (
    BlockReading,
    Commands,
    Guards,
    Motion,
    Report,
    Request,
    Stop,
    ToolCommand,
    standing,
)
from learn2assemble.plants.safety import Box, Safety
from learn2assemble.plants.setup import Noise, Setup, Surroundings, open_plant
from learn2assemble.robot.arm import get_arm
from test_controllers import NEEDS, PATIENT, SAME, Fake, Fakes, under_the_cup

NOISE = Noise(4e-4, 2e-3)
"""Of the cameras, where there are some."""
EDGE = 0.032
"""Of a cell [m]."""


@lru_cache(maxsize=4)
def wall(x: int, y: int, z: int, holed: bool = False) -> tuple[Plan, Job]:
    """A wall of bricks with an arm before it: its plan, and the job of the arm."""
    cells = np.ones((x, y, z), bool)
    if holed:
        cells[7:13, :, 5:10] = False
    kit = load_kit(DEFAULT_KIT).at_pitch((EDGE, EDGE, EDGE))
    design = CellDesign("wall", cells, kit.pitch, None, 0.0, None, "", None)
    plan = plan_cells(design, kit, seconds=120.0)
    assert plan.complete, plan.reason
    job = prepare(plan, Workcell("ur5e", "suction"), 1e-4).job
    u, v, w = job.arm.base_position.tolist()
    base = (u, v, w, float(job.arm.base_yaw - get_arm("ur5e").base_yaw))
    return replace(plan, arm=ArmReport("ur5e", 0.0, 0, (), 0.0, "suction", base)), job


class Cell:
    """A fake controller with the blocks of a plan in the dynamic cell, what sees them, and the
    person beside it.

    Args:
        fake: its controller.
        plan: that is carried out.
        job: of it.
    """

    def __init__(self, fake: Fake, plan: Plan, job: Job) -> None:
        self.fake, self.plan, self.job, self.kind = fake, plan, job, fake.kind
        self.ask = fake.ask
        self.fake.process.cell(setup_of(job, Workcell("ur5e", "suction", noise=NOISE)))

    def serve(self, request: Request) -> None:
        """A magazine, or a person."""
        what, name, kind, pose = request
        if name == IN_HAND:
            name = self.ask("state")["held"] or name
        self.ask("request", what=what, block=name, kind=kind, pose=pose.tolist())

    def run(self, eyes: bool = False, answer: float = PATIENT, **given: Any) -> Ran:
        """Carry the plan out.

        Args:
            eyes: cameras see the blocks; else they are taken to be where they were put.
            answer: in which the controller has to begin with what it is told [s].
        """
        port = self.fake.process.ports["script" if self.kind == "ur" else "bridge"]
        around = Surroundings(
            serve=self.serve,
            look=self.fake.process.look if eyes else None,
            trust_placements=not eyes,
            patience=3.0,
            silence=PATIENT,
            answer=answer,
            clock=self.fake.clock,
        )
        address = f"{self.kind}://{self.fake.process.host}:{port}"
        return run(self.plan, address, **{"around": around, **given})

    def errors(self) -> dict[str, float]:
        """How far the blocks of the plan are from their places [m]."""
        poses = self.ask("state")["poses"]
        return {
            piece.id: float(np.linalg.norm(np.array(poses[piece.id][:3]) - piece.target))
            for piece in self.job.pieces
            if piece.id in poses
        }


@pytest.fixture(scope="module")
def fakes() -> Iterator[Fakes]:
    made = Fakes()
    yield made
    made.close()


@pytest.fixture(params=NEEDS)
def fake(request: pytest.FixtureRequest, fakes: Fakes) -> Fake:
    return fakes.of(request.param)


@pytest.fixture
def cell(fake: Fake) -> Cell:
    return Cell(fake, *wall(6, 3, 1))


def test_a_build_behind_a_controller(cell: Cell) -> None:
    said: list[str] = []
    ran = cell.run(progress=said.append)
    assert ran.stop is Stop.END, ran.reason
    assert ran.complete, ran.reason
    assert ran.plan.arm is not None
    assert ran.plan.arm.failures == ()
    count = len(cell.job.pieces)
    assert ran.blocks == count
    errors = cell.errors()
    assert len(errors) == count
    assert max(errors.values()) <= 3e-3
    assert ran.plan.complete
    assert ran.seconds_a_block
    assert ran.link.motions > 5 * count
    assert said[-1].endswith("0 steps left")


# ---------------------------------------------------------------- what goes wrong


def finished(cell: Cell, state: Path, most: int = 4) -> list[Ran]:
    """Runs until everything is done; the arm stands after each."""
    found: list[Ran] = []
    for _ in range(most):
        found.append(cell.run(state=state))
        cell.fake.stands()
        if found[-1].complete:
            return found
    raise AssertionError([ran.reason for ran in found])


def assert_built(cell: Cell) -> None:
    """All blocks are in their places, by their names or those of the ones that replaced them."""
    poses = [np.array(pose[:3]) for pose in cell.ask("state")["poses"].values()]
    for piece in cell.job.pieces:
        assert min(np.linalg.norm(pose - piece.target) for pose in poses) <= 3e-3, piece.id
    assert cell.ask("state")["held"] is None
    assert cell.ask("state")["odd"] == []


def test_a_run_pauses_and_goes_on(cell: Cell, tmp_path: Path) -> None:
    state, asked = tmp_path / "run.jsonl", list[tuple[int, str]]()

    def confirm(done: int, what: str) -> bool:
        asked.append((done, what))
        return done < 1

    first = cell.run(state=state, confirm=confirm)
    assert (first.reason, first.stop, first.blocks) == ("paused", Stop.END, 1)
    assert [done for done, _ in asked] == [0, 1]
    assert asked[0][1].startswith("place block-")
    assert first.plan.status == "incomplete"
    placed = set(cell.errors())
    second = cell.run(state=state)
    assert second.complete, second.reason
    assert second.blocks == len(cell.job.pieces) - 1
    assert placed <= set(cell.errors())
    assert_built(cell)


FAULTS: dict[str, tuple[dict[str, Any], Stop]] = {
    "cut while it goes": ({"what": "cut", "after": 1.0}, Stop.LOST),
    "cut with a block in the hand": ({"what": "cut", "after": 5.0}, Stop.LOST),
    "protective stop": ({"what": "protective", "after": 4.5}, Stop.PROTECTIVE),
    "slow": ({"what": "slow", "after": 2.0, "factor": 50.0}, Stop.LATE),
    "clock": ({"what": "clock", "after": 3.0, "by": -7.0}, Stop.LOST),
    "refused": ({"what": "refuse", "after": 3.0}, Stop.REFUSED),
    "vacuum": ({"what": "drop", "after": 5.0, "carried": 0.5}, Stop.END),
    "cut as the vacuum is made": ({"what": "cut", "after": 1.0, "carried": 1e-3}, Stop.LOST),
}
"""What happens so long after the arm first moves [s of its clock], and how the run ends then."""


@pytest.mark.parametrize("fault", FAULTS)
def test_after_a_fault_the_arm_stands_and_the_run_goes_on(
    fault: str, cell: Cell, tmp_path: Path
) -> None:
    if cell.kind == "ros2" and fault in ("cut while it goes", "slow", "clock"):
        pytest.skip("the plant is tested without a build: it takes long behind ROS")
    given, stop = FAULTS[fault]
    cell.ask("later", **given)
    answer = 2.0 if fault == "refused" else PATIENT
    first = cell.run(eyes=fault == "vacuum", answer=answer, state=tmp_path / "run.jsonl")
    cell.fake.stands()
    assert first.stop is stop, first.reason
    if stop is Stop.END:
        assert first.complete, first.reason
        assert first.plan.arm is not None
        assert first.plan.arm.failures[0].outcome in ("dropped", "grasp-lost")
    else:
        assert first.reason
        assert "\n" not in first.reason
        cell.ask("protective", on=False)
        cell.ask("slow", factor=1.0)
        finished(cell, tmp_path / "run.jsonl")
    assert_built(cell)


class Cuts(NamedTuple):
    """A run whose connection was cut, and that went on every time."""

    good: int
    """Cuts that ended a run as they should."""
    placed: int
    """Blocks that were placed by all runs."""
    attempts: int
    failures: list[str]
    """Outcomes of those that did not reach what they should."""


def cut_often(cell: Cell, state: Path, span: float, times: int) -> Cuts:
    """A run whose connection is cut so many times at random moments.

    Args:
        state: its file.
        span: longest time until the next cut [s of the robot].
    """
    rng, good, placed = np.random.default_rng(7), 0, 0
    for _ in range(times):
        cell.ask("later", what="cut", after=float(rng.uniform(0.5, span)))
        ran = cell.run(state=state)
        good += ran.stop is Stop.LOST
        placed += ran.blocks
        cell.fake.stands()
    ran = finished(cell, state)[-1]
    assert ran.plan.arm is not None
    failures = [f"{one.outcome}: {one.detail}" for one in ran.plan.arm.failures]
    return Cuts(good, placed + ran.blocks, ran.plan.arm.attempts, failures)


@pytest.mark.slow
def test_the_connection_is_cut_five_times(fake: Fake, tmp_path: Path) -> None:
    """A hundred bricks and ten cuts take minutes: ``python tests/test_run.py``."""
    cell = Cell(fake, *wall(6, 3, 1))
    cuts = cut_often(cell, tmp_path / "run.jsonl", 4.5, 5)
    assert cuts.good >= 4, cuts  # The last ones may come when everything is done.
    # None was placed twice; one that had been let go when the connection was cut is counted by no
    # run, and stands all the same.
    assert cuts.placed <= len(cell.job.pieces)
    assert_built(cell)


# ---------------------------------------------------------------- before anything moves


def test_a_robot_that_is_not_at_home_does_not_move(cell: Cell) -> None:
    away = cell.job.arm.home + np.array([0.3, 0, 0, 0, 0, 0])
    cell.fake.process.cell(setup_of(cell.job, Workcell("ur5e"))._replace(joints=away))
    ran = cell.run()
    assert (ran.stop, ran.blocks, ran.link.motions) == (Stop.REFUSED, 0, 0)
    assert "not at home: shoulder_pan is 0.30 rad away" in (ran.reason or "")
    assert np.abs(cell.fake.stands() - away).max() < SAME


def test_a_stopped_robot_does_not_move(cell: Cell) -> None:
    cell.ask("protective")
    ran = cell.run()
    assert (ran.stop, ran.link.motions) == (Stop.PROTECTIVE, 0)
    assert np.abs(cell.fake.stands() - cell.job.arm.home).max() < SAME


def test_a_full_hand_is_emptied_first_or_nothing_moves(cell: Cell) -> None:
    cell.fake.process.cell(under_the_cup(cell.job.arm))
    port = cell.fake.process.ports["script" if cell.kind == "ur" else "bridge"]
    address = f"{cell.kind}://{cell.fake.process.host}:{port}"
    around = Surroundings(patience=3.0, silence=PATIENT, answer=PATIENT, clock=cell.fake.clock)
    plant = open_plant(address, Setup(cell.job.arm, {}, {}, around=around))
    told = [ToolCommand(vacuum=True)]
    assert plant.execute(standing("pick", cell.job.arm.home, 2.0), told).stop is Stop.END
    plant.close()
    cell.fake.until(held="a")
    ran = run(cell.plan, address, around=around._replace(trust_placements=True))
    assert (ran.stop, ran.link.motions) == (Stop.REFUSED, 0)
    assert "the hand holds something" in (ran.reason or "")
    assert cell.run(confirm=lambda done, what: False).reason == "paused"
    state = cell.ask("state")
    assert (state["held"], state["vacuum"]) == (None, False)


def test_without_eyes_nothing_is_moved(cell: Cell) -> None:
    around = Surroundings(
        serve=cell.serve, patience=3.0, silence=PATIENT, answer=PATIENT, clock=cell.fake.clock
    )
    ran = cell.run(around=around)
    assert not ran.complete
    assert ran.blocks == 0
    assert "is not seen" in (ran.reason or "")


def test_an_eye_that_sees_what_is_not_there_ends_the_run(cell: Cell) -> None:
    def look() -> list[BlockReading]:
        return [BlockReading("unicorn", np.array([0.0, 0, 0, 1, 0, 0, 0]), np.zeros((6, 6)), 0.0)]

    around = Surroundings(
        serve=cell.serve,
        look=look,
        patience=3.0,
        silence=PATIENT,
        answer=PATIENT,
        clock=cell.fake.clock,
    )
    ran = cell.run(around=around)
    assert ran.stop is Stop.REFUSED
    assert "unicorn" in (ran.reason or "")
    assert np.abs(cell.fake.stands() - cell.job.arm.home).max() < SAME


def test_a_motion_that_leaves_the_box_is_not_sent(cell: Cell) -> None:
    ran = cell.run(layout=Site(safety=Safety(box=Box((-2.0, -2.0, 0.3), (2.0, 2.0, 2.0)))))
    assert (ran.stop, ran.blocks) == (Stop.REFUSED, 0)
    assert "safety.box" in (ran.reason or "")
    # Where it could not even wait, nothing is asked of it.
    high = Site(safety=Safety(box=Box((-2.0, -2.0, 0.9), (2.0, 2.0, 2.0))))
    with pytest.raises(InputError, match=r"safety\.box, where \w+ waits"):
        cell.run(layout=high)


def test_eyes_take_the_place_of_trust(cell: Cell) -> None:
    """Cameras that see all blocks, with their errors."""
    ran = cell.run(eyes=True)
    assert ran.complete, ran.reason
    assert max(cell.errors().values()) <= 3e-3


def test_slower_as_asked(cell: Cell) -> None:
    ran = cell.run(speed=0.5, confirm=lambda done, what: done < 1)
    assert ran.blocks == 1
    share = cell.ask("state")["share"]
    # The cubics between the points of a program exceed the speed by less than a thousandth.
    assert share <= 0.5 * 0.8 * 1.001


# ---------------------------------------------------------------- input


def test_motions_are_timed_beside_the_speed_that_was_asked_for() -> None:
    plan, _ = wall(4, 1, 1)
    ran = run(plan, speed=0.5)
    assert ran.complete, ran.reason
    assert abs(ran.link.overhead) < 1e-3
    assert ran.seconds >= ran.link.moving > 0


def test_an_arm_that_only_stands_makes_no_motion() -> None:
    class Plays:
        def execute(self, motion: Motion, commands: Commands, guards: Guards) -> Report:
            return Report(Stop.END, 0.0, motion.joints[-1], motion.seconds)

    plant: Any = Plays()
    timed = Timed(plant)
    timed.execute(standing("home", np.zeros(6), 1.0))
    assert timed.link(plant).motions == 0
    timed.execute(standing("release", np.zeros(6), 1.0), (ToolCommand(vacuum=False),))
    assert timed.link(plant).motions == 1


def test_plans_that_no_arm_can_carry_out_are_refused(tmp_path: Path) -> None:
    plan, _ = wall(6, 3, 2)
    with pytest.raises(InputError, match="a complete plan of an arm"):
        run(replace(plan, arm=None))
    with pytest.raises(InputError, match="a complete plan of an arm"):
        run(replace(plan, status="incomplete"))
    with pytest.raises(InputError, match="speed"):
        run(plan, speed=0.0)
    with pytest.raises(InputError, match="sim://"):
        run(plan, "localhost")
    nobody: Any = 5
    with pytest.raises(InputError, match="or a plant"):
        run(plan, nobody)
    with pytest.raises(InputError, match="got 'sim://foo', expected sim:// alone"):
        run(plan, "sim://foo")
    with pytest.raises(InputError, match="did you mean 'ur'"):
        run(plan, "url://localhost")


def test_a_run_in_the_simulation(tmp_path: Path) -> None:
    plan, job = wall(6, 3, 2)
    ran = run(plan, confirm=lambda done, what: done < 2, state=tmp_path / "run.jsonl")
    assert (ran.reason, ran.blocks) == ("paused", 2)
    again = run(plan, state=tmp_path / "run.jsonl")
    assert again.complete, again.reason
    assert again.blocks == len(job.pieces) - 2
    assert again.plan.arm is not None
    assert (again.plan.arm.error_worst or 1.0) <= 1e-3


def test_one_process_at_a_time_runs_a_plan(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan, _ = wall(4, 1, 1)
    plan.save(tmp_path, page=False)
    with claim_folder(tmp_path, resume=True):
        assert main(["run", str(tmp_path)]) == 2
    assert "nothing else is writing into" in capsys.readouterr().err
    assert main(["run", str(tmp_path)]) == 0
    assert not (tmp_path / ".lock").exists()


def test_what_breaks_a_rule_goes_on_with_another_layout_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan, _ = wall(6, 3, 2)
    plan.save(tmp_path, page=False)
    file, head = tmp_path / "layout.json", {"format": "learn2assemble-layout", "version": 2}
    box = [[-2, -2, 0.3], [2, 2, 2]]
    file.write_text(json.dumps({**head, "safety": {"box": box}}))
    call = ["run", str(tmp_path), "--layout", str(file), "--until", "1"]
    assert main(call) == 1
    said = capsys.readouterr().out
    assert "outside the layout's safety.box" in said
    assert "when `safety` of the layout allows it, goes on with --resume" in said
    file.write_text(json.dumps({**head, "safety": {"speed": 0.5}}))
    assert main([*call, "--resume"]) == 0


def test_the_command(
    cell: Cell, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.plan.save(tmp_path, page=False)
    port = cell.fake.process.ports["script" if cell.kind == "ur" else "bridge"]
    address = f"{cell.kind}://{cell.fake.process.host}:{port}"
    monkeypatch.setattr("learn2assemble.cli.running._serve", cell.serve)
    told = Surroundings(
        serve=cell.serve,
        trust_placements=True,
        patience=3.0,
        silence=PATIENT,
        answer=PATIENT,
        clock=cell.fake.clock,
    )
    monkeypatch.setattr("learn2assemble.plants.setup.Surroundings", lambda **given: told)
    call = ["run", str(tmp_path), "--robot", address, "--trust-placements", "--json"]
    assert main([*call, "--until", "1"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["reason"], said["blocks"]) == ("paused", 1)
    assert main(call) == 2
    assert "--resume" in capsys.readouterr().err
    assert main([*call, "--resume"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["complete"]
    assert said["blocks"] == len(cell.job.pieces) - 1
    assert said["seconds_a_block"] > 0
    assert not (tmp_path / "run.jsonl").exists()


def main_of_figures(kinds: list[str]) -> None:
    """A hundred bricks in the dynamic cell behind each controller, the connection cut ten times."""
    import tempfile
    import time

    for kind in kinds or ["ur", "ros2"]:
        fake = Fake(kind)
        cell, begun = Cell(fake, *wall(20, 3, 16, True)), time.process_time()
        with tempfile.TemporaryDirectory() as folder:
            cuts = cut_often(cell, Path(folder) / "run.jsonl", 120.0, 10)
        state, took = cell.ask("state"), time.process_time() - begun
        poses = np.array([pose[:3] for pose in state["poses"].values()])
        errors = [np.linalg.norm(poses - piece.target, axis=1).min() for piece in cell.job.pieces]
        print(
            f"{kind}: {len(errors)} bricks in {cuts.attempts} attempts, {cuts.good} of 10 cuts "
            f"ended as lost; errors {1e3 * np.mean(errors):.2f} mm on average, "
            f"{1e3 * max(errors):.2f} mm at worst; {state['time']:.0f} s of the robot; "
            f"{took:.0f} s of the processor, and {state['worked']:.0f} s in its process; "
            f"odd: {state['odd']}; failures: {cuts.failures}",
            flush=True,
        )
        fake.process.close()


if __name__ == "__main__":
    import sys

    main_of_figures(sys.argv[1:])
