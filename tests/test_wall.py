"""The wall between what is and what is known: a build sees readings of its plant, nothing else."""

from __future__ import annotations

import ast
import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from cell_shapes import wall
from learn2assemble.acting.building import Building
from learn2assemble.acting.carry_out import Workcell, carry_out, prepare, setup_of
from learn2assemble.assembly.kit import load_kit
from learn2assemble.design.cells import CellDesign
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.plants.plant import (
    BlockReading,
    Guard,
    Motion,
    Plant,
    PlantError,
    Readings,
    Report,
    Request,
    Stop,
)
from learn2assemble.plants.remote import in_process
from learn2assemble.plants.setup import Disturbance, Noise
from learn2assemble.simulation.plant import simulated

SOURCE = Path(__file__).resolve().parents[1] / "src" / "learn2assemble"
KIT = dataclasses.replace(load_kit("bricks-lintels"), pitch=(0.04, 0.04, 0.04))
NOISE = Noise(5e-4, math.radians(0.2), 5e-4, missing=0.02, outliers=0.01)
SUPPLY = Disturbance(supply=(1e-3, math.radians(1)))


def planned(*size: object) -> Plan:
    plan = plan_cells(CellDesign("wall", wall(*size), KIT.pitch, None, 0.0, None, "", None), KIT)
    assert plan.complete
    return plan


@pytest.fixture(scope="module")
def low() -> Plan:
    return planned(4, 1, 2)


@pytest.fixture(scope="module")
def window() -> Plan:
    return planned(9, 1, 5, (3, 6, 2, 4))


def workcell(**fields: object) -> Workcell:
    given = {"physics": "kinematic", "noise": NOISE, "disturbance": SUPPLY, **fields}
    return Workcell("panda", "suction", **given)


# ---------------------------------------------------------------- nothing gets past it


ROOMS = "cell", "acting", "team"
"""Of the side that decides."""


def test_the_cell_imports_nothing_that_holds_the_truth() -> None:
    hidden = {"plant", "things", "disturbances", "bench", "kinematic_plant", "simulation", "cup"}
    for path in sorted(path for room in ROOMS for path in (SOURCE / room).glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(
                "learn2assemble.simulation"
            ):
                assert node.module.rpartition(".")[2] not in hidden, path.name


def test_only_the_report_asks_for_the_truth_and_only_the_file_keeps_it() -> None:
    asks = {
        path.name
        for room in ROOMS
        for path in (SOURCE / room).glob("*.py")
        if "truth" in path.read_text(encoding="utf-8")
    }
    assert asks == {"report.py"}


@pytest.mark.parametrize("physics", ["kinematic", "dynamic"])
def test_a_plant_in_another_process_gives_the_same_build(low: Plan, physics: str) -> None:
    at = workcell(physics=physics, seed=3)
    near = carry_out(low, at)
    found = prepare(low, at, 1e-4)
    far = in_process(simulated, setup_of(found.job, at))
    try:
        other = carry_out(low, at, found=found, plant=far)
    finally:
        far.close()
    assert near.complete, near.reason
    assert near.arm == other.arm
    assert [step.position for step in near.steps] == [step.position for step in other.steps]
    assert [step.quaternion for step in near.steps] == [step.quaternion for step in other.steps]
    if near.record is not None:
        assert other.record is not None
        for one, two in zip(near.record.steps, other.record.steps, strict=True):
            assert np.array_equal(one.samples.joints, two.samples.joints)
            assert np.array_equal(one.after, two.after)


def test_the_same_readings_give_the_same_build_whatever_is_the_case(low: Plan) -> None:
    """A plant whose blocks are all elsewhere, which answers what another one did."""
    at = workcell(seed=5)
    found = prepare(low, at, 1e-4)
    told: list[tuple[str, object]] = []

    class Recorded:
        def __init__(self, plant: Plant) -> None:
            self.plant = plant

        def __getattr__(self, name: str) -> object:
            def ask(*given: object) -> object:
                answer = getattr(self.plant, name)(*given)
                told.append((name, answer))
                return answer

            return ask

    class Repeats:
        def __init__(self) -> None:
            self.answers = iter(told[:])

        def __getattr__(self, name: str) -> object:
            def ask(*given: object) -> object:
                asked, answer = next(self.answers)
                assert asked == name
                return answer

            return ask

    first = Building(found, at, Recorded(simulated(setup_of(found.job, at))))
    assert first.run() is None
    second = Building(found, at, Repeats())
    assert second.run() is None
    assert np.array_equal(first.world.pose, second.world.pose)
    assert first.known.done == second.known.done


# ---------------------------------------------------------------- plants that answer nonsense


class Mad:
    """A simulated plant that answers nonsense from its n-th answer on."""

    def __init__(self, plant: Plant, after: int, what: str) -> None:
        self.plant, self.left, self.what, self.stops = plant, after, what, 0

    def _mad(self) -> bool:
        self.left -= 1
        return self.left < 0

    def sense(self) -> Readings:
        found = self.plant.sense()
        if not self._mad():
            return found
        if self.what == "late":
            raise TimeoutError("nothing heard")
        if self.what == "lost":
            raise ConnectionResetError("reset by peer")
        pose, covariance, name = np.array([0.3, 0, 0, 1.0, 0, 0, 0]), np.eye(6), "b"
        if found.blocks:
            name, pose, covariance, _ = found.blocks[0]
        bad = {
            "nan": BlockReading(name, pose * np.nan, covariance, found.time),
            "name": BlockReading("nobody", pose, covariance, found.time),
            "covariance": BlockReading(name, pose, -np.eye(6), found.time),
        }
        if self.what == "clock":
            return found._replace(time=-1.0)
        if self.what == "arm":
            return found._replace(arm="ur5e")
        return found._replace(blocks=(bad[self.what],))

    def execute(
        self, motion: Motion, commands: object = (), guards: tuple[Guard, ...] = ()
    ) -> Report:
        report = self.plant.execute(motion, commands, guards)
        if self._mad() and self.what in ("late", "lost"):
            return report._replace(stop=Stop(self.what), detail="cable")
        return report

    def request(self, request: Request) -> Report:
        return self.plant.request(request)

    def stop(self) -> None:
        self.stops += 1

    def close(self) -> None:
        self.plant.close()


@pytest.mark.parametrize("what", ["nan", "name", "covariance", "clock", "arm", "late", "lost"])
@pytest.mark.parametrize("after", [0, 3, 40])
def test_a_plant_that_answers_nonsense_ends_the_build_in_words(
    low: Plan, what: str, after: int
) -> None:
    at = workcell()
    found = prepare(low, at, 1e-4)
    mad = Mad(simulated(setup_of(found.job, at)), after, what)
    plan = carry_out(low, at, found=found, plant=mad)
    assert plan.status == "incomplete"
    assert (plan.reason or "").startswith("plant ")
    assert "\n" not in (plan.reason or "")
    assert mad.stops >= 1
    for step in plan.steps:
        assert np.isfinite(step.position).all()


def test_blocks_that_are_never_seen_are_not_placed(low: Plan) -> None:
    class Blind(Mad):
        def sense(self) -> Readings:
            return self.plant.sense()._replace(blocks=())

    at = workcell()
    found = prepare(low, at, 1e-4)
    plan = carry_out(low, at, found=found, plant=Blind(simulated(setup_of(found.job, at)), 0, ""))
    assert plan.status == "incomplete"
    assert "is not seen" in (plan.reason or "")
    assert not plan.steps


def test_a_plant_at_a_wrong_arm_is_refused_before_anything_moves(low: Plan) -> None:
    at = workcell()
    found = prepare(low, at, 1e-4)
    other = prepare(low, dataclasses.replace(at, arm="ur5e"), 1e-4)
    plant = simulated(setup_of(other.job, dataclasses.replace(at, arm="ur5e")))
    plan = carry_out(low, at, found=found, plant=plant)
    assert "an arm 'ur5e', not 'panda'" in (plan.reason or "")
    assert plant.sense().time == 0.0


# ---------------------------------------------------------------- what is known is what was sensed


def test_noise_makes_builds_worse(window: Plan) -> None:
    """A figure that can come out bad: errors grow with the noise of what is seen."""
    worst = []
    for scale in (0.0, 1.0, 8.0):
        noise = Noise(5e-4 * scale, math.radians(0.2) * scale, 5e-4 * scale)
        plan = carry_out(window, workcell(noise=noise, seed=1))
        assert plan.arm is not None
        assert plan.arm.error_mean is not None
        worst.append(plan.arm.error_mean)
    assert worst[0] < 1e-4 < worst[1] < 1e-3 < worst[2]


def test_what_is_dropped_or_pushed_is_found_by_sensing(window: Plan) -> None:
    at = workcell(disturbance=SUPPLY._replace(drop=frozenset({2, 5}), push=frozenset({7})))
    plan = carry_out(window, at)
    assert plan.complete, plan.reason
    assert plan.arm is not None
    assert plan.arm.attempts > len(plan.steps)
    assert plan.arm.error_worst is not None
    assert plan.arm.error_worst < 3e-3
    assert plan.arm.belief_error is not None
    assert plan.arm.belief_error < 2e-3


def test_a_block_nobody_sees_any_more_is_replaced(window: Plan) -> None:
    """It falls off the table: no reading of it, ever again."""

    class Hole(Mad):
        gone: str | None = None

        def sense(self) -> Readings:
            found = self.plant.sense()
            return found._replace(blocks=tuple(b for b in found.blocks if b.block != self.gone))

        def execute(
            self, motion: Motion, commands: object = (), guards: tuple[Guard, ...] = ()
        ) -> Report:
            report = self.plant.execute(motion, commands, guards)
            if report.stop == Stop.VACUUM:
                self.gone = next(
                    n for n, t in self.plant.things.items() if t.handled and t.number == 2
                )
            return report

    at = workcell(disturbance=SUPPLY._replace(drop=frozenset({3})))
    found = prepare(window, at, KIT.joint_gap)
    hole = Hole(simulated(setup_of(found.job, at)), 0, "")
    plan = carry_out(window, at, found=found, plant=hole)
    assert hole.gone is not None
    assert plan.complete, plan.reason


def test_errors_of_a_plant_are_those_of_its_process() -> None:
    error = PlantError(Stop.LATE, "5 s")
    assert str(error) == "plant late: 5 s"
