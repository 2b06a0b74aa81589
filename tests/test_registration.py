"""What code outside the package adds by name: a search, a learner, a network, a set of objects."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

import learn2assemble as l2a
from learn2assemble.cli.parser import COMMANDS, Command, CommandLine, make_parser
from learn2assemble.errors import InputError, UnknownNameError, check_name
from learn2assemble.registry import Registry, add_plugin
from learn2assemble.tasks.evaluation.episodes import make_policy, run_episodes
from learn2assemble.tasks.graph.batch import GraphTensors
from learn2assemble.tasks.graph.features import NUM_FEATURES
from learn2assemble.tasks.learning.config import METHODS, Learner, TrainConfig, register_learner
from learn2assemble.tasks.learning.run import run_training
from learn2assemble.tasks.learning.trainer import Trainer, q_loss
from learn2assemble.tasks.networks.agent import load_agent
from learn2assemble.tasks.networks.config import NETWORKS, NetworkConfig, register_network
from learn2assemble.tasks.networks.qnetwork import QFactors
from learn2assemble.tasks.search.config import SEARCHES, SearchConfig, register_search
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import Task, register_task
from learn2assemble.tasks.world.blocks import (
    OBJECT_SETS,
    SHAPES,
    Shape,
    inventory,
    register_object_set,
)
from learning_data import QUICK, TINY

ROOT = Path(__file__).resolve().parents[1]
DATA, ASSETS = ROOT / "tests" / "data", ROOT / "src" / "learn2assemble" / "assets"
TABLES: tuple[Registry, ...] = (SEARCHES, METHODS, NETWORKS, OBJECT_SETS)


@pytest.fixture(autouse=True)
def tables() -> Iterator[None]:
    """Every test leaves the tables as they were."""
    before, shapes = [dict(table) for table in TABLES], dict(SHAPES)
    yield
    for table, entries in zip(TABLES, before, strict=True):
        table._entries.clear()
        table._entries.update(entries)
    SHAPES.clear()
    SHAPES.update(shapes)
    inventory.cache_clear()


class PerNode(nn.Module):
    """A Q-network that looks at every node alone."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.block = nn.Linear(NUM_FEATURES, config.num_actions)
        self.reference = nn.Linear(NUM_FEATURES, config.num_actions)

    def forward(self, graph: GraphTensors) -> QFactors:
        context = graph.nodes.new_zeros(len(graph.nodes), self.config.num_actions)
        return QFactors(self.block(graph.nodes), self.reference(graph.nodes), context)


def test_a_network_of_ones_own_is_trained_saved_and_plays(tmp_path: Path) -> None:
    register_network("per-node", PerNode)
    config = dataclasses.replace(QUICK, network=NetworkConfig(encoder="per-node"))
    metrics = run_training(TINY, config, tmp_path / "run", device="cpu", quiet=True)
    assert metrics["updates"] > 10
    agent = load_agent(str(tmp_path / "run"))
    assert isinstance(agent.network, PerNode)
    for search in (None, SearchConfig(budget=2)):
        assert run_episodes(TINY, make_policy(TINY, agent.network, search, 0.0), 4, 0).episodes == 4
    with pytest.raises(InputError, match="dense_weight"):
        dataclasses.replace(config, augment=False, dense_weight=1.0)


def test_a_learner_of_ones_own_chooses_search_and_loss() -> None:
    budgets, losses = [], []

    def search(budget: int, epsilon: float) -> SearchConfig:
        budgets.append(budget)
        return SearchConfig(budget=budget, epsilon=epsilon, expansion="uct")

    def loss(*arguments: object) -> tuple[torch.Tensor, dict[str, float]]:
        value, logs = q_loss(*arguments)  # pyright: ignore[reportArgumentType]
        losses.append(float(value.detach()))
        return 2 * value, {**logs, "mine": 1.0}

    register_learner("mine", Learner(search, loss))
    config = dataclasses.replace(QUICK, method="mine", search_budget=3)
    assert TrainConfig.from_dict(config.to_dict()) == config
    trainer = Trainer(TINY, config, 0)
    while not trainer.updates:
        trainer.round()
    assert set(budgets) == {3}
    assert len(losses) == trainer.updates
    assert trainer.metrics()["batch_mine"] == 1.0
    assert trainer.replay.arrays["searched.count"].max() == 3


def test_a_search_of_ones_own_has_a_name() -> None:
    mine = SearchConfig(budget=7, widening=0.5)
    register_search("mine", mine)
    assert SEARCHES["mine"] == mine


def test_objects_of_ones_own_are_drawn_and_built() -> None:
    bent = Shape(((0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1)), turned=True)
    register_object_set("bent", (("cube",), ("bent", "vertical-2")), {"bent": bent})
    task = Task(
        "mine",
        num_sides=2,
        grid=4,
        num_nodes=30,
        objects="bent",
        rotations=4,
        layout="narrow-field",
        stability="object",
    )
    simulator, rng = Simulator(task), np.random.default_rng(0)
    state = simulator.new(64, rng)
    sizes = {int((row == number).sum()) for row in state.object_id for number in row}
    assert sizes == {1, 2, 4}
    counts = np.stack([state.num_unplaced, state.num_placed, np.full(64, task.num_actions)], -1)
    simulator.step(state, (rng.random((64, 3)) * counts).astype(np.int64))
    assert (state.num_placed >= 1).all()


BAD: dict[str, tuple[Callable[[], None], str]] = {
    "taken search": (lambda: register_search("uct", SearchConfig()), "uct"),
    "taken learner": (lambda: register_learner("dqn", Learner()), "dqn"),
    "taken network": (lambda: register_network("s2v", PerNode), "s2v"),
    "taken set": (lambda: register_object_set("cubes", (("cube",),)), "cubes"),
    "no name": (lambda: register_search("", SearchConfig()), "a word"),
    "unknown shape": (lambda: register_object_set("a", (("cube",), ("cub",))), "did you mean"),
    "no cube": (lambda: register_object_set("a", (("bar",),)), "the cube first"),
    "no groups": (lambda: register_object_set("a", ()), "the cube first"),
    "taken shape": (
        lambda: register_object_set("a", (("cube",),), {"bar": Shape(((0, 0, 0),))}),
        "bar",
    ),
    "in pieces": (
        lambda: register_object_set("a", (("cube",),), {"b": Shape(((0, 0, 0), (2, 0, 0)))}),
        "hang together",
    ),
    "too large": (
        lambda: register_object_set(
            "a", (("cube",),), {"b": Shape(tuple((k, 0, 0) for k in range(5)))}
        ),
        "1 to 4",
    ),
    "in the air": (
        lambda: register_object_set("a", (("cube",),), {"b": Shape(((0, 0, 1),))}),
        "height 0",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_refused(name: str) -> None:
    call, words = BAD[name]
    before, shapes = [dict(table) for table in TABLES], dict(SHAPES)
    with pytest.raises(InputError, match=words):
        call()
    assert [dict(table) for table in TABLES] == before
    assert shapes == SHAPES


def test_what_is_not_registered_is_unknown() -> None:
    for make in (
        lambda: NetworkConfig(encoder="per-node"),
        lambda: TrainConfig(method="mine"),
        lambda: SEARCHES["mine"],
        lambda: inventory("bent"),
        lambda: Task("t", num_sides=1, grid=3, num_nodes=20, objects="bent"),
    ):
        with pytest.raises(UnknownNameError):
            make()


@pytest.mark.parametrize("task", [None, "tower", 3, []])
def test_what_is_no_task_is_not_registered(task: Any):
    with pytest.raises(InputError, match="a Task"):
        register_task(task)


@pytest.mark.parametrize("name", ["a/b", "../up", "", " ", "a b", "-x", "x" * 200, None, 3, []])
def test_a_registered_name_is_a_plain_word(name: Any):
    with pytest.raises(InputError):
        register_search(name, SearchConfig(budget=4))


NONSENSE = ("3", 3.5, None, [], 10**9, -1, float("nan"), float("inf"), 10**400, object(), {})
"""Names of tests hold no address of an object: processes that share them out compare names."""


def named(value: Any) -> str:
    return "object" if type(value) is object else repr(value)


@pytest.mark.parametrize("field", [field.name for field in dataclasses.fields(Task)])
@pytest.mark.parametrize("value", NONSENSE, ids=named)
def test_a_task_of_nonsense_is_bad_input(field: str, value: Any):
    task: dict[str, Any] = {"name": "x", "num_sides": 2, "grid": 3, "num_nodes": 30}
    if field == "name" and isinstance(value, str):
        return
    with pytest.raises(InputError):
        Task(**{**task, field: value})


@pytest.mark.parametrize("wrong", [{"search": "mcts"}, {"search": SearchConfig()}, {"loss": 3}])
def test_a_learner_is_made_of_functions(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        register_learner("mine", Learner(**wrong))
    assert "mine" not in METHODS


NOT_NAMES = ("", "a/b", " x", "x\n", "..", "-x", None, 3, b"x", [])
REGISTER: dict[str, Callable[[Any], Any]] = {
    "task": lambda name: register_task(Task(name, num_sides=2, grid=4, num_nodes=30)),
    "arm": lambda name: l2a.register_arm(name, ASSETS / "arms" / "panda"),
    "tool": lambda name: l2a.register_tool(name, ASSETS / "tools" / "suction"),
    "network": lambda name: register_network(name, PerNode),
    "learner": lambda name: register_learner(name, Learner()),
    "search": lambda name: register_search(name, SearchConfig()),
    "objects": lambda name: register_object_set(name, [["cube"]]),
    "shape": lambda name: register_object_set("a", [["cube"]], {name: Shape(((0, 0, 0),))}),
}


@pytest.mark.parametrize("kind", REGISTER)
@pytest.mark.parametrize("name", NOT_NAMES, ids=repr)
def test_what_is_no_plain_word_names_nothing(kind: str, name: Any) -> None:
    if not isinstance(name, list) or kind != "shape":  # A list is no key of a dict.
        with pytest.raises(InputError):
            REGISTER[kind](name)


@pytest.mark.parametrize("value", [None, 3, "", "nosuch", b"x", object(), float("nan"), "\0"])
def test_what_is_no_value_is_not_registered(value: Any, tmp_path: Path) -> None:
    calls: tuple[Callable[[], Any], ...] = (
        lambda: register_task(value),
        lambda: l2a.register_arm("m", value),
        lambda: l2a.register_tool("m", value),
        lambda: register_network("m", value),
        lambda: register_learner("m", value),
        lambda: register_search("m", value),
        lambda: register_object_set("m", value),
        lambda: register_object_set("m", [value]),
        lambda: register_object_set("m", [[value]]),
        lambda: register_object_set("m", [["cube"]], value or 3),
        lambda: register_object_set("m", [["cube"]], {"m": value}),
        lambda: register_object_set("m", [["cube"]], {"m": Shape(value)}),
        lambda: register_object_set("m", [["cube"]], {"m": Shape(((str(value), 0, 0),))}),
    )
    before = [dict(table) for table in TABLES]
    for call in calls:
        with pytest.raises(InputError):
            call()
    assert [dict(table) for table in TABLES] == before


@pytest.mark.parametrize("kind", [TrainConfig, NetworkConfig, SearchConfig])
def test_a_configuration_of_nonsense_is_bad_input(kind: Any) -> None:
    for field in dataclasses.fields(kind):
        for value in (None, b"x", [], object(), "nosuch", float("nan"), 2.5, {}):
            if value == 2.5 and field.type == "float":
                continue
            with pytest.raises(InputError):
                kind(**{field.name: value})


@pytest.mark.parametrize("value", [None, 3, "", b"x", [], object(), "a\0b"], ids=named)
def test_what_is_no_name_of_a_file_is_bad_input(value: Any, tmp_path: Path) -> None:
    plan = l2a.load_plan(DATA / "example_plan")
    for call in (
        l2a.load_design,
        l2a.load_goals,
        l2a.load_plan,
        l2a.load_agent,
        l2a.read_assembly,
        plan.save,
        lambda value: l2a.replay_program(value, "panda"),
        lambda value: l2a.export_assembly(tmp_path, "glb", value),
        lambda value: l2a.train("one-sided-3x3-22-24", out=value),
    ):
        with pytest.raises(InputError):
            call(value)


@pytest.mark.parametrize("name", [[], {}, None, 3])
def test_what_is_no_name_is_unknown(name: Any, tmp_path: Path) -> None:
    for call in (
        l2a.get_task,
        l2a.Simulator,
        l2a.AssemblyEnv,
        l2a.get_arm,
        lambda name: l2a.evaluate(name, episodes=1),
        lambda name: l2a.export_assembly(tmp_path, name, tmp_path / "x"),
        lambda name: l2a.export_program(tmp_path, name, tmp_path / "x"),
    ):
        with pytest.raises(InputError):
            call(name)


@pytest.mark.parametrize(
    "wrong",
    [
        {"config": 3},
        {"config": None},
        {"resume": 3},
        {"init": 3},
        {"init": []},
        {"settings": None},
        {"settings": "network.heads=1"},
        {"settings": [3]},
    ],
    ids=repr,
)
def test_a_training_of_nonsense_is_bad_input(wrong: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(InputError):
        l2a.train("one-sided-3x3-22-24", out=tmp_path / "run", **{"samples": 8, **wrong})
    assert not list(tmp_path.iterdir())


def test_blocks_and_worlds_of_nonsense_are_bad_input() -> None:
    wrong: Any
    for wrong in (None, 3, "x", [3], float("nan")):
        for call in (
            l2a.Assembly,
            lambda wrong: l2a.Block("a", np.eye(4)[:, :3], wrong),
            lambda wrong: l2a.Block(wrong, np.eye(4)[:, :3], ((0, 1, 2),)),
            lambda wrong: l2a.AssemblyVectorEnv("one-sided-3x3-22-24", wrong if wrong != 3 else 0),
        ):
            with pytest.raises(InputError):
                call(wrong)


def test_names_of_a_distribution_that_is_missing_are_said_to_be_elsewhere(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Without the laboratory, its planner and its commands are no misspelt names of others."""
    table: Registry[int] = Registry("missing thing", {"here": 1})
    add_plugin("no_such_distribution.things", "missing thing", optional=True)
    with pytest.raises(UnknownNameError, match=r"one of here.* \(a checkout of the source"):
        _ = table["there"]
    with pytest.raises(UnknownNameError, match="with its laboratory, has more"):
        check_name("missing thing", "there", table)
    commands: Registry[Command] = Registry("missing command", dict(COMMANDS))
    add_plugin("no_such_distribution.commands", "missing command", optional=True)
    with pytest.raises(SystemExit):
        make_parser(["tabel"], CommandLine("l2a", "", "", commands)).parse_args(["tabel"])
    assert "with its laboratory, has more" in capsys.readouterr().err
