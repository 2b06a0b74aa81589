"""WorkBenchMark: tasks are read, built and judged; products of which all states are looked at."""

from __future__ import annotations

import gzip
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import learn2assemble as l2a
from l2a_lab.__main__ import command_line
from l2a_lab.press_orders import MOST_BRICKS, press_orders
from l2a_lab.workbenchmark import LAYER, MIDDLE, Brick, Task, play, product_of, read_tasks, site_of
from learn2assemble.acting.carry_out import Workcell, prepare
from learn2assemble.assembly.blocks import Assembly
from learn2assemble.cell.world import WorkcellBlocks
from learn2assemble.cli import main
from learn2assemble.errors import InputError
from learn2assemble.planning.brick_plan import plan_for_arm


def brick(name: str, x: float, y: float, layer: int, yaw: int = 0) -> dict[str, Any]:
    kind = "brick_" + name[:3]
    pos = [x, y, round(LAYER * layer, 4)]
    return {"name": name, "type": kind, "color": "red", "pos": pos, "rotation": [0, 0, yaw]}


STAIR = {
    "tier": 2,
    "task": 20,
    "blocks": [
        brick("4x2_a", 0.0, 0.148, 0),
        brick("2x2_b", -0.016, 0.148, 1),
        brick("2x2_c", 0.0, 0.148, 2, 90),
        brick("2x2_d", 0.016, 0.148, 3),
    ],
    "initial_blocks": [
        brick("2x2_d", 0.3762, -0.1131, 0),
        brick("2x2_c", 0.2581, -0.1189, 0),
        brick("2x2_b", 0.5011, -0.1243, 0),
        brick("4x2_a", 0.6163, -0.1278, 0),
    ],
}


def write(path: Path, *tasks: dict[str, Any]) -> Path:
    path.write_bytes(gzip.compress("".join(json.dumps(t) + "\n" for t in tasks).encode()))
    return path


def test_a_task_is_built_from_where_its_bricks_wait(tmp_path: Path) -> None:
    (task,) = read_tasks(write(tmp_path / "t.gz", STAIR)).values()
    product = product_of(task)
    low = np.array([block.vertices.min(0) for block in product.blocks])
    wanted = [[-0.032, 0.132, 0], [-0.032, 0.132, LAYER], [-0.016, 0.132, 2 * LAYER]]
    assert low[:3] == pytest.approx(np.array(wanted) + np.array((MIDDLE, 0, 0)), abs=1e-9)
    found = prepare(plan_for_arm(product), Workcell("panda", "gripper", site_of(task)), 0.0)
    waits = WorkcellBlocks(found.job).pose[:, :2]
    assert waits == pytest.approx(np.array([b.at[:2] for b in task.waiting]), abs=1e-9)
    plan, success = play(task, "kinematic")
    assert success
    assert plan.blocks.used == 4
    # Its last brick would tip the one below it: both are pressed together beside, and brought.
    assert [step.way for step in plan.steps].count("beside") == 2


def test_bricks_that_wait_only_roughly_where_they_should_are_seen(tmp_path: Path) -> None:
    """Two bricks of the stair; they wait elsewhere by up to a stud, so that a grasp by what the
    task says misses or pushes them."""
    names = ("4x2_a", "2x2_b")
    few = {
        key: [b for b in STAIR[key] if b["name"] in names] for key in ("blocks", "initial_blocks")
    }
    (task,) = read_tasks(write(tmp_path / "t.gz", STAIR | few)).values()
    plan, success = play(task, "dynamic", "sensed")
    assert success
    assert plan.arm is not None
    assert plan.arm.error_worst < 1e-3
    assert plan.arm.belief_error is not None
    assert 0 < plan.arm.belief_error < 2e-3


def test_the_command_prints_the_shares(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, out = write(tmp_path / "t.gz", STAIR), tmp_path / "out.json"
    command = ["workbenchmark", "--tasks", str(file), "--out", str(out), "--json"]
    assert main(command, command_line()) == 0
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert last["success"] == {"2": 1.0}
    assert last["tasks"] == 1
    assert last["state"] == "known"
    assert json.loads(out.read_text())["configuration"]["physics"] == "kinematic"
    assert main([*command, "--resume", "--only", "2"], command_line()) == 0
    assert main([*command, "--only", "5"], command_line()) == 2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"blocks": [brick("2x2_b", 0, 0, 0)]}, "each of which waits"),
        ({"initial_blocks": 3}, "a list of bricks"),
        ({"tier": "one"}, "tier"),
        ({"blocks": [{**brick("2x2_b", 0, 0, 0), "type": "brick_2x3"}]}, "brick_2x2"),
        ({"blocks": [{**brick("2x2_b", 0, 0, 0), "pos": [0, 0]}]}, "three numbers"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        read_tasks(write(tmp_path / "t.gz", {**STAIR, **change}))


def test_a_turned_brick_is_refused(tmp_path: Path) -> None:
    turned = {**STAIR, "blocks": [{**b, "rotation": [0, 0, 30]} for b in STAIR["blocks"]]}
    with pytest.raises(InputError, match="multiple of 90"):
        product_of(next(iter(read_tasks(write(tmp_path / "t.gz", turned)).values())))


# States of bricks that clutch, all of them looked at. Products are those of the fourth tier
# (CC BY 4.0).

# Extents [studs], the middle [half studs], and the layer of every brick.
PRODUCTS = {
    5: (
        *("22 -4 24 0", "22 -4 20 0", "22 -8 20 0", "42 -6 22 1", "22 -4 26 1", "42 -6 18 1"),
        *("42 -6 22 2", "24 -6 16 2", "22 -6 26 2", "24 -6 20 3", "42 -6 26 3"),
    ),
    48: (
        *("22 4 24 0", "22 8 26 0", "42 14 26 0", "24 10 26 1", "24 6 26 1", "24 16 26 1"),
        *("42 10 26 2", "42 10 26 3", "22 8 30 2"),
    ),
    66: (
        *("22 4 20 0", "22 8 20 0", "22 8 16 0", "22 6 18 1", "42 6 18 2", "22 6 18 3"),
        *("22 8 22 1", "22 10 18 1", "24 8 24 2", "24 6 24 3", "22 6 22 4"),
    ),
}
HALF = 0.008
"""Half a stud [m]."""


def product(*lines: str) -> Assembly:
    made = []
    for n, line in enumerate(lines):
        size, x, y, layer = line.split()
        kind = "brick_2x2" if size == "22" else "brick_4x2"
        at = int(x) * HALF, int(y) * HALF, int(layer) * LAYER
        made.append(Brick(f"b{n}", kind, "red", at, 90.0 if size == "24" else 0.0))
    return product_of(Task(4, 0, tuple(made), tuple(made)))


@pytest.mark.parametrize("number", [5, 66])
def test_two_products_are_built_of_parts_that_have_parts(number: int) -> None:
    found = press_orders(product(*PRODUCTS[number]))
    assert not found.alone
    assert not found.beside
    assert found.within
    assert found.states > 1


@pytest.mark.parametrize("physics", ["kinematic", "dynamic"])
def test_an_arm_builds_parts_of_parts(physics: str) -> None:
    """Which are no steps of a plan, but moves of the arm."""
    made = product(*PRODUCTS[5])
    done = l2a.build(made, arm="panda", physics=physics)
    assert done.complete, done.reason
    assert done.arm is not None
    assert done.arm.attempts >= len(made.blocks) + 2
    assert sum(step.way == "beside" for step in done.steps) >= 3


def test_the_presses_are_what_forbids_an_order() -> None:
    """The same product is built where it is put together without force."""
    made = product(*PRODUCTS[66])
    assert press_orders(replace(made, joint=replace(made.joint, press=0.0))).beside


def test_a_product_that_takes_parts_built_beside_has_no_order_of_single_bricks() -> None:
    found = press_orders(product(*PRODUCTS[48]))
    assert not found.alone
    assert found.beside


def test_a_tower_has_an_order_of_single_bricks() -> None:
    found = press_orders(product("22 0 0 0", "22 0 0 1", "22 0 0 2"))
    assert found.alone
    assert found.beside
    assert found.states == 4


def test_what_falls_has_no_order() -> None:
    """Bricks that reach out one stud each, without the strength to."""
    lines = [f"22 {2 * k} 0 {k}" for k in range(6)]
    made = product(*lines)
    assert not press_orders(replace(made, joint=replace(made.joint, capacity=0.0))).within


def test_many_bricks_are_refused() -> None:
    lines = [f"22 0 0 {k}" for k in range(MOST_BRICKS + 1)]
    with pytest.raises(InputError, match="all states are looked at"):
        press_orders(product(*lines))
