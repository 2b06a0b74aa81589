"""Builds whose blocks are seen through the cameras of the layout (``docs/sensing.md``)."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import learn2assemble as l2a
from learn2assemble.cell.carry_out import Workcell, carry_out, prepare, setup_of
from learn2assemble.cell.site import read_site
from learn2assemble.errors import InputError
from learn2assemble.motion.errors import block_errors
from learn2assemble.motion.files import read_record, write_record
from learn2assemble.motion.plant import Stop
from learn2assemble.motion.setup import Disturbance, Surroundings
from learn2assemble.planning.plan import Plan
from learn2assemble.sensing.pictures import CellCameras
from learn2assemble.simulation.kinematic_plant import KinematicPlant

CAMERAS = [
    {"name": "right", "position": [0.6, 0.5, 0.8], "look_at": [0, 0, 0]},
    {"name": "left", "position": [-0.6, 0.4, 0.8], "look_at": [0, 0, 0]},
]
CELLS = np.ones((1, 1, 2), bool)


def layout(folder: Path, cameras: list[dict[str, Any]]) -> Path:
    file = folder / "cell.json"
    head = {"format": "learn2assemble-layout", "version": 2}
    file.write_text(json.dumps(head | {"cameras": cameras}))
    return file


def built(**given: Any) -> Plan:
    return l2a.build(CELLS, kit="cubes", cell=0.05, arm="ur5e", physics="kinematic", **given)


@lru_cache(maxsize=1)
def planned() -> Plan:
    return built()


def test_a_build_sees_through_the_cameras_of_its_layout(tmp_path: Path) -> None:
    plan = built(layout=layout(tmp_path, CAMERAS))
    assert plan.complete, plan.reason
    assert plan.arm is not None
    assert plan.arm.attempts == 2
    assert plan.arm.error_worst is not None
    assert plan.arm.error_worst < 1e-3
    # Ideal readings would be exact.
    assert plan.arm.belief_error is not None
    assert 1e-6 < plan.arm.belief_error < 2e-3


def test_a_run_sees_through_them_and_goes_on(tmp_path: Path) -> None:
    file, state = layout(tmp_path, CAMERAS), tmp_path / "run.jsonl"
    first = l2a.run(planned(), layout=file, state=state, confirm=lambda done, what: done < 1)
    assert first.reason == "paused"
    assert first.blocks == 1
    then = l2a.run(planned(), layout=file, state=state)
    assert then.complete, then.reason
    assert then.blocks == 1
    assert then.plan.arm is not None
    assert then.plan.arm.belief_error is not None
    assert then.plan.arm.belief_error > 1e-6
    told_of_errors(then.plan, tmp_path)


def told_of_errors(plan: Plan, folder: Path) -> None:
    """What the record, its file and the page say of belief and truth."""
    record = plan.record
    assert record is not None
    # What was before the interruption is not told any more.
    assert record.steps[0].truth is None
    last = record.steps[-1]
    assert last.truth is not None
    far = np.linalg.norm((last.truth - last.after)[:, :3], axis=1)
    assert 1e-6 < far.max() < 2e-3
    write_record(record, folder / "trajectory.json")
    again = read_record(folder / "trajectory.json").steps[-1].truth
    assert again is not None
    assert np.abs(again - last.truth).max() < 1e-6
    # Every block is seen 1 mm too far to the left, and the second one stands 2 mm too low.
    left = np.array([1e-3, 0, 0, 0, 0, 0, 0])
    one, two = record.steps
    low = two.after + left
    low[two.cells[0], :3] = two.target[:3] - [0, 0, 2e-3]
    steps = replace(one, truth=one.after + left), replace(two, truth=low)
    first, second = sorted(block_errors(replace(record, steps=steps)), key=lambda e: e.first)
    assert (first.first, second.first) == (1, 2)
    assert first.belief == pytest.approx([1e-3, 1e-3])
    assert second.place == pytest.approx([2e-3])
    plan.save(folder / "out", video=False)
    page = (folder / "out" / "view.html").read_text()
    assert "Belief and truth" in page
    assert page.count("<figcaption>How far each block really was") == 2
    assert "where a block really is, errors" in page


def test_a_camera_that_is_elsewhere_moves_what_is_built(tmp_path: Path) -> None:
    """Pictures are taken from where cameras are, and read as if from where the layout has them."""
    site = read_site(layout(tmp_path, CAMERAS))
    off = ((0.004, 0.0, 0.0, 0.0, 0.0, 0.0),) * 2
    plan = planned()
    at = Workcell("ur5e", site=site, physics="kinematic", disturbance=Disturbance(cameras=off))
    done = carry_out(plan, at)
    assert done.arm is not None
    assert done.arm.error_mean == pytest.approx(0.004, abs=0.001)


def test_other_plants_are_shown_by_pictures_that_are_given(tmp_path: Path) -> None:
    site = read_site(layout(tmp_path, CAMERAS))
    arm = planned().arm
    assert arm is not None
    at = Workcell("ur5e", site=replace(site, base=arm.base), physics="kinematic")
    setup = setup_of(prepare(planned(), at, 1e-4).job, at)
    cell, taken = KinematicPlant(setup), []
    eyes = CellCameras(setup.arm, site.cameras)

    class Robot:
        """A plant that is no simulation as far as anybody can tell."""

        execute, request, stop = cell.execute, cell.request, cell.stop

        def sense(self) -> Any:
            return cell.sense()._replace(blocks=())

    def pictures() -> Any:
        taken.append(1)
        return eyes.look(cell.solids(), cell.sense())

    with pytest.raises(InputError, match="cameras: got 'right, left', expected what takes"):
        l2a.run(planned(), Robot(), layout=site)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="cameras: got 'right, left', expected what takes"):
        l2a.run(planned(), "ur://127.0.0.1:1", layout=site)
    around = Surroundings(pictures=pictures)
    ran = l2a.run(planned(), Robot(), layout=site, around=around)  # pyright: ignore[reportArgumentType]
    assert ran.complete, ran.reason
    assert len(taken) > 4


def test_cameras_that_show_nothing_end_a_build_in_one_line(tmp_path: Path) -> None:
    blind = [{**camera, "range": [3.0, 4.0]} for camera in CAMERAS]
    plan = built(layout=layout(tmp_path, blind))
    assert plan.status == "incomplete"
    assert plan.reason == "plant lost: nothing is seen by the cameras of the layout: right, left"
    ran = l2a.run(planned(), layout=layout(tmp_path, blind))
    assert (ran.stop, ran.blocks) == (Stop.LOST, 0)
    away = [{**CAMERAS[0], "look_at": [3.0, 3.0, 0.0]}]
    plan = built(layout=layout(tmp_path, away))
    assert plan.status == "incomplete"
    assert plan.reason is not None
    assert "is not seen" in plan.reason


def test_readings_have_the_noise_of_the_cameras_and_no_other(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="blocks are seen by right, left"):
        built(layout=layout(tmp_path, CAMERAS), noise=(1e-3, 0.01))
