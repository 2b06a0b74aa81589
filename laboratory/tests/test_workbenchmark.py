"""WorkBenchMark: tasks are read, built and judged."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l2a_lab.workbenchmark import LAYER, MIDDLE, play, product_of, read_tasks, site_of
from learn2assemble.cell.carry_out import Workcell, prepare
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
    assert main(command) == 0
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert last["success"] == {"2": 1.0}
    assert last["tasks"] == 1
    assert last["state"] == "known"
    assert json.loads(out.read_text())["configuration"]["physics"] == "kinematic"
    assert main([*command, "--resume", "--only", "2"]) == 0
    assert main([*command, "--only", "5"]) == 2


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
