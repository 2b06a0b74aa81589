"""What is lost is found, tags, and a plant that is seen through cameras (``docs/sensing.md``)."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import learn2assemble as l2a
from brick_data import BRICK, CORNER, TURNS, lying, off_by, shifted
from learn2assemble.acting.carry_out import Workcell, carry_out, prepare, setup_of
from learn2assemble.cell.site import read_site
from learn2assemble.errors import InputError
from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix, yaw_matrix
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.motion.attempts import block_errors
from learn2assemble.motion.files import read_record, write_record
from learn2assemble.planning.plan import Plan
from learn2assemble.plants.checked import Checked
from learn2assemble.plants.plant import (
    Motion,
    Readings,
    Report,
    Request,
    Stop,
    ToolReading,
    standing,
)
from learn2assemble.plants.setup import Disturbance, Surroundings
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.bodies import Part
from learn2assemble.sensing.camera import DepthCamera, DepthPicture, looking
from learn2assemble.sensing.eyes import SeeingPlant, Sort
from learn2assemble.sensing.pictures import CellCameras, SimulatedCamera, still_scene
from learn2assemble.sensing.registration import Believed, Look, register
from learn2assemble.sensing.residuals import views_of
from learn2assemble.sensing.search import find
from learn2assemble.simulation.kinematic_plant import KinematicPlant

OTHER = DepthCamera("other", (-0.6, 0.4, 0.8, *looking(np.array([0.6, -0.4, -0.8]))))
BOTH = (CORNER, OTHER)


def seen_by(cameras: tuple[DepthCamera, ...], solids: list, seed: int = 0) -> list[DepthPicture]:
    scene = still_scene(solids)
    return [SimulatedCamera(camera, seed=seed).look([scene]) for camera in cameras]


# ---------------------------------------------------------------- what is lost


def test_blocks_that_were_dropped_are_found_on_any_face() -> None:
    wall = [(BRICK, lying(0.0801 * x, 0.1, 0.0, 0.015 + 0.03 * z)) for z in (0, 1) for x in (0, 1)]
    on_its_side = yaw_matrix(0.7) @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    side = np.array([0.1, -0.15, 0.02, *matrix_quaternion(on_its_side)])
    flat = lying(-0.12, -0.1, -0.4)
    views = views_of(seen_by(BOTH, [*wall, (BRICK, flat), (BRICK, side)]), BOTH)
    lost = [Believed(name, BRICK, None, TURNS) for name in ("a", "b", "c")]
    found = find(views, lost, wall)
    assert [one.look for one in found] == [Look.SEEN, Look.SEEN]
    for true in (flat, side):
        assert min(np.linalg.norm(one.pose[:3] - true[:3]) for one in found) < 0.001
    assert not find(views_of(seen_by(BOTH, wall), BOTH), lost, wall)


def test_no_block_is_found_inside_of_another() -> None:
    """What lies on a plate shows as much of itself as a brick that is let into it would."""
    plate, flat = (Part((0, 0, 0), (0.1, 0.1, 0.02)),), (Part((0, 0, 0), (0.04, 0.02, 0.01)),)
    below, true = lying(0.0, 0.0, 0.0, 0.02), lying(0.01, -0.01, 0.3, 0.05)
    views = views_of(seen_by(BOTH, [(plate, below), (flat, true)]), BOTH)
    lost, known = [Believed("a", BRICK, None, TURNS)], [(plate, below)]
    assert not find(views, lost, known)
    # As long as nobody sees that the plate is there, the brick may be.
    (found,) = find(views, lost, [], known)
    assert found.pose[2] == pytest.approx(true[2] + 0.01 - 0.015, abs=0.001)
    (found,) = find(views, [Believed("b", flat, None, TURNS)], known)
    assert np.linalg.norm(found.pose[:3] - true[:3]) < 0.001


# ---------------------------------------------------------------- tags


def test_tags_tell_which_block_is_where() -> None:
    pytest.importorskip("pupil_apriltags")
    from learn2assemble.sensing.tags import BlockTag, drawn, tagged_readings

    near = DepthCamera("near", (0.2, 0.2, 0.35, *looking(np.array([-0.2, -0.2, -0.35]))), frames=1)
    tags = {n: BlockTag(f"b{n}", np.array([0.0, 0, 0.015, 1, 0, 0, 0]), 0.03) for n in (3, 7)}
    where = {"b3": lying(0.03, 0.02, 0.4), "b7": lying(-0.05, -0.04, -1.0)}
    printed = [(n, shifted(where[f"b{n}"], [0, 0, 0.015]), 0.03) for n in tags]
    (picture,) = seen_by((near,), [(BRICK, pose) for pose in where.values()])
    assert not tagged_readings(picture, near, tags, {})
    picture = drawn(picture, near, [*printed, (11, lying(0.1, -0.1, 0.0, 1e-4), 0.03)])
    for believed in ({}, where):
        readings = tagged_readings(picture, near, tags, believed)
        assert sorted(one.block for one in readings) == ["b3", "b7"]
        for one in readings:
            off = off_by(one.pose, where[one.block])
            assert np.linalg.norm(off[:3]) < 0.0015
            assert np.linalg.norm(off[3:]) < 0.03
            assert off @ np.linalg.solve(one.covariance, off) < 40


def test_a_tag_behind_a_block_is_not_seen() -> None:
    pytest.importorskip("pupil_apriltags")
    from learn2assemble.sensing.tags import detect, drawn

    above = DepthCamera("above", (0, 0, 0.4, *looking(np.array([0.0, 0, -1]))), frames=1)
    (free,) = seen_by((above,), [])
    (covered,) = seen_by((above,), [(BRICK, lying(0.0, 0.0, 0.0))])
    tag = [(5, lying(0.0, 0.0, 0.0, 1e-4), 0.03)]
    assert [one.number for one in detect(drawn(free, above, tag).grey)] == [5]
    assert not detect(drawn(covered, above, tag).grey)


# ---------------------------------------------------------------- another library


def test_small_gicp_finds_the_same_top() -> None:
    """Point to plane by another library, on points of the faces that are seen."""
    gicp = pytest.importorskip("small_gicp")
    ours, theirs = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        true = lying(*rng.uniform(-0.1, 0.1, 2), rng.uniform(-3, 3))
        near = shifted(true, rng.normal(0, 0.001, 2))
        (picture,) = seen_by((CORNER,), [(BRICK, true)], seed)
        points = CORNER.points(picture.depth.astype(float))[picture.depth > 0]
        local = (points - near[:3]) @ quaternion_matrix(near[3:])
        close = (np.abs(local) < np.array(BRICK[0].half) + 0.006).all(1) & (points[:, 2] > 0.006)
        grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 41)] * 2), -1).reshape(-1, 2)
        faces = [np.insert(grid, k, s, 1) * BRICK[0].half for k in range(3) for s in (-1, 1)]
        toward = quaternion_matrix(near[3:]).T @ (CORNER.position - near[:3])
        model = np.vstack([f for f in faces if toward @ f.mean(0) > np.abs(f.mean(0)).max() ** 2])
        found = gicp.align(
            model,
            local[close],
            registration_type="PLANE_ICP",
            max_correspondence_distance=0.008,
            downsampling_resolution=0.0015,
            num_threads=1,
        ).T_target_source
        there = near[:3] - quaternion_matrix(near[3:]) @ found[:3, :3].T @ found[:3, 3]
        theirs.append(np.linalg.norm(there - true[:3]))
        seen = register(views_of([picture], [CORNER]), Believed("a", BRICK, near, TURNS))
        ours.append(np.linalg.norm(seen.pose[:3] - true[:3]))
    assert np.median(ours) < 0.0005
    assert np.median(theirs) < 0.0008


# ---------------------------------------------------------------- a plant


class Bench:
    """A cell in which the hand is where it is told to be, and blocks stick to it."""

    def __init__(self) -> None:
        self.arm = get_arm("ur5e", tool="suction")
        self.joints, self.time, self.vacuum = self.arm.home.copy(), 0.0, False
        self.blocks: dict[str, np.ndarray] = {}
        self.moved = np.zeros(3)
        self.looks = 0
        self.cameras = CellCameras(self.arm, BOTH, seed=3)

    def sense(self) -> Readings:
        tool, velocity = ToolReading(vacuum=self.vacuum), np.zeros_like(self.joints)
        return Readings(self.time, self.joints, velocity, (), tool, "ur5e")

    def pictures(self) -> list[DepthPicture]:
        self.looks += 1
        return self.cameras.look([(BRICK, p) for p in self.blocks.values()], self.sense())

    def execute(self, motion: Motion, commands: object = (), guards: object = ()) -> Report:
        self.time += motion.seconds
        return Report(
            Stop.END, 1.0, self.joints, motion.seconds, "", ToolReading(vacuum=self.vacuum)
        )

    def request(self, request: Request) -> Report:
        if request.what == "present":
            self.blocks[request.block] = shifted(request.pose, [0.002, -0.001])
        else:
            self.blocks.pop(request.block, None)
        return Report(Stop.END, 1.0, self.joints, 0.0)

    def stop(self) -> None: ...

    def close(self) -> None: ...


def seeing(bench: Bench, waiting: dict[str, np.ndarray]) -> SeeingPlant:
    sorts = {name: Sort(BRICK, TURNS) for name in ("a", "b", "c")}
    return SeeingPlant(bench, bench.arm, BOTH, bench.pictures, sorts, waiting)


def test_a_plant_seen_through_cameras() -> None:
    bench = Bench()
    first = lying(-0.1, 0.05, 0.3)
    bench.blocks["a"] = shifted(first, [-0.002, 0.001])
    plant = seeing(bench, {"a": first})
    checked = Checked(plant, "ur5e", 6, {"a", "b", "b2"})
    readings = checked.sense()
    assert [one.block for one in readings.blocks] == ["a"]
    assert np.linalg.norm(readings.blocks[0].pose[:3] - bench.blocks["a"][:3]) < 0.001
    # Within the time of a picture the same one is shown.
    assert checked.sense().blocks[0].pose is readings.blocks[0].pose
    assert bench.looks == 1
    where = lying(0.1, -0.05, 0.0)
    checked.request(Request("present", "b2", "b", where))
    assert {one.block for one in checked.sense().blocks} == {"a"}
    checked.execute(standing("home", bench.joints, 0.2))
    seen = {one.block: one.pose for one in checked.sense().blocks}
    assert np.linalg.norm(seen["b2"][:3] - bench.blocks["b2"][:3]) < 0.001
    # Somebody carries it away, and it is found; then it is gone, and not seen.
    bench.blocks["b2"] = lying(0.05, 0.2, 1.0)
    checked.execute(standing("home", bench.joints, 0.2))
    seen = {one.block: one.pose for one in checked.sense().blocks}
    assert np.linalg.norm(seen["b2"][:3] - bench.blocks["b2"][:3]) < 0.001
    checked.request(Request("return", "b2", "b", where))
    assert {one.block for one in checked.sense().blocks} == {"a"}
    bench.blocks.clear()
    checked.execute(standing("home", bench.joints, 0.2))
    assert not checked.sense().blocks


def test_what_is_in_the_hand_is_expected_where_the_hand_is() -> None:
    bench = Bench()
    place, turn = forward(get_chain(bench.arm), bench.joints)
    held = np.array([*(place + turn @ [0, 0, 0.015]), *matrix_quaternion(turn)])
    bench.blocks["a"] = held
    plant = seeing(bench, {"a": held})
    bench.vacuum = True
    plant.execute(standing("grasp", bench.joints, 0.1))
    assert plant.held is not None
    assert plant.held[0] == "a"
    bench.joints = bench.joints + np.array([0.2, 0, 0, 0, 0, 0.1])
    plant.execute(standing("cross", bench.joints, 0.1))
    place, turn = forward(get_chain(bench.arm), bench.joints)
    expected = plant.expected["a"]
    assert expected is not None
    assert np.abs(expected[:3] - place - turn @ [0, 0, 0.015]).max() < 1e-6
    bench.vacuum = False
    plant.execute(standing("release", bench.joints, 0.1))
    assert plant.held is None


def test_without_cameras_nothing_is_seen() -> None:
    bench = Bench()
    bench.cameras = CellCameras(bench.arm, ())
    bench.blocks["a"] = lying(0.0, 0.0, 0.0)
    plant = SeeingPlant(
        bench, bench.arm, (), bench.pictures, {"a": Sort(BRICK)}, {"a": bench.blocks["a"]}
    )
    assert plant.sense().blocks == ()
    # Pictures of cameras that the layout does not have, or of another size, say nothing.
    strange = replace(CORNER, name="strange")
    small = replace(CORNER, resolution=(64, 48))
    assert not views_of(seen_by((strange,), []), BOTH)
    assert not views_of(seen_by((small,), []), BOTH)


# Builds.

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
    # Nothing stands, so nothing is shown to.
    assert (plan.blocks.used, plan.steps, plan.as_planned) == (0, (), True)
    assert plan.assembly is not None
    assert plan.not_placed == len(plan.assembly.blocks)
    assert not plan.assembly.steps
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
