"""What a person needs to run a program: where blocks lie, who refills, what things are called, and
how fast it goes."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from arm_record import arm_record
from cell_shapes import wall
from learn2assemble.acting.carry_out import Workcell, carry_out
from learn2assemble.cli import main
from learn2assemble.errors import InputError
from learn2assemble.export.place_words import in_base, place_rows, plain, preparation
from learn2assemble.export.robot_programs import export_program, read_program, replay_program
from learn2assemble.export.urscript import planned_frame, write_urscript
from learn2assemble.geometry.rotations import quaternion_product, yaw_quaternion
from learn2assemble.kinematics.chain import forward_many, get_chain
from learn2assemble.motion.driver import arm_of
from learn2assemble.motion.files import read_record, record_data, record_from, write_record
from learn2assemble.motion.places import Supply, half_turn, put_turn, ranges, step_numbers, supplied
from learn2assemble.motion.program import Program, make_program
from learn2assemble.motion.record import BuildRecord, ByHand
from learn2assemble.planning.plan import Plan
from learn2assemble.plants.settings import ProgramSettings
from learn2assemble.robot.arm import Arm
from test_robot_programs import UrScript, read_bag
from test_workcell import planned


@pytest.fixture(scope="module")
def built() -> Plan:
    """Six bricks of four kinds by the UR5e with its cup, out of magazines."""
    plan = carry_out(planned(wall(7, 1, 3)), Workcell("ur5e", "suction"))
    assert plan.complete, plan.reason
    return plan


@pytest.fixture(scope="module")
def record(built: Plan) -> BuildRecord:
    assert built.record is not None
    return built.record


@pytest.fixture(scope="module")
def made(record: BuildRecord) -> tuple[Program, Arm]:
    arm = arm_of(record.arm)
    return make_program(record, arm), arm


@pytest.fixture(scope="module")
def folder(built: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("build")
    built.save(out)
    return out


@pytest.fixture(scope="module")
def script(record: BuildRecord, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("script")
    return export_program(record, "urscript", path).file.read_text(encoding="utf-8")


def about(script: str) -> str:
    """The comments that a program begins with, in one line each."""
    lines = script[: script.index("  global ")].splitlines()[1:]
    assert all(re.match(r"  #( |$)", line) for line in lines)
    return "\n".join(line[4:] for line in lines)


# ---------------------------------------------------------------- where blocks lie


def test_every_block_is_at_a_place(built: Plan, made: tuple[Program, Arm]) -> None:
    program, _ = made
    assert built.assembly is not None
    blocks = {block.id: block for block in built.assembly.blocks}
    found = [name for place in program.places for name in place.blocks]
    assert sorted(found) == sorted(blocks)
    assert len(program.places) > 1
    for place in program.places:
        for name, step in zip(place.blocks, place.steps, strict=True):
            block, told = blocks[name], built.steps[step - 1]
            assert built.assembly.blocks[told.block].id == name
            assert block.kind == place.kind
            assert np.allclose(sorted(np.ptp(block.vertices, axis=0)), sorted(place.size))
            assert place.mass == pytest.approx(block.mass, rel=1e-3)
            waits = built.blocks.waiting[told.block]
            assert np.allclose(waits, place.centre, atol=1e-3)
        assert place.refills == len(place.blocks) - place.at_start
    assert [place.at_start for place in program.places].count(True) == 1


def test_the_base_frame_is_that_of_the_controller(made: tuple[Program, Arm]) -> None:
    program, arm = made
    frame = planned_frame(arm)
    assert np.allclose(frame[3:5], 0)
    c, s = np.cos(frame[5]), np.sin(frame[5])
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    for place, base in zip(program.places, in_base(program, arm), strict=True):
        assert np.allclose(base.centre, frame[:3] + turn @ place.centre, atol=1e-6)
        assert half_turn(base.turn - frame[5] - place.turn) == pytest.approx(0, abs=1e-3)
        # The cup comes down on the middle of the block.
        assert base.tool is not None
        top = base.centre + np.array([0, 0, place.size[2] / 2])
        assert np.allclose(base.tool[:3], top, atol=2e-3)


def test_a_person_can_prepare_from_the_beginning_of_a_script(
    script: str, made: tuple[Program, Arm]
) -> None:
    program, arm = made
    told = about(script)
    assert script.isascii()
    for title in ("Frames", "Tool", "Blocks", "Places", "Order", "Start", "Speed"):
        assert re.search(rf"^{title}.*:$", told, re.M), title
    assert "base in the world: x 0.0, y -500.0, z 0.0, turned by -90.0" in told
    assert "middle of the design is at x -500.0, y 0.0, z 0.0" in told
    # The three ways in which files say how the arm stands.
    assert re.search(r"plan\.json, arm\.base, has 90\.0", told)
    assert re.search(r"trajectory\.json, base_yaw, has 0\.0", told)
    for place, base in zip(program.places, in_base(program, arm), strict=True):
        size = " x ".join(f"{1000 * v:.1f}" for v in place.size)
        assert re.search(rf"^  {place.kind} +{len(place.blocks)} +{size} +\d+ g$", told, re.M)
        part = told[told.index(f"place {place.number}:") :]
        x, y, z = np.round(1000 * base.centre, 1) + 0.0
        assert f"in the base:  x {x:.1f}, y {y:.1f}, z {z:.1f}, turn" in part
        x, y, z = np.round(1000 * place.centre, 1) + 0.0
        assert f"in the world: x {x:.1f}, y {y:.1f}, z {z:.1f}, turn" in part
    assert "one lies there at the start; REFILL" in told
    assert "empty at the start; REFILL" in told
    assert "l2a_factor = 0.25 of the planned speed" in told
    assert "within 2.9" in told


def test_places_of_blocks_without_a_kind_are_told_apart(record: BuildRecord) -> None:
    """Two shapes that both are called block are told by their size."""
    nameless = replace(record, kinds=("",) * len(record.kinds))
    arm = arm_of(record.arm)
    program = make_program(nameless, arm)
    rows = place_rows(program, arm)
    told = "\n".join(preparation(program, arm, ProgramSettings(), "hand", 1))
    for place, row in zip(program.places, rows, strict=True):
        size = " x ".join(f"{1000 * v:.1f}" for v in place.size)
        assert row[1] == f"block {size}"
        assert f"place {place.number}: {len(place.blocks)} of block {size}, step" in told
        assert f": block {size} from place {place.number}" in told
    assert len({row[1] for row in rows}) == len({tuple(place.size) for place in program.places})


def test_places_move_with_a_taught_work_plane(
    record: BuildRecord, made: tuple[Program, Arm], tmp_path: Path
) -> None:
    program, arm = made
    frame = planned_frame(arm) + np.array([0.02, -0.01, 0.004, 0, 0, 0.02])
    settings = ProgramSettings(base_frame=tuple(frame.tolist()))
    done = export_program(record, "urscript", tmp_path, layout=settings)
    told = about(done.file.read_text())
    assert "(as taught: l2a_frame)" in told
    assert "middle of the design is at x -480.0, y -10.0, z 4.0" in told
    for place, row in zip(program.places, done.rows, strict=True):
        c, s = np.cos(frame[5]), np.sin(frame[5])
        x, y = frame[:2] + np.array([[c, -s], [s, c]]) @ place.centre[:2]
        z = frame[2] + place.centre[2]
        assert row[5] == ", ".join(f"{v:.1f}" for v in np.round(1000 * np.array([x, y, z]), 1))
        assert f"in the base:  x {1000 * x:.1f}, y {1000 * y:.1f}, z {1000 * z:.1f}" in told


def test_blocks_on_places_of_their_own_need_no_refill(tmp_path: Path) -> None:
    record = arm_record("ur5e", 4, failures=False)
    done = export_program(record, "urscript", tmp_path)
    assert [place.refills for place in done.places] == [0] * len(record.steps)
    text = done.file.read_text()
    called = [line for lines in steps_of(text) for line in lines]
    assert not [line for line in called if line.startswith(("l2a_wait_for", "l2a_resumed"))]
    assert "nothing to refill" in about(text)
    assert "REFILL" not in text


def test_places_are_where_blocks_are_meant_to_wait_whatever_was_read(
    made: tuple[Program, Arm], tmp_path: Path
) -> None:
    """Readings that are off neither move a place nor turn it, and make no two of one."""
    workcell = Workcell("ur5e", "suction", noise=(5e-4, math.radians(0.2)))
    done = carry_out(planned(wall(7, 1, 3)), workcell)
    assert done.complete, done.reason
    assert done.record is not None
    write_record(done.record, tmp_path / "trajectory.json")
    record = read_record(tmp_path / "trajectory.json")
    exact, found = made[0].places, supplied(record).places
    assert [one.blocks for one in found] == [one.blocks for one in exact]
    for one, other in zip(found, exact, strict=True):
        assert np.abs(one.centre - other.centre).max() < 1e-4
        assert np.abs(one.size - other.size).max() < 1e-4
        assert one.turn == pytest.approx(other.turn, abs=1e-3)
    waits = [step.before[step.cells[0], :3] - np.array(step.source)[:3] for step in record.steps]
    assert 1e-5 < np.abs(waits).max() < 0.003  # Else nothing was tested.


def test_what_else_has_to_stand_there_is_told(tmp_path: Path) -> None:
    """What is in no place and stands from the start, and what hands set, with size and pose."""
    record = arm_record("ur5e", 4, failures=False)
    post = record.steps[0].before[0].round(6)
    names = tuple(f"n{k}" for k in range(record.num_cells))
    stands = replace(record, names=names, kinds=("k",) * record.num_cells)
    hands = (ByHand(1, (0,), "n0", True, 1.0, (tuple(post.tolist()),)),)
    below = np.where(np.arange(record.num_cells)[:, None] == 0, [0.0, 0.0, 1.0, *4 * [0.0]], 0.0)
    hidden = [replace(s, before=s.before - below, after=s.after - below) for s in record.steps]
    set_by_hand = replace(stands, steps=tuple(hidden), hands=hands)
    write_record(set_by_hand, tmp_path / "hand.json")
    assert read_record(tmp_path / "hand.json").hands == hands
    for made, title in ((stands, "Stands there from the start"), (set_by_hand, "Set by hand")):
        (found,) = supplied(made).stands
        assert (found.name, found.by_hand) == ("n0", made is set_by_hand)
        assert np.allclose(found.centre, post[:3], atol=2e-6)
        assert np.allclose(found.size, record.block_edge)
        done = export_program(made, "urscript", tmp_path / f"{found.by_hand}.script")
        told = about(done.file.read_text())
        edge, (x, y, z) = 1000 * record.block_edge, 1000 * post[:3] + 0.0
        assert f"{title}:\n  n0 (k): {edge:.1f} x {edge:.1f} x {edge:.1f} mm" in told
        assert f"in the world: x {x:.1f}, y {y:.1f}, z {z:.1f}, turn" in told.split(title)[1]
        assert done.stands.startswith("what else stands there: 1 ")
        head = export_program(made, "csv", tmp_path / f"{found.by_hand}.csv").file.read_text()
        (line,) = (one for one in head.splitlines() if one.startswith("# stands: "))
        (told_so,) = json.loads(line[10:])
        assert (told_so["name"], told_so["by_hand"]) == (found.name, found.by_hand)
        assert np.allclose(told_so["world"]["centre"], found.centre)


def test_sides_of_a_square_are_equal_as_far_as_they_are_told_apart() -> None:
    record = arm_record("ur5e", 2, failures=False)
    half = np.full((record.num_cells, 3), record.block_edge / 2)
    for wide, turn in ((2e-5, 0.0), (1e-3, np.pi / 2)):
        half[:, 1] = (record.block_edge + wide) / 2
        place = supplied(replace(record, half=half)).places[0]
        assert place.turn - half_turn(turn) == pytest.approx(0.0, abs=1e-3), wide


def test_a_block_that_was_tried_twice_is_one_block() -> None:
    """It is taken from its place, falls, and is taken from where it lies."""
    record = arm_record("ur5e", 6)
    told = supplied(record)
    blocks = [name for place in told.places for name in place.blocks]
    assert len(blocks) == len(set(blocks)) == 5
    tried = [k for k, pick in enumerate(told.picks) if pick is None]
    assert {record.steps[k].outcome.label for k in tried} == {"unreachable", "reached"}


def test_a_side_has_no_beginning() -> None:
    assert half_turn(np.pi) == pytest.approx(0)
    assert half_turn(-np.pi / 2) == pytest.approx(np.pi / 2)
    assert half_turn(np.pi / 2) == pytest.approx(np.pi / 2)
    assert ranges([1, 2, 3, 5, 6, 9]) == "1 to 3, 5, 6, 9"
    assert plain('a "b"\nü #4') == "a 'b' ? No 4"


def test_a_step_says_how_its_block_is_turned(record: BuildRecord, built: Plan, script: str) -> None:
    """By the long side, as places do: against the corners of the block in the plan."""
    assert built.assembly is not None
    blocks = {block.id: block for block in built.assembly.blocks}
    comments = [lines[0] for lines in steps_of(script)]
    for comment in comments:
        edges = np.ptp(blocks[comment.split()[1]].vertices, axis=0)
        turn = float(comment.split("turn ")[1].split()[0])
        assert turn == (90.0 if edges[1] > edges[0] + 1e-6 else 0.0), comment
    half = record.half
    assert half is not None
    step = max(record.steps, key=lambda one: float(np.ptp(half[one.cells[0]][:2])))
    before = put_turn(record, step)
    for angle in (np.pi / 6, -np.pi / 3):
        spin = yaw_quaternion(angle)
        target = np.concatenate([step.target[:3], quaternion_product(spin, step.target[3:])])
        turned = put_turn(record, replace(step, target=target))
        assert turned == pytest.approx(half_turn(before + angle), abs=1e-6)


# ---------------------------------------------------------------- who refills


def steps_of(script: str) -> list[list[str]]:
    """The lines of every step, its comment first."""
    return [[line.strip() for line in part.splitlines()] for part in script.split("  # step ")[1:]]


def asked_in(lines: list[str], call: str) -> list[int]:
    """Where a step asks for what comes after it: not for itself, where a program resumes."""
    return [
        k
        for k, line in enumerate(lines)
        if line.startswith(call) and not lines[k - 1].startswith("if (l2a_resume_from ==")
    ]


def test_the_program_asks_for_a_block_before_it_takes_it(
    script: str, made: tuple[Program, Arm]
) -> None:
    """On the way back from the step before, where the arm stands away from the place; whoever goes
    on from a step is asked before the arm is brought there."""
    program, arm = made
    parsed = UrScript(script)
    assert parsed.top["l2a_refill_by_hand"] == "True"
    assert {"l2a_wait_for_block", "l2a_wait_until_taken"} <= set(parsed.defined)
    waits, parts = 0, steps_of(script)
    for number, (step, lines) in enumerate(zip(program.steps, parts, strict=True)):
        assert step.pick is not None
        if not step.pick.refill:
            continue
        waits += 1
        place = program.places[step.pick.place - 1]
        wanted = f'{place.number}, "{place.kind}", "step {step.number}: '
        before = parts[number - 1]
        (asked,) = asked_in(before, "l2a_wait_for_block(")
        assert before[asked].startswith(f"l2a_wait_for_block({wanted}")
        opened = next(k for k, line in enumerate(before) if line.startswith("l2a_open("))
        assert opened < asked
        assert not any(", r=" in line for line in before[asked - 1 : asked])
        stood = [float(v) for v in before[asked - 1].split("[")[1].split("]")[0].split(",")]
        assert step.held is not None
        taken = program.knots.at(np.array([step.held[0]]))[0][0]
        tool, _ = forward_many(get_chain(arm), np.array([stood, taken]))
        far = np.linalg.norm(program.steps[number - 1].target[:2] - place.centre[:2])
        assert np.linalg.norm(tool[0] - tool[1]) > 0.9 * far, "as far as where the last one is"
        resumed = lines.index(f"if (l2a_resume_from == {step.number}):")
        assert lines[resumed + 1].startswith(f"l2a_wait_for_block({wanted}")
        assert lines[resumed + 2] == "end"
        assert lines[resumed + 3].startswith("l2a_start(")
    assert waits == len(program.steps) - 1 == sum(place.refills for place in program.places)
    body = script[script.index("def l2a_wait_for_block") :]
    assert "if (l2a_refill_by_hand):\n      popup(words" in body[: body.index("  end\n  end")]


def test_a_feeder_is_not_asked(record: BuildRecord, script: str, tmp_path: Path) -> None:
    text = export_program(record, "urscript", tmp_path, refill="feeder").file.read_text()
    assert UrScript(text).top["l2a_refill_by_hand"] == "False"
    assert "l2a_wait_for_block (as exported)" in about(text)
    # Everything else is the same: what a feeder says can be waited for where a person is asked.
    assert text.split("  # step ")[1:] == script.split("  # step ")[1:]


def test_what_a_magazine_takes_back_is_taken_away(
    made: tuple[Program, Arm], tmp_path: Path
) -> None:
    program, arm = made
    gone = np.array([[0.0, -0.2, -0.1, 1.0, 0, 0, 0]])
    for number in (1, len(program.steps)):
        step = program.steps[number - 1]
        blocks = program.blocks._replace(supply=(Supply(step.end, (0,), gone),))
        write_urscript(replace(program, blocks=blocks), arm, tmp_path / "back.script")
        text = (tmp_path / "back.script").read_text()
        UrScript(text)
        call = 'l2a_wait_until_taken("block-1", "take block-1'
        asked = [
            [k for k, line in enumerate(lines) if line.startswith(call)] for lines in steps_of(text)
        ]
        # In the step itself, where the arm is away; again for who goes on from the next one.
        assert len(asked[number - 1]) == 1
        lines, k = steps_of(text)[number - 1], asked[number - 1][0]
        moves = [line for line in lines[:k] if line.startswith("movej(")]
        assert step.held is not None
        put = program.knots.at(np.array([step.held[1]]))[0][0]
        stood = [float(v) for v in moves[-1].split("[")[1].split("]")[0].split(",")]
        tool, _ = forward_many(get_chain(arm), np.array([stood, put]))
        assert np.linalg.norm(tool[0] - tool[1]) > 0.05
        assert ", r=" not in moves[-1]
        if number < len(program.steps):
            assert len(asked[number]) == 1
            before = steps_of(text)[number][asked[number][0] - 1]
            assert before == f"if (l2a_resume_from == {program.steps[number].number}):"
        assert sum(map(len, asked)) == 1 + (number < len(program.steps))


def test_a_hand_is_asked_with_the_arm_away_after_a_step_that_failed(
    made: tuple[Program, Arm], tmp_path: Path
) -> None:
    """Nothing was let go in it: the arm is empty from its beginning, and stands right over the
    place at its end. Nor does it matter whether the block is gripped then."""
    program, arm = made
    number = next(
        k for k, s in enumerate(program.steps) if k and s.pick is not None and s.pick.refill
    )
    last, step = program.steps[number - 1 : number + 1]
    assert step.pick is not None
    place = program.places[step.pick.place - 1].centre

    def unloaded(begin: float, end: float) -> tuple[Any, ...]:
        return tuple(s._replace(load=0.0) if begin <= s.time < end else s for s in program.states)

    begin = program.steps[number - 2].end if number > 1 else 0.0
    missed = step._replace(held=None, reached=False, checks=())
    for failed, next_one, states in (
        (last._replace(held=None, reached=False), step, unloaded(begin, last.end)),
        (last._replace(reached=False), step, program.states),
        (last, missed, unloaded(last.end, step.end)),
    ):
        steps = (*program.steps[: number - 1], failed, next_one, *program.steps[number + 1 :])
        path = tmp_path / "failed.script"
        write_urscript(replace(program, steps=steps, states=states), arm, path)
        lines = steps_of(path.read_text())[number - 1]
        (asked,) = asked_in(lines, "l2a_wait_for_block(")
        moves = [line for line in lines[:asked] if line.startswith("movej(")]
        stood = [float(v) for v in moves[-1].split("[")[1].split("]")[0].split(",")]
        (tool,), _ = forward_many(get_chain(arm), np.array([stood]))
        assert np.linalg.norm(tool - place) > 0.15


@pytest.mark.parametrize("format", ["csv", "urscript", "ros2"])
def test_what_is_said_of_a_program_fits_a_terminal(
    format: str,
    folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """80 columns; only the names of files may stick out."""
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["export", str(folder), "--format", format, "--out", str(tmp_path)]) == 0
    if format == "csv":
        assert main(["replay-trajectory", str(tmp_path / "program.csv"), "--arm", "ur5e"]) == 0
    told = capsys.readouterr().out.splitlines()
    assert [line for line in told if len(line) > 80 and str(tmp_path) not in line] == []


# ---------------------------------------------------------------- what things are called


def test_steps_and_blocks_are_called_as_in_the_plan(
    built: Plan, record: BuildRecord, script: str, folder: Path, tmp_path: Path
) -> None:
    assert built.assembly is not None
    names = {s.step: built.assembly.blocks[s.block].id for s in built.steps}
    kinds = {s.step: s.kind for s in built.steps}
    assert set(names.values()) == {f"block-{k}" for k in range(1, len(names) + 1)}
    heads = [lines[0] for lines in steps_of(script)]
    for (step, name), head in zip(names.items(), heads, strict=True):
        assert head.startswith(f"{step}: {name} ({kinds[step]}) from place ")
    checks = {tuple(given) for call, given, _ in UrScript(script).calls if call == "l2a_check"}
    assert checks == {(step, f'"{name}"') for step, name in names.items()}
    table = export_program(record, "csv", tmp_path).file
    lines = table.read_text().splitlines()
    head = dict(line[2:].split(": ", 1) for line in lines if line.startswith("# "))
    told = {one["step"]: one["block"] for one in json.loads(head["steps"])}
    assert told == names
    body = [line.split(",") for line in lines if not line.startswith("#")]
    assert body[0][2:4] == ["step", "block"]
    assert {(int(row[2]), row[3]) for row in body[1:]} == set(names.items())
    places = json.loads(head["places"])
    assert [one["blocks"] for one in places] == [list(p.blocks) for p in supplied(record).places]
    assert {"centre", "turn", "tool"} == set(places[0]["base"])
    with read_bag(export_program(record, "ros2", tmp_path).file) as bag:
        wanted = [c for c in bag.connections if c.topic in ("/stage", "/check", "/program")]
        said = {c.topic: set[str]() for c in wanted}
        for connection, _, raw in bag.messages(wanted):
            said[connection.topic].add(bag.deserialize(raw, connection.msgtype).data)
    assert {f"step {step}, {name}: pick" for step, name in names.items()} <= said["/stage"]
    assert said["/check"] == set(names.values())
    assert json.loads(said["/program"].pop())["places"] == places
    page = (folder / "view.html").read_text()
    part = page[page.index('id="places-title"') : page.index('id="arm-title"')]
    for place in supplied(record).places:
        assert f"<td>{place.kind}</td>" in part
        assert f"<td>{place.step_words}</td>" in part
        assert f"<td>{place.refill_words}</td>" in part


def test_a_read_program_calls_its_blocks_the_same(record: BuildRecord, tmp_path: Path) -> None:
    for format in ("csv", "ros2"):
        file = export_program(record, format, tmp_path).file
        program, _ = read_program(file, "ur5e")
        assert [program.blocks.name(cell) for cell in range(2)] == ["block-1", "block-2"]
    done = replay_program(file, "ur5e")
    assert done.same
    assert done.names[0] == "block-1"
    nameless = export_program(replace(record, names=(), kinds=()), "csv", tmp_path / "a.csv").file
    assert read_program(nameless, "ur5e")[0].blocks.name(1) == "block 1"
    damaged = nameless.with_name("b.csv")
    damaged.write_text(nameless.read_text().replace('"start":', '"names": ["one"], "start":'))
    with pytest.raises(InputError, match="1 words for"):
        read_program(damaged, "ur5e")


def test_steps_of_a_person_keep_their_numbers(record: BuildRecord, tmp_path: Path) -> None:
    """A person sets something in step 2 of the plan: the steps of the arm are 1, 3, 4, ..."""
    numbers = [1, *range(3, len(record.steps) + 2)]
    pairs = list(zip(record.steps, numbers, strict=True))
    moved = replace(record, steps=tuple(replace(s, plan_step=n) for s, n in pairs))
    assert step_numbers(moved) == numbers
    text = export_program(moved, "urscript", tmp_path, resume_from=3).file.read_text()
    assert [int(lines[0].split(":")[0]) for lines in steps_of(text)] == numbers
    with pytest.raises(InputError, match=r"resume_from: got 2, .* of this arm, .*, as 1 or 3 or 4"):
        export_program(moved, "urscript", tmp_path, resume_from=2, overwrite=True)
    # Also a number that is set by hand to none of the steps of the arm begins with a check.
    assert "if (not l2a_started):" in text
    program = make_program(moved, arm_of(moved.arm))
    assert set(program.step.tolist()) == set(numbers)


def test_attempts_are_counted_where_some_failed(tmp_path: Path) -> None:
    record = arm_record("ur5e", 4)
    assert step_numbers(record) == [step.number for step in record.steps]
    text = export_program(record, "urscript", tmp_path).file.read_text()
    assert "Build again without failures" in about(text)
    heads = [lines[0] for lines in steps_of(text)]
    assert heads[2].startswith("3, an attempt at step 2 of the plan: block 2 from ")
    assert heads[1].endswith("(failed in the build)")


def test_a_record_keeps_what_its_blocks_are_called(
    record: BuildRecord, script: str, folder: Path
) -> None:
    assert record.names[:2] == ("block-1", "block-2")
    data = record_data(record)
    again = record_from(json.loads(json.dumps(data)))
    assert (again.names, again.kinds) == (record.names, record.kinds)
    assert read_record(folder / "trajectory.json").names == record.names
    # Files of before have no names: those of the assembly beside them are taken.
    del data["names"], data["kinds"]
    old = record_from(json.loads(json.dumps(data)))
    assert (old.names, old.kinds) == ((), ())
    with pytest.raises(InputError, match="one for each of"):
        record_from({**json.loads(json.dumps(data)), "names": ["one"]})
    with pytest.raises(InputError, match="not iterable"):
        record_from({**json.loads(json.dumps(data)), "names": 1})
    file = folder / "old" / "trajectory.json"
    file.parent.mkdir()
    file.write_text(json.dumps(data))
    (file.parent / "assembly.json").write_text((folder / "assembly.json").read_text())
    text = export_program(file, "urscript", file.parent).file.read_text()
    assert [lines[0] for lines in steps_of(text)] == [lines[0] for lines in steps_of(script)]


# ---------------------------------------------------------------- how fast it goes


def test_a_first_run_is_slow(record: BuildRecord, tmp_path: Path) -> None:
    layout = tmp_path / "cell.json"
    head = {"format": "learn2assemble-layout", "version": 2}
    layout.write_text(json.dumps({**head, "program": {"speed_factor": 0.4}}))
    for given, factor in (
        ({}, 0.25),
        ({"layout": layout}, 0.4),
        ({"speed": 1.0}, 1.0),
        ({"layout": layout, "speed": 0.05}, 0.05),
    ):
        done = export_program(record, "urscript", tmp_path, overwrite=True, **given)
        assert done.speed == factor
        text = done.file.read_text()
        assert UrScript(text).top["l2a_factor"] == f"{factor:g}"
        assert f"about {done.seconds / factor:.0f} s in all" in about(text)
    # Motions themselves are told as planned: the factor is at one place.
    assert export_program(record, "csv", tmp_path).seconds == done.seconds


def test_what_is_asked_of_no_script_is_refused(record: BuildRecord, tmp_path: Path) -> None:
    for given in ({"speed": 0.5}, {"refill": "hand"}):
        with pytest.raises(InputError, match="the format urscript"):
            export_program(record, "csv", tmp_path, **given)
    for speed in (0, 1.5, float("nan"), True, "fast"):
        with pytest.raises(InputError, match="speed"):
            export_program(record, "urscript", tmp_path, speed=speed)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="did you mean 'feeder'"):
        export_program(record, "urscript", tmp_path, refill="feader")
    assert not list(tmp_path.iterdir())


def test_the_command(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "gate.script"
    call = ["export", str(folder), "--format", "urscript", "--out", str(file)]
    assert main([*call, "--speed", "50%", "--refill", "feeder"]) == 0
    said = capsys.readouterr()
    assert "blocks are taken from" in said.out + said.err
    assert "to be: comments at the beginning\n" in said.out + said.err
    top = UrScript(file.read_text()).top
    assert (top["l2a_factor"], top["l2a_refill_by_hand"]) == ("0.5", "False")
    assert main([*call, "--overwrite", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["speed"] == 0.25
    assert [place["place"] for place in told["places"]] == [
        str(k) for k in range(1, len(told["places"]) + 1)
    ]
    assert main([*call[:3], "csv", *call[4:], "--refill", "hand"]) == 2
    assert main(["export", str(folder), "--format", "glb", "--speed", "0.5"]) == 2
    assert "--speed" in capsys.readouterr().err
