"""Agreement with the recorded transitions of the published simulator, and refusal of bad logs.

The faults of its search, which restored worlds otherwise than they were.
"""

from __future__ import annotations

import gzip
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l2a_lab.recordings import VARIANTS, drifted, fit_tilt, read_lines
from l2a_lab.replay import ReplayReport, replay_file
from l2a_lab.restore_faults import LegacyModel
from learn2assemble.constants import EDGE
from learn2assemble.errors import InputError
from learn2assemble.tasks.graph.features import node_offset
from learn2assemble.tasks.learning.config import CONFIGS, fit_to
from learn2assemble.tasks.networks.agent import make_network
from learn2assemble.tasks.physics.rigid import RigidPhysics
from learn2assemble.tasks.search.config import SearchConfig
from learn2assemble.tasks.search.mcts import search
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import get_task
from learn2assemble.tasks.world.blocks import DIRECTIONS
from learn2assemble.tasks.world.state import State
from learn2assemble.tasks.world_model import WorldModel
from learning_data import look_ahead
from make_recordings import REFERENCE, SAMPLE, sample_files, sample_lines, unpack
from test_search import TINY, walls

MIXED = ["2wo_g3_n30", "2wo_g4_n40", "2wo_g5_n50", "4wo_g3_n30", "4wo_g5_n50", "1mimic_g3_n27"]
SUPPORTED = ["2wo_g5_n50_supported", "4wo_g5_n50_supported"]
_REPORTS: dict[str, ReplayReport] = {}


def report_of(reference: Path, name: str) -> ReplayReport:
    """The report of one recorded file under both physics; replayed once a session."""
    if name not in _REPORTS:
        _REPORTS[name] = replay_file(reference / f"transitions_{name}.jsonl.gz", RigidPhysics)
    return _REPORTS[name]


def lines_of(reference: Path, name: str) -> list[dict[str, Any]]:
    return list(read_lines(reference / f"transitions_{name}.jsonl.gz"))


# ---------------------------------------------------------------- agreement


@pytest.mark.parametrize("name", MIXED + SUPPORTED)
def test_every_file_agrees(reference: Path, name: str) -> None:
    report = report_of(reference, name)
    lines = lines_of(reference, name)
    assert report.lines == len(lines) > 100
    assert report.real_lines == sum(line["kind"] == "real" for line in lines) > 100
    assert report.views > 4 * report.tilted_views or name in SUPPORTED
    assert report.mask_exact >= 0.999
    assert report.plane_exact >= 0.99
    assert report.complete_exact >= 0.99
    assert report.max_px_diff <= 1
    assert report.masks_within_rounding <= 2
    if name in MIXED:
        assert report.valid_static >= 0.99
        assert report.valid_rigid is not None
        assert report.valid_rigid >= 0.99


def test_all_mixed_logs_together(reference: Path) -> None:
    reports = [report_of(reference, name) for name in MIXED]

    def mean(field: str, weight: str = "lines") -> float:
        weights = [getattr(r, weight) for r in reports]
        return float(np.average([getattr(r, field) for r in reports], weights=weights))

    assert mean("valid_static") >= 0.995
    assert mean("valid_rigid") >= 0.995
    assert mean("reward", "real_lines") >= 0.995
    assert mean("done", "real_lines") >= 0.995


# ---------------------------------------------------------------- where they differ


def is_supported(cell: np.ndarray, placed: np.ndarray) -> bool:
    """On the table, or on a block that is straight below up to what the logs drift."""
    if cell[2] < 0.03:
        return True
    above = np.abs(placed[:, :2] - cell[:2]).max(1, initial=0) < 0.02
    return bool((above & (np.abs(cell[2] - placed[:, 2] - EDGE) < 0.01)).any())


def stuck(line: dict[str, Any]) -> bool:
    """A block set in mid-air against a neighbour that the published engine left hanging there."""
    placed, after = np.array(line["placed"]), np.array(line["placed_after"])
    cell = placed[line["ref"]] + EDGE * DIRECTIONS[line["u"][2]]
    beside = np.abs(np.abs(placed - cell).sum(1) - EDGE) < 0.005
    level = np.abs(placed[:, 2] - cell[2]) < 0.005
    stayed = np.abs(after - cell).max(1).min() < 1e-3
    return bool(
        not line["invalid"] and not is_supported(cell, placed) and (beside & level).any() and stayed
    )


def holds_stuck_block(line: dict[str, Any]) -> bool:
    """The state before the step contains a block in mid-air."""
    placed = np.array(line["placed"])
    return any(not is_supported(block, np.delete(placed, k, 0)) for k, block in enumerate(placed))


@pytest.mark.parametrize("name", MIXED)
def test_only_blocks_stuck_in_mid_air_differ(reference: Path, name: str) -> None:
    lines = lines_of(reference, name)
    for note in report_of(reference, name).disagreements:
        line = lines[note["line"] - 1]
        assert (line["ep"], line["t"]) == (note["ep"], note["t"])
        assert stuck(line) or holds_stuck_block(line), note


@pytest.mark.parametrize("name", SUPPORTED)
def test_supported_placements_are_valid_in_both_physics(reference: Path, name: str) -> None:
    """We differ exactly where jitter broke the published threshold on the sum of speeds."""
    lines = lines_of(reference, name)
    failed = {number for number, line in enumerate(lines, 1) if line["invalid"]}
    assert failed
    assert all(1.0 < lines[number - 1]["accv"] < 1.5 for number in failed)
    for physics in ("static", "rigid"):
        notes = report_of(reference, name).disagreements
        assert {n["line"] for n in notes if n["physics"] == physics} == failed


# ---------------------------------------------------------------- objects of several cells

OBJECTS = {
    # Least agreement in validity: static, rigid.
    "1wo_g5_n30": (0.96, 0.98),
    "2more20_g5_n30": (0.99, 0.99),
    "2more20_g6_n40": (0.97, 0.95),
}
"""The rest are steps at which something balances exactly on an edge. There the log itself is not
of one mind: the same bar at the same place holds in one line and falls in another."""


@pytest.mark.parametrize("name", OBJECTS)
def test_logs_of_objects_agree(reference: Path, name: str) -> None:
    report = report_of(reference, name)
    lines = lines_of(reference, name)
    assert report.lines == len(lines)
    assert report.judged_lines == report.real_lines
    assert report.real_lines == sum(line["kind"] == "real" for line in lines) > 100
    assert report.mask_exact == 1.0
    assert report.plane_exact >= 0.99
    assert report.complete_exact >= 0.99
    assert report.max_px_diff <= 1
    assert report.views > 2 * report.tilted_views
    static, rigid = OBJECTS[name]
    assert report.valid_static >= static
    assert report.valid_rigid is not None
    assert report.valid_rigid >= rigid
    # Reward and end follow the verdict, but for single pixels where recorded blocks had drifted.
    assert report.done == report.valid_static
    assert report.reward >= report.valid_static - 0.025


@pytest.mark.parametrize("name", OBJECTS)
def test_objects_differ_only_by_chance_or_where_blocks_got_stuck(
    reference: Path, name: str
) -> None:
    report = report_of(reference, name)
    assert report.edge_lines < 0.25 * report.judged_lines
    assert report.valid_static_firm >= 0.99
    assert report.valid_rigid_firm is not None
    assert report.valid_rigid_firm >= 0.985
    for note in report.disagreements:
        assert note["why"] == "edge" or (note["why"] == "stuck" and not note["recorded_invalid"])


def test_the_same_balance_was_recorded_to_hold_and_to_fall(reference: Path) -> None:
    """What no rule of geometry can tell: a bar put on one cube of two, half of it overhanging."""
    found = set()
    for name in ("1wo_g5_n30", "2more20_g5_n30"):
        for line in lines_of(reference, name):
            alone = line["kind"] == "real" and line["t"] == 0 and len(line["placed"]) == 1
            relation = line["u"][2] // (4 if name.startswith("2more") else 1)
            bar = len(line["members"]) == 2 and line["tilt_after"] > 1e-3
            if alone and bar and relation == 0:
                found.add(line["invalid"])
    assert found == {True, False}


def test_sample_of_objects_agrees(data: Path) -> None:
    path = data / "transitions_objects.jsonl"
    report = replay_file(path, RigidPhysics)
    lines = list(read_lines(path))
    assert {line["variant"] for line in lines} == {"1wo", "2more20"}
    assert max(len(line["members"]) for line in lines) >= 3
    assert report.real_lines == report.judged_lines == len(lines)
    assert report.mask_exact == report.complete_exact == 1.0
    assert report.valid_static_firm == report.valid_rigid_firm == 1.0
    assert all(note["why"] == "edge" for note in report.disagreements)


def test_objects_need_all_earlier_steps(tmp_path: Path, data: Path) -> None:
    lines = list(read_lines(data / "transitions_objects.jsonl"))
    second = next(line for line in lines if line["t"] == 1)
    first = next(
        x for x in lines if (x["variant"], x["ep"], x["t"]) == (second["variant"], second["ep"], 0)
    )
    assert replay_file(_write(tmp_path, first, second)).lines == 2
    with pytest.raises(InputError, match="lacks a step before 1"):
        replay_file(_write(tmp_path, second))
    with pytest.raises(InputError, match="members"):
        replay_file(_write(tmp_path, {k: v for k, v in first.items() if k != "members"}, second))
    with pytest.raises(InputError, match="lacks cells"):
        replay_file(_write(tmp_path, {**first, "unplaced": [*first["unplaced"], [0, 0, 0, 0, 1]]}))
    with pytest.raises(InputError, match="blocks placed"):
        replay_file(_write(tmp_path, {**first, "members": [0] * 9}, second))


def test_the_tilt_of_an_object_is_read_from_its_cells() -> None:
    cells = EDGE * np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1]], float)
    assert fit_tilt(cells) == pytest.approx([1, 0, 0, 0])
    assert fit_tilt(cells[:1]) == pytest.approx([1, 0, 0, 0])
    for axis, angle in ((0, 0.02), (1, -0.03), (2, 0.01)):
        c, s = np.cos(angle), np.sin(angle)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(3)
        turn[i, i], turn[i, j], turn[j, i], turn[j, j] = c, -s, s, c
        expected = np.zeros(4)
        expected[0], expected[1 + axis] = np.cos(angle / 2), np.sin(angle / 2)
        assert fit_tilt(cells @ turn.T) == pytest.approx(expected, abs=1e-6)


# ---------------------------------------------------------------- the project's own samples


def test_the_recordings_here_are_a_part_of_all(tmp_path: Path) -> None:
    """Every kind is there, at most 2 MB together, and no line says anything else."""
    unpack(tmp_path)
    files = sample_files(tmp_path)
    assert len(files) == 27
    assert SAMPLE.stat().st_size < 2e6
    if not REFERENCE.is_dir():
        pytest.skip("all the recordings (../shared/reference) are absent: nothing to compare with")
    assert [file.name for file in files] == [file.name for file in sample_files(REFERENCE)]
    for file in files:
        assert list(read_lines(file)) == list(sample_lines(REFERENCE / file.name))


def test_sample_agrees(data: Path) -> None:
    path = data / "transitions_sample.jsonl"
    report = replay_file(path, RigidPhysics)
    lines = list(read_lines(path))
    assert {line["variant"] for line in lines} == {"1mimic", "2wo", "4wo"}
    assert {line["kind"] for line in lines} == {"real", "probe"}
    assert report.lines == len(lines)
    assert report.views > 200
    assert (report.mask_exact, report.plane_exact, report.complete_exact) == (1.0, 1.0, 1.0)
    differ = [lines[note["line"] - 1] for note in report.disagreements]
    assert {(line["ep"], line["t"]) for line in differ} == {(58, 9), (58, 10)}
    assert all(stuck(line) or holds_stuck_block(line) for line in differ)
    assert stuck(differ[0])
    wrong = sum(line["kind"] == "real" for line in {line["t"]: line for line in differ}.values())
    assert report.reward == report.done == 1 - wrong / report.real_lines


def test_a_changed_record_is_noticed(data: Path, tmp_path: Path) -> None:
    """The comparison is with the file: what is falsified there shows in the report."""
    line = next(x for x in read_lines(data / "transitions_sample.jsonl") if x["kind"] == "real")

    def report(**changes: Any) -> ReplayReport:
        return replay_file(_write(tmp_path, {**line, **changes}))

    honest = report()
    assert (honest.valid_static, honest.reward, honest.done) == (1.0, 1.0, 1.0)
    assert not honest.disagreements
    assert report(invalid=not line["invalid"]).valid_static == 0.0
    assert report(invalid=not line["invalid"]).disagreements
    assert report(reward=line["reward"] + 1).reward == 0.0
    assert report(done=not line["done"]).done == 0.0
    assert report(mask_px=[n + 1 for n in line["mask_px"]]).mask_exact == 0.0
    for name in ("plane", "comp"):
        key = f"px_{name}_after"
        changed = report(**{key: [n + 2 for n in line[key]]})
        assert (changed.plane_exact, changed.complete_exact) == (
            (0.5, 1.0) if name == "plane" else (1.0, 0.5)
        )
        assert changed.max_px_diff == 2
    assert report(tilt_after=0.1).tilted_views == len(line["targets"])


# ---------------------------------------------------------------- bad files


def _write(folder: Path, *lines: Any) -> Path:
    path = folder / "log.jsonl"
    path.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
    return path


@pytest.fixture
def line(data: Path) -> dict[str, Any]:
    """A real line that replays."""
    return next(x for x in read_lines(data / "transitions_sample.jsonl") if x["kind"] == "real")


def test_missing_file(tmp_path: Path) -> None:
    for path in (tmp_path / "none.jsonl", tmp_path):
        with pytest.raises(InputError, match=r"(no such file|plain file).*recording"):
            replay_file(path)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.jsonl", b"{"),
        ("a.jsonl", b"[1, 2]\n"),
        ("a.jsonl", b"3\n"),
        ("a.jsonl", b"\xff\xfe"),
        ("a.jsonl", b"{}\n"),
        ("a.jsonl", b"\n"),
        ("a.jsonl.gz", b"{}\n"),
        ("a.jsonl.gz", gzip.compress(b"{}" * 500, mtime=0)[:-9]),
    ],
)
def test_files_that_are_not_logs(tmp_path: Path, name: str, content: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError, match="line") as caught:
        replay_file(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("variant", ["3wo", "3robo", "2robomost", "", None, 2])
def test_another_variant_is_refused(tmp_path: Path, line: dict[str, Any], variant: Any) -> None:
    with pytest.raises(InputError, match=r"variant: got .*1mimic, 2wo, 4wo"):
        replay_file(_write(tmp_path, {**line, "variant": variant}))


def test_a_probe_needs_its_real_line(tmp_path: Path, data: Path) -> None:
    probe = next(x for x in read_lines(data / "transitions_sample.jsonl") if x["kind"] == "probe")
    with pytest.raises(InputError, match="a step with a real line"):
        replay_file(_write(tmp_path, probe))


USED = [
    "variant",
    "ep",
    "t",
    "targets",
    "mask_px",
    "unplaced",
    "u",
    "ref",
    "blk",
    "placed",
    "placed_after",
    "px_init",
    "px_plane_before",
    "px_comp_before",
    "px_plane_after",
    "px_comp_after",
    "tilt_after",
    "reward",
    "done",
    "invalid",
    "accv",
    "accv_obj",
]


@pytest.mark.parametrize("field", USED)
def test_a_missing_field_is_named(tmp_path: Path, line: dict[str, Any], field: str) -> None:
    del line[field]
    with pytest.raises(InputError, match=field):
        replay_file(_write(tmp_path, line))


@pytest.mark.parametrize(
    "change",
    [
        {"variant": ["2wo"]},
        {"ep": [1]},
        {"u": [1]},
        {"u": "abc"},
        {"ref": "a"},
        {"ref": 1.5},
        {"targets": []},
        {"targets": [[]]},
        {"targets": 5},
        {"targets": [[[0.0, 0.0]]]},
        {"placed": []},
        {"placed": "x"},
        {"placed": [[0.0, 0.0]]},
        {"placed_after": None},
        {"tilt_after": None},
        {"px_init": None},
        {"unplaced": None},
    ],
    ids=str,
)
def test_a_field_of_another_kind_is_refused(
    tmp_path: Path, line: dict[str, Any], change: dict[str, Any]
) -> None:
    with pytest.raises(InputError):
        replay_file(_write(tmp_path, {**line, **change}))


OUT_OF_RANGE: list[Callable[[dict[str, Any]], dict[str, Any]]] = [
    lambda line: {"ref": len(line["placed"])},
    lambda line: {"ref": -1},
    lambda line: {"blk": len(line["unplaced"])},
    lambda line: {"blk": 1000},
    lambda line: {"blk": -2},
    lambda line: {"unplaced": []},
    lambda line: {"u": [*line["u"][:2], 5]},
    lambda line: {"u": [*line["u"][:2], -1]},
]


def test_indices_out_of_range_are_refused(tmp_path: Path, line: dict[str, Any]) -> None:
    """In a process of its own: what is not refused may overwrite memory."""
    paths = []
    for number, change in enumerate(OUT_OF_RANGE):
        folder = tmp_path / str(number)
        folder.mkdir()
        paths.append(str(_write(folder, {**line, **change(line)})))
    script = (
        "import sys; from pathlib import Path; from learn2assemble.errors import InputError\n"
        "from l2a_lab.replay import replay_file\n"
        "for path in sys.argv[1:]:\n"
        "    try: replay_file(Path(path))\n"
        "    except InputError: pass\n"
        "    else: sys.exit(path)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, *paths], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


# Steps of the published robot cell: masks, pixels, rewards, ends. What fails there fails by the
# arm. What the arm could do is compared with static physics, which has no arm: blocks appear at
# their places.

FILES = {
    # Lines, lines at which the arm did not fail, blocks that fell, least share of exact views.
    "1robo_g3_n20": (37, 27, 0, 0.89),
    "2robo_g3_n20": (63, 41, 0, 0.93),
    "2robo_g3_n20_b": (70, 58, 1, 0.95),
    "2robo_g5_n24_b": (113, 78, 0, 0.88),
    "4robo_g3_n30": (36, 27, 2, 1.0),
    "2robomore_g5_n30": (42, 14, 1, 0.97),
}


@pytest.mark.parametrize("name", FILES)
def test_masks_pixels_rewards_and_ends(reference: Path, name: str) -> None:
    """Blocks stand some tenths of a millimetre beside the lattice, turned by an angle the logs do
    not hold, so a pixel at an edge may differ: one a view at most."""
    report, (lines, valid, fell, exact) = report_of(reference, name), FILES[name]
    assert (report.lines, report.judged_lines, report.real_lines) == (lines, valid, valid)
    assert report.mask_exact == 1.0
    assert report.masks_within_rounding == 0
    assert min(report.plane_exact, report.complete_exact) >= exact
    assert report.max_px_diff <= 1
    assert report.views > 3 * report.tilted_views
    assert report.valid_rigid is None
    assert [note["why"] for note in report.disagreements] == fell * ["fell"]
    assert report.valid_static == 1 - fell / valid
    # One structure of objects that was pushed, two with a pixel more; one end by 0.2 % of cover.
    unsure = {"2robomore_g5_n30": (3, 0), "2robo_g5_n24_b": (0, 1)}.get(name, (0, 0))
    assert report.reward == pytest.approx(1 - (fell + unsure[0]) / valid)
    assert report.done == pytest.approx(1 - (fell + unsure[1]) / valid)


@pytest.mark.parametrize("name", FILES)
def test_before_the_first_step_all_pixels_agree(reference: Path, name: str, tmp_path: Path) -> None:
    """Where no arm has moved anything yet: the camera, the table and the first block alone."""
    lines = [line for line in lines_of(reference, name) if line["t"] == 0]
    path = tmp_path / "log.jsonl"
    for line in lines:
        # Of a step that failed, only what was before it is compared.
        failed = {**line, "invalid": True}
        path.write_text(json.dumps(failed), encoding="utf-8")
        report = replay_file(path)
        assert (report.plane_exact, report.complete_exact, report.judged_lines) == (1.0, 1.0, 0)
        assert report.views == len(line["targets"])
        assert report.tilted_views == 0


def test_what_fell_was_dropped_in_mid_air(reference: Path) -> None:
    """A robot may set an object on nothing, or on too little to hold it: it drops by one level, and
    only the *other* blocks must stay."""
    fell = 0
    for name in FILES:
        lines = lines_of(reference, name)
        for note in report_of(reference, name).disagreements:
            line = lines[note["line"] - 1]
            new = np.array(line["placed_after"])[len(line["placed"]) :]
            level = line["placed"][line["ref"]][2] + EDGE * (line["place_dir"] == 0)
            assert new[:, 2].min() == pytest.approx(level - EDGE, abs=2e-3)
            assert line["max_xy_move_placed"] < 0.01
            fell += 1
    assert fell == 4


def test_commands_are_those_of_the_log(reference: Path) -> None:
    """Direction and grip are k div 4 and k mod 4, with one side k; the lattice is the task's."""
    for name in FILES:
        task = get_task(VARIANTS[name.split("_")[0]])
        for line in lines_of(reference, name):
            relation, way = divmod(line["u"][2], task.rotations)
            assert (relation, way) == (line["place_dir"], line["grasp_variant"])
            if relation:
                step = np.array(line["cand"]) - line["placed"][line["ref"]]
                assert step == pytest.approx(task.pitch * DIRECTIONS[relation], abs=2e-6)


def test_robot_sample_agrees(data: Path) -> None:
    path = data / "transitions_robot.jsonl"
    report, lines = replay_file(path, RigidPhysics), list(read_lines(path))
    assert {line["variant"] for line in lines} == {"1robo", "2robo", "4robo", "2robomore"}
    assert {line["invalid"] for line in lines} == {True, False}
    assert report.lines == len(lines)
    assert report.judged_lines == sum(not line["invalid"] for line in lines)
    assert report.mask_exact == report.plane_exact == report.complete_exact == 1.0
    assert report.tilted_views == 0
    assert [note["why"] for note in report.disagreements] == ["fell"]
    wrong = 1 / report.judged_lines
    assert report.reward == report.done == report.valid_static == pytest.approx(1 - wrong)


def test_a_changed_record_of_a_robot_is_noticed(data: Path, tmp_path: Path) -> None:
    lines = list(read_lines(data / "transitions_robot.jsonl"))
    line = next(x for x in lines if x["variant"] == "2robo" and not x["invalid"])
    path = tmp_path / "log.jsonl"

    def report(**changes: Any) -> ReplayReport:
        path.write_text(json.dumps({**line, **changes}), encoding="utf-8")
        return replay_file(path)

    assert (report().reward, report().done, report().plane_exact) == (1.0, 1.0, 1.0)
    assert report(reward=line["reward"] + 1).reward == 0.0
    assert report(done=not line["done"]).done == 0.0
    assert report(px_plane_after=[n + 1 for n in line["px_plane_after"]]).plane_exact == 0.5
    assert report(px_comp_before=[n + 1 for n in line["px_comp_before"]]).complete_exact == 0.5
    assert report(mask_px=[n + 1 for n in line["mask_px"]]).mask_exact == 0.0
    pushed = [[x + 1e-3, y, z] for x, y, z in line["placed_after"]]
    assert report(placed_after=pushed).tilted_views == len(line["targets"])
    for field in ("invalid", "placed_after", "px_plane_after", "u", "reward"):
        path.write_text(json.dumps({k: v for k, v in line.items() if k != field}), encoding="utf-8")
        with pytest.raises(InputError, match=field):
            replay_file(path)
    several = next(x for x in lines if x["variant"] == "2robomore")
    path.write_text(json.dumps({**several, "unplaced_info": None}), encoding="utf-8")
    with pytest.raises(InputError, match="line 1"):
        replay_file(path)


def test_pushed_structures_are_told_by_their_places() -> None:
    rows = [[0.0, 0.06, 0.025], [0.0605, 0.0593, 0.025]]
    assert not drifted(rows, 0.06)
    assert drifted([*rows, [0.0609, 0.06, 0.075]], 0.06)
    assert drifted(rows, 0.055)


# ---------------------------------------------------------------- restore faults


def valid_with_most(model: WorldModel, state: State, worth: str | None) -> np.ndarray:
    """Of the valid placements the one with the largest field of the outcomes, or the last."""
    placements, outcomes = look_ahead(model.simulator, state)
    number = np.broadcast_to(np.arange(outcomes.valid.shape[1]), outcomes.valid.shape)
    value = getattr(outcomes, worth) if worth else number
    chosen = np.where(outcomes.valid, value, -9.0).argmax(1)
    action = placements.action[np.arange(len(chosen)), chosen]
    return action - node_offset(model.simulator.observe(state))


def test_legacy_takes_the_initial_cover_from_the_restored_state() -> None:
    """Fault (a): scaled rewards grow by (A - c0) / (A - c_root), and it is harder
    to fill the target; only the first step of a walk restores."""
    task = TINY.replace(num_sides=2, num_nodes=20, grid=3, reward="scaled", max_initial_cover=1.0)
    model, state = walls(task)
    legacy = LegacyModel(model, np.random.default_rng(0))
    before = state.copy()
    actions = valid_with_most(model, state, None)
    exact, faulty = model.step(state, actions), legacy.step(state, actions)
    for mine, theirs in zip(state, before, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    copies = faulty.states.state
    np.testing.assert_array_equal(copies.initial_pixels, state.plane_pixels)
    np.testing.assert_allclose(copies.position, exact.states.position, atol=1e-6)
    # Fault (d): single precision moves edges that lie on a pixel's border.
    same = copies.plane_pixels == exact.states.plane_pixels
    assert same.mean() > 0.9
    assert abs(copies.plane_pixels - exact.states.plane_pixels).max() <= 2
    open_now = state.mask_pixels - state.plane_pixels
    factor = (state.mask_pixels - state.initial_pixels) / open_now
    going = same & ~exact.terminal & ~faulty.terminal
    np.testing.assert_allclose(faulty.reward[going], (exact.reward * factor)[going])
    assert (exact.reward[going] > 0).any()
    assert (factor > 1.1).any()
    assert not (faulty.terminal & ~exact.terminal).any()
    again = legacy.step(faulty.states, np.zeros((len(actions), 3), np.int64))
    np.testing.assert_array_equal(again.states.state.initial_pixels, state.plane_pixels)


def test_legacy_ends_later() -> None:
    """Fault (a): the block that fills the target is not enough in the copy.

    F counts from what is covered at the root, so it falls wherever that is more than at the start.
    """
    task = TINY.replace(num_sides=1, num_nodes=14, success_threshold=0.6, max_initial_cover=1.0)
    model, state = walls(task, 300, 1)
    state = state.take(np.flatnonzero(state.plane_pixels > state.initial_pixels))
    actions = valid_with_most(model, state, "gain")
    exact = model.step(state, actions)
    faulty = LegacyModel(model, np.random.default_rng(0)).step(state, actions)
    assert (exact.terminal & ~faulty.terminal).any()
    assert not (~exact.terminal & faulty.terminal).any()


def test_legacy_simulates_another_problem_where_much_is_covered() -> None:
    """Fault (b): another random problem each time; the rest is as it was."""
    task = TINY.replace(num_sides=2, num_nodes=20, grid=3)
    model, state = walls(task)
    share = state.plane_pixels / state.mask_pixels
    model.simulator.task = task.replace(max_initial_cover=float(np.median(share)))
    covered = share > np.median(share)
    legacy = LegacyModel(model, np.random.default_rng(0))
    # The last of all actions: its node numbers must be clipped to the other problem.
    actions = np.stack([state.num_unplaced - 1, state.num_placed - 1, 0 * state.num_placed], -1)
    exact = model.step(state, actions).states
    runs = [legacy.step(state, actions).states for _ in range(2)]
    for copies in runs:
        assert not copies.real.any()
        differs = (copies.state.mask != exact.mask).any((1, 2, 3))
        np.testing.assert_array_equal(differs, covered)
        assert (copies.state.num_placed[covered] == 2).all()
        np.testing.assert_allclose(
            copies.state.position[~covered], exact.position[~covered], atol=1e-6
        )
    assert (runs[0].state.mask[covered] != runs[1].state.mask[covered]).any()


def test_legacy_takes_objects_apart() -> None:
    """Fault (c): an S that stands falls in the copy, and only chains stay whole."""
    task = TINY.replace(objects="set-26", num_nodes=20, stability="object")
    model, _ = walls(task, 1)
    state = model.simulator.new(2, np.random.default_rng(0))
    # A cube on the ground; beside it an S with its free end in the air, in the second row a tower.
    cube, s_shape = (0, 0, 0), ((1, 0, 0), (1, 0, 1), (2, 0, 1))
    tower = ((1, 0, 0), (1, 0, 1), (1, 0, 2))
    waiting = ((0, -5, 0), (1, -5, 0), (2, -5, 0), (4, -5, 0), (3, -5, 0), (5, -5, 0))
    for row, shape in enumerate((s_shape, tower)):
        cells = np.array([cube, *shape, *waiting], float) * 0.05 + [0, 0, 0.025]
        state.position[row, :10] = cells
        state.object_id[row, :10] = [0, 1, 1, 1, 2, 2, 2, 3, 3, 3]
        state.num_placed[row], state.num_blocks[row] = 4, 10
    actions = np.array([[0, 0, 3], [0, 0, 3]])
    exact = model.step(state, actions)
    faulty = LegacyModel(model, np.random.default_rng(0)).step(state, actions)
    assert (exact.reward >= 0).all()
    assert faulty.reward.tolist()[0] == -1
    assert faulty.terminal[0]
    assert faulty.reward[1] >= 0
    ids = faulty.states.state.object_id[1, :10].tolist()
    assert len(set(ids[:4])) == 4  # nothing placed is joined any more
    # The chain of three was placed whole; of the bar listed middle first only a pair is left.
    assert [ids[k] == ids[k + 1] for k in range(4, 9)] == [True, True, False, True, False]
    # What is further down a walk is not rebuilt again.
    again = LegacyModel(model, np.random.default_rng(0)).step(faulty.states, actions)
    assert again.states.state.object_id[1, 7] == faulty.states.state.object_id[1, 7]


def test_legacy_search_plays() -> None:
    """A search over it keeps the world; without the faults' conditions it is the exact search."""
    task = TINY.replace(num_sides=2, num_nodes=20, grid=3)
    model, state = walls(task, 8)
    fresh = model.simulator.new(8, np.random.default_rng(3))
    config = SearchConfig(budget=12, epsilon=0.0, expansion="uct", widening=0.5, rollout=2)
    for worlds, same in ((fresh, True), (state, False)):
        before = worlds.copy()
        legacy = LegacyModel(model, np.random.default_rng(0))
        faulty = search(legacy, worlds, config, np.random.default_rng(0))
        exact = search(model, worlds, config, np.random.default_rng(0))
        for mine, theirs in zip(worlds, before, strict=True):
            np.testing.assert_array_equal(mine, theirs)
        if same:
            assert [d.action.tolist() for d in faulty] == [d.action.tolist() for d in exact]


def test_the_legacy_search_keeps_a_cover_that_was_never_normalised() -> None:
    task = get_task("robot-two-sided-3x3-10-14").replace(arm="none")
    sim = Simulator(task)
    state = sim.new(20, np.random.default_rng(2))
    network = make_network(fit_to(CONFIGS["published"], task).network)
    legacy = LegacyModel(WorldModel(sim, network), np.random.default_rng(0))
    actions = np.tile([0, 0, 0], (20, 1))
    after = legacy.step(state, actions).states.state
    assert (after.initial_pixels == 0).all()
