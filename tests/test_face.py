"""The public face: names, what importing costs, the registration of environments."""

from __future__ import annotations

import dataclasses
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import learn2assemble as l2a
from learn2assemble.errors import InputError
from learn2assemble.files import claim_folder
from learn2assemble.tasks.task import DESIGN_TASKS, GOAL_TASKS, HIDDEN_TASKS, PRESETS

ROOT = Path(__file__).resolve().parents[1]
HEAVY = {"torch", "numba", "mujoco", "gymnasium", "matplotlib", "rich", "scipy", "shapely"}


def python(code: str) -> str:
    """Standard output of a fresh interpreter."""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_public_name_is_there() -> None:
    assert sorted(l2a._PLACES) == list(l2a.__all__)
    for name in l2a.__all__:
        assert getattr(l2a, name).__doc__
    # Completion shows them and nothing else.
    assert [name for name in dir(l2a) if not name.startswith("_")] == l2a.__all__
    with pytest.raises(AttributeError, match="biuld"):
        l2a.biuld  # noqa: B018


@pytest.mark.parametrize(
    "code",
    [
        "import learn2assemble",
        "from learn2assemble.cli.parser import make_parser; make_parser().format_help()",
        "from learn2assemble.cli import main; assert main(['view', 'nosuch']) == 2",
        "from learn2assemble.cli import main; assert main(['build', 'no.json', '--out', 'o']) == 2",
    ],
    ids=["import", "help", "missing plan", "missing design"],
)
def test_what_should_be_quick_loads_nothing_heavy(code: str) -> None:
    """Instead of a timed assertion."""
    loaded = python(f"{code}\nimport sys\nprint(*sys.modules)").split()
    allowed = {"rich"} if "main" in code else set()
    assert not (HEAVY - allowed) & set(loaded)


_ALL = (*PRESETS, *DESIGN_TASKS, *GOAL_TASKS, *HIDDEN_TASKS)


def test_importing_patches_no_loader() -> None:
    """Gymnasium's own loading is left alone, and registers nothing by itself."""
    found = python(
        "import sys\nbefore = list(sys.meta_path), list(sys.path_hooks)\n"
        "import learn2assemble\nassert before == (sys.meta_path, sys.path_hooks)\n"
        "import gymnasium\n"
        "print([i for i in gymnasium.registry if i.startswith('learn2assemble/')])"
    )
    assert found == "[]\n"


@pytest.mark.parametrize(
    "order",
    [("gymnasium", "learn2assemble.envs"), ("learn2assemble.envs", "gymnasium")],
    ids="-".join,
)
def test_environments_are_registered_in_either_order(order: tuple[str, str]) -> None:
    found = python(
        f"import {order[0]}\nimport {order[1]}\nimport sys\n"
        "print('numba' in sys.modules)\n"
        "print(*[i for i in gymnasium.registry if i.startswith('learn2assemble/')], sep='\\n')"
    ).splitlines()
    assert found[0] == "False"
    assert found[1:] == [f"learn2assemble/{name}-v0" for name in _ALL]


def test_a_task_of_ones_own_is_known_everywhere() -> None:
    import gymnasium

    import learn2assemble.envs

    gymnasium.register_envs(learn2assemble.envs)
    task = PRESETS["two-sided-3x3-20-24"].replace(name="mine")
    try:
        assert l2a.register_task(task) is task
        assert l2a.get_task("mine") == task
        assert gymnasium.spec("learn2assemble/mine-v0").kwargs == {"task": "mine"}
        with pytest.raises(InputError, match="a name that is not taken"):
            l2a.register_task(task)
    finally:
        PRESETS._entries.pop("mine", None)
        gymnasium.registry.pop("learn2assemble/mine-v0", None)


def test_an_arm_of_ones_own_is_known_by_its_name(tmp_path: Path) -> None:
    from learn2assemble.robot.arm import get_arm
    from learn2assemble.robot.registry import ARMS

    with pytest.raises(InputError, match=r"arm\.toml"):
        l2a.register_arm("mine", tmp_path)
    try:
        l2a.register_arm("mine", ARMS["panda"].parent)
        assert get_arm("mine").joints == get_arm("panda").joints
        assert PRESETS["robot-two-sided-3x3-10-14"].replace(arm="mine").arm == "mine"
        with pytest.raises(InputError, match="not taken"):
            l2a.register_arm("mine", ARMS["panda"].parent)
    finally:
        ARMS._entries.pop("mine", None)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"design": "nosuch.json"}, "no such file"),
        ({"design": "two-sided-3x3-20-25"}, "did you mean"),
        ({"design": "two-sided-3x3-20-24", "arm": "pandas"}, "arm: got 'pandas'"),
        ({"design": "two-sided-3x3-20-24", "layout": "a.json"}, "layout: got"),
    ],
)
def test_what_cannot_be_built_is_refused_in_one_line(arguments: Any, words: str) -> None:
    with pytest.raises(InputError) as caught:
        l2a.build(**arguments)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_small_evaluation() -> None:
    how = {"search": "mcts", "budget": 2, "episodes": 2}
    result = l2a.evaluate("one-sided-3x3-22-24", agent="relational-cubes-s0", **how)
    assert (result.search, result.budget, result.metrics.episodes) == ("mcts", 2, 2)
    again = l2a.evaluate("one-sided-3x3-22-24", agent=l2a.load_agent("relational-cubes-s0"), **how)
    assert (again.metrics.R, again.metrics.a) == (result.metrics.R, result.metrics.a)
    json.dumps(result.to_dict())
    wrong: list[dict[str, Any]] = [
        {"episodes": 0},
        {"episodes": "5"},
        {"seed": 1.5},
        {"epsilon": 2.0},
        {"epsilon": "a"},
        {"search": "dfs"},
        {"agent": "nobody"},
        {"agent": ""},
        {"search": 5},
        {"physics": 5},
        {"progress": 5},
        {"budget": 10},
        {"rollout": 1},
        {"distinct": True},
        {"search_model": lambda model: model},
        {"episodes": 10**400},
        {"epsilon": 10**400},
    ]
    for arguments in wrong:
        with pytest.raises(InputError, match=rf"^{next(iter(arguments))}: got "):
            l2a.evaluate("one-sided-3x3-22-24", **arguments)
    for field in ({"budget": "a"}, {"budget": -1}, {"rollout": 0.5}, {"epsilon": math.nan}):
        with pytest.raises(InputError, match=rf"^{next(iter(field))}: got "):
            l2a.SearchConfig(**field)


def test_a_search_keeps_its_own_epsilon() -> None:
    how: dict[str, Any] = {"agent": "relational-cubes-s0", "episodes": 1}
    task, own = "one-sided-3x3-22-24", l2a.SearchConfig(budget=2, epsilon=0.0)
    assert l2a.evaluate(task, search=own, **how).epsilon == 0.0
    assert l2a.evaluate(task, search=own, epsilon=0.1, **how).epsilon == 0.1
    assert l2a.evaluate(task, search="mcts", budget=2, **how).epsilon == 0.05
    alone = l2a.evaluate(task, **how)
    assert alone.epsilon == 0.05
    assert math.isnan(alone.metrics.R_ci95)
    assert alone.to_dict()["R_ci95"] is None
    assert not alone.legacy


def test_own_cells_are_a_design() -> None:
    wanted = np.ones((4, 1, 2), bool)
    design = l2a.CellDesign("wall", wanted, (0.05, 0.05, 0.05))
    assert l2a.build(design, kit="cubes").status == "complete"
    for fields in (
        {"wanted": wanted[0]},
        {"wanted": wanted * 1.0},
        {"cell": (0.05, 0.05)},
        {"cell": 0.05},
    ):
        with pytest.raises(InputError, match=rf"^{next(iter(fields))}: got "):
            dataclasses.replace(design, **fields)


@pytest.mark.parametrize("name", ["register_search", "register_learner", "register_network"])
def test_only_what_can_be_used_is_registered(name: str) -> None:
    with pytest.raises(InputError, match="got 5"):
        getattr(l2a, name)("mine", 5)


def test_a_training_ends_with_what_comes_first(tmp_path: Path) -> None:
    settings = ["network.width=8", "num_envs=4"]
    how: dict[str, Any] = {"settings": settings, "quiet": True, "device": "cpu"}
    run = l2a.train("one-sided-3x3-22-24", tmp_path / "run", samples=60, minutes=5, **how)
    assert run.metrics["samples"] == 60


@pytest.mark.parametrize(
    "wrong",
    [
        {"seed": -1},
        {"seed": 1.5},
        {"threads": 0},
        {"threads": 10**6},
        {"minutes": 0},
        {"minutes": "a"},
        {"samples": 0},
    ],
)
def test_wrong_arguments_of_a_training(wrong: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(InputError, match=rf"^{next(iter(wrong))}: got "):
        l2a.train("one-sided-3x3-22-24", tmp_path / "run", **wrong)
    assert not (tmp_path / "run").exists()


def test_a_folder_is_written_by_one_process_at_a_time(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with claim_folder(out):
        with pytest.raises(InputError, match="nothing else is writing"), claim_folder(out):
            pass
        (out / "file").touch()
    assert [path.name for path in out.iterdir()] == ["file"]
    words = r"empty folder: name another one or empty this one$"
    with pytest.raises(InputError, match=words), claim_folder(out):
        pass
    words, go_on = r"one, empty this one or go on with `resume=`$", "go on with `resume=`"
    with pytest.raises(InputError, match=words), claim_folder(out, otherwise=go_on):
        pass
    with claim_folder(out, resume=True):
        pass
    with pytest.raises(ZeroDivisionError), claim_folder(tmp_path / "refused"):
        raise ZeroDivisionError
    assert not (tmp_path / "refused").exists()
