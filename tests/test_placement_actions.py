"""Actions that are numbers of distinct placements, beside the flat ones they stand for."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Discrete
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode
from hypothesis import given, settings
from hypothesis import strategies as st

from learn2assemble.envs import env_id
from learn2assemble.envs.actions import flatten_action, num_placement_actions, resolve_actions
from learn2assemble.envs.assembly import REFUSED, AssemblyEnv, AssemblyVectorEnv
from learn2assemble.errors import UnknownNameError
from learn2assemble.tasks.graph.features import node_offset
from learn2assemble.tasks.graph.placements import distinct_placements
from learn2assemble.tasks.task import PRESETS, get_task

SMALL = "two-sided-3x3-20-24"
some_preset = st.sampled_from(sorted(PRESETS))


def make(name: str = SMALL, **kwargs) -> AssemblyEnv:
    env = gymnasium.make(env_id(name), actions="placements", **kwargs).unwrapped
    assert isinstance(env, AssemblyEnv)
    return env


@pytest.mark.parametrize("name", PRESETS)
def test_gymnasium_accepts_every_preset(name: str) -> None:
    check_env(make(name), skip_render_check=True)


@settings(max_examples=15, deadline=None)
@given(some_preset, st.integers(0, 2**32))
def test_a_placement_does_what_its_flat_action_does(name: str, seed: int) -> None:
    """All along one episode; only the observation of the compact one says more."""
    flat, compact, rng = AssemblyEnv(name), make(name), np.random.default_rng(seed)
    (_, other), (seen, info) = flat.reset(seed=seed), compact.reset(seed=seed)
    ended = False
    while not ended:
        choices = np.flatnonzero(info["physics_mask"])
        if not len(choices):
            choices = np.flatnonzero(info["action_masks"])
        number = int(rng.choice(choices))
        graph = compact.simulator.observe(compact.state)
        placements = distinct_placements(graph, compact.simulator.action_spec)
        filled = placements.members[0, number]
        middle = placements.cells[0, filled[filled >= 0]].mean(0)
        assert np.allclose(seen["placements"][number], middle, atol=1e-6)
        action = int(flatten_action(flat.task, *placements.action[0, number].tolist()))
        assert other["action_masks"][action]
        assert other["physics_mask"][action] == info["physics_mask"][number]
        told, expected = compact.step(number), flat.step(action)
        assert told[1:4] == expected[1:4]
        assert data_equivalence({key: told[0][key] for key in expected[0]}, expected[0], exact=True)
        assert {k: v for k, v in told[4].items() if "mask" not in k} == {
            k: v for k, v in expected[4].items() if "mask" not in k
        }
        (seen, _, ended, _, info), other = told, expected[4]


@settings(max_examples=15, deadline=None)
@given(some_preset, st.integers(0, 2**32))
def test_the_mask_holds_every_result_of_the_flat_actions_once(name: str, seed: int) -> None:
    env, rng = make(name), np.random.default_rng(seed)
    _, info = env.reset(seed=seed)
    for _ in range(3):
        stable = np.flatnonzero(info["physics_mask"])
        if not len(stable):
            break
        _, _, ended, _, info = env.step(int(rng.choice(stable)))
        if ended:
            break
    mask = env.action_masks()
    assert mask.dtype == np.bool_
    assert env.action_space == Discrete(len(mask))
    assert len(mask) == num_placement_actions(env.task)
    assert np.array_equal(mask, info["action_masks"].astype(bool))
    assert not (info["physics_mask"].astype(bool) & ~mask).any()
    graph = env.simulator.observe(env.state)
    placements = distinct_placements(graph, env.simulator.action_spec)
    count = int(placements.count[0]) if not env.state.terminated[0] else 0
    assert mask.sum() == count
    assert mask[:count].all()
    assert len(set(placements.key[0, :count].tolist())) == count
    flat = AssemblyEnv(name)
    flat.state = env.state.copy()
    flat._started = True
    local = placements.action[0, :count] - node_offset(graph)[0]
    numbers = flatten_action(env.task, *placements.action[0, :count].T)
    resolved = [resolve_actions(env.task, env.state, numbers[n : n + 1]) for n in range(count)]
    assert all(np.array_equal(a[0], b) and not c for (a, c), b in zip(resolved, local, strict=True))


def test_padding_is_refused() -> None:
    env = make()
    _, info = env.reset(seed=0)
    before = env.state.copy()
    padding = int(np.flatnonzero(~env.action_masks())[0])
    _, reward, ended, truncated, info = env.step(padding)
    assert (reward, ended, truncated) == (-1.0, True, False)
    assert info["verdict"] == REFUSED
    assert not info["success"]
    assert not info["action_masks"].any()
    assert np.array_equal(env.state.position, before.position)
    assert env.state.num_placed[0] == before.num_placed[0]


def test_the_vector_environment_refuses_padding_as_single_ones_do() -> None:
    rng, count = np.random.default_rng(0), 4
    vector = AssemblyVectorEnv(SMALL, count, actions="placements")
    single = gymnasium.vector.SyncVectorEnv(
        [lambda: AssemblyEnv(SMALL, actions="placements")] * count,
        autoreset_mode=AutoresetMode.NEXT_STEP,
    )
    vector.reset(seed=3)
    single.reset(seed=3)
    verdicts: set[str | None] = set()
    for _ in range(12):
        actions = rng.integers(0, 40, count)
        told, expected = vector.step(actions), single.step(actions)
        assert data_equivalence(told[0], expected[0], exact=True)
        assert all(np.array_equal(a, b) for a, b in zip(told[1:4], expected[1:4], strict=True))
        told, expected = (one[4].get("verdict", np.empty(0)).tolist() for one in (told, expected))
        assert told == expected
        verdicts |= set(told)
    assert REFUSED in verdicts


def test_it_is_compact() -> None:
    assert num_placement_actions(get_task(SMALL)) == 115


def test_a_wrong_kind_gets_the_nearest_one() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'placements'"):
        AssemblyEnv(SMALL, actions="placement")
