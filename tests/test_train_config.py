"""Training configurations: schedules, overrides, what is refused."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
import torch

from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.tasks.graph.batch import to_tensors
from learn2assemble.tasks.graph.features import node_offset
from learn2assemble.tasks.learning.config import CONFIGS, TrainConfig, fit_to, override
from learn2assemble.tasks.learning.run import choose_device, train
from learn2assemble.tasks.learning.trainer import Trainer, epsilon_greedy
from learn2assemble.tasks.networks.config import NetworkConfig
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import get_task
from learn2assemble.tasks.world_model import WorldModel
from learning_data import RELATIONAL, SMALL, TINY, network


@pytest.mark.parametrize("config", [SMALL, RELATIONAL], ids=lambda c: c.encoder)
def test_epsilon_greedy_rate_and_legality(config: NetworkConfig) -> None:
    simulator = Simulator(TINY)
    state = simulator.new(2000, np.random.default_rng(0))
    graph = simulator.observe(state)
    net = network(0, config)
    model = WorldModel(simulator, net)
    local = epsilon_greedy(model, state, 0.3, np.random.default_rng(1))
    again = np.random.default_rng(1)
    model.random_actions(state, again)
    greedy = again.random(len(local)) >= 0.3
    assert greedy.mean() == pytest.approx(0.7, abs=0.04)
    tensors = to_tensors(graph)
    with torch.inference_mode():
        best = net(tensors).best(tensors)[1].numpy() - node_offset(graph)
    np.testing.assert_array_equal(local[greedy], best[greedy])
    unplaced = graph.num_nodes - graph.num_targets - graph.num_placed
    assert (local >= 0).all()
    assert (local[:, 0] < unplaced).all()
    assert (local[:, 1] < graph.num_placed).all()
    counts = np.bincount(local[~greedy, 2], minlength=5)
    assert (np.abs(counts - counts.mean()) < 5 * math.sqrt(counts.mean())).all()


def test_schedules() -> None:
    """Epsilon linear in the samples, then constant; cosine learning rate."""
    config = TrainConfig(
        network=SMALL,
        epsilon_final=0.1,
        epsilon_samples=1000,
        num_samples=2000,
        learning_rate=1e-3,
        final_learning_rate=1e-4,
        num_envs=2,
        replay_size=10,
    )
    trainer = Trainer(TINY, config, 0)
    for samples, epsilon, rate in (
        (0, 1.0, 1e-3),
        (500, 0.55, None),
        (1000, 0.1, 5.5e-4),
        (2000, 0.1, 1e-4),
        (3000, 0.1, 1e-4),
    ):
        trainer.samples = samples
        assert trainer.epsilon == pytest.approx(epsilon)
        if rate is not None:
            assert trainer.learning_rate == pytest.approx(rate)
    assert trainer.finished


def test_target_network_follows() -> None:
    """A hard copy every ``target_period`` updates."""
    config = TrainConfig(
        network=SMALL,
        num_envs=4,
        replay_size=100,
        target_period=3,
        batch_size=4,
        learning_rate=1e-2,
    )
    trainer = Trainer(TINY, config, 0)
    for _ in range(4):
        trainer.collect()
    expected = [p.detach().clone() for p in trainer.target.parameters()]
    for number in range(1, 7):
        trainer.update()
        online = [p.detach() for p in trainer.online.parameters()]
        if number % 3 == 0:
            expected = [o.clone() for o in online]
        for mine, theirs in zip(trainer.target.parameters(), expected, strict=True):
            torch.testing.assert_close(mine.detach(), theirs)


def test_start_from_another_network() -> None:
    """Both networks take over the weights; another architecture is refused."""
    trainer = Trainer(TINY, TrainConfig(network=SMALL, num_envs=2, replay_size=10), 0)
    given_network = network(9)
    trainer.start_from(given_network)
    for mine in (trainer.online, trainer.target):
        for a, b in zip(mine.parameters(), given_network.parameters(), strict=True):
            assert torch.equal(a, b)
            assert a is not b
    with pytest.raises(InputError, match="init: got"):
        trainer.start_from(network(9, RELATIONAL))


# Configurations.


def test_configurations_survive_json() -> None:
    for config in CONFIGS.values():
        assert TrainConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config
    assert CONFIGS["paper"].batch_size == 32
    assert CONFIGS["paper"].target_period == 1250


def test_override() -> None:
    config = override(
        CONFIGS["published"],
        [
            "learning_rate=3e-4",
            "network.heads=1",
            "augment=FALSE",
            "network.connectivity=full",
            "num_envs=7",
        ],
    )
    assert config.learning_rate == 3e-4
    assert config.network.heads == 1
    assert config.augment is False
    assert config.network.connectivity == "full"
    assert config.num_envs == 7
    assert CONFIGS["published"].network.heads != 1, "the table is not changed"


BAD_SETTINGS = [
    ("learning_rate", "KEY=VALUE"),
    ("lerning_rate=1", "did you mean 'learning_rate'"),
    ("network.head=1", "did you mean 'heads'"),
    ("net.heads=1", "expected one of"),
    ("learning_rate=fast", "a value like"),
    ("learning_rate=nan", "a rate between 0 and 1"),
    ("learning_rate=-1", "a rate between 0 and 1"),
    ("num_envs=2.5", "a value like"),
    ("num_envs=0", "a whole number from 1 to"),
    ("augment=maybe", "a value like"),
    ("epsilon_final=2", "epsilon_final"),
    ("epsilon_final=nan", "epsilon_final"),
    ("search_weight=-0.1", "a share"),
    ("dense_weight=-1", "at least 0"),
    ("dense_weight=1", "0 unless encoder is relational"),
    ("network.encoder=relational", "augment"),
    ("network.encoder=relationl", "did you mean 'relational'"),
    ("method=ppo", "expected one of dqn, eps-mcts, q-mcts"),
    ("network.feed_forward=wyde", "did you mean 'wide'"),
    ("network.rounds=0", "a whole number from 1 to"),
    ("terminal_weight=1", "terminal_weight"),
    ("network.reward_head=false", "reward_head"),
]


@pytest.mark.parametrize(("text", "words"), BAD_SETTINGS, ids=[t for t, _ in BAD_SETTINGS])
def test_override_refuses(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        override(CONFIGS["published"], [text])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    ["network=x", "dense_weight=nan", "dense_weight=inf", "network.heads=0", "network.width=0"],
)
def test_override_refuses_what_would_fail_later(text: str) -> None:
    with pytest.raises(InputError):
        override(CONFIGS["published"], [text])


def test_own_learner_is_refused_what_does_not_go_with_it() -> None:
    """Labels need values of whole placements; symmetries are built into the relations."""
    with pytest.raises(InputError, match="dense_weight"):
        TrainConfig(network=SMALL, dense_weight=0.5)
    with pytest.raises(InputError, match="augment"):
        TrainConfig(network=RELATIONAL, augment=True)
    config = TrainConfig(network=RELATIONAL, dense_weight=0.5)
    with pytest.raises(InputError, match="dense_weight"):
        override(config, ["network.encoder=attention"])
    assert override(config, ["dense_weight=0", "network.encoder=s2v"]).network.encoder == "s2v"


@pytest.mark.parametrize("count", [3, 20])
def test_network_with_other_actions_is_refused(count: int) -> None:
    """Relations beyond the task's five would be read beyond the end of a compiled array."""
    config = TrainConfig(network=dataclasses.replace(SMALL, num_actions=count), num_envs=2)
    with pytest.raises(InputError):
        Trainer(TINY, config, 0)


def test_from_dict_refuses_unknown_names() -> None:
    values = CONFIGS["published"].to_dict()
    with pytest.raises(UnknownNameError, match="did you mean 'num_envs'"):
        TrainConfig.from_dict(values | {"num_env": 3})
    with pytest.raises(UnknownNameError, match="did you mean 'heads'"):
        TrainConfig.from_dict(values | {"network": {"head": 3}})
    with pytest.raises(UnknownNameError, match="did you mean 'paper'"):
        CONFIGS["papre"]


def test_with_an_arm_our_network_looks_around_the_hand() -> None:
    """Unless it is told not to; the published networks and tasks without a robot have no hand."""
    robot = get_task("robot-four-sided-3x3-10-18")
    for name, task, expected in (
        ("relational", robot, True),
        ("relational-objects", get_task("robot-objects-two-sided-5x5-20-24"), True),
        ("relational", robot.replace(arm="none"), False),
        ("relational", get_task("two-sided-3x3-20-24"), False),
        ("published", robot, False),
    ):
        fitted = fit_to(CONFIGS[name], task)
        assert fitted.network.hand == expected, (name, task.name)
        assert override(fitted, ["network.hand=false"]).network.hand is False


def test_devices() -> None:
    assert choose_device("cpu") == "cpu"
    with pytest.raises(InputError, match="auto, cpu or cuda"):
        choose_device("gpu")


def test_settings_that_need_each_other_may_come_in_any_order() -> None:
    pair = ["dense_weight=1", "network.encoder=relational"]
    base = TrainConfig()
    assert override(base, pair) == override(base, pair[::-1])
    assert override(base, pair).dense_weight == 1
    with pytest.raises(InputError, match="dense_weight"):
        override(base, pair[:1])
    assert override(base, ["num_envs=2", "num_envs=3"]).num_envs == 3


def test_a_run_needs_a_folder() -> None:
    with pytest.raises(InputError, match="out: got None"):
        train(TINY, None)  # pyright: ignore[reportArgumentType]
