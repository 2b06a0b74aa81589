"""The Gymnasium environments: contracts, masks, autoreset, drawings, golden episodes.

The golden episodes in ``tests/data/golden_episodes.txt`` are rewritten by running this file:
``python tests/test_envs.py [PRESET ...]``. Read the difference before you commit it.
"""

from __future__ import annotations

import copy
import pickle
import re
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.error import NameNotFound, ResetNeeded
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode
from hypothesis import given, settings
from hypothesis import strategies as st

from learn2assemble.constants import EDGE
from learn2assemble.envs import actions as flat_actions
from learn2assemble.envs import env_id, register_all
from learn2assemble.envs.assembly import AssemblyEnv, AssemblyVectorEnv
from learn2assemble.envs.drawing import COLOURS, SCALE
from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.tasks.graph.features import Graph, connectivity
from learn2assemble.tasks.physics.protocol import PlacementVerdict
from learn2assemble.tasks.physics.static import StaticPhysics
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import PRESETS, get_task
from learn2assemble.tasks.world.blocks import DIRECTIONS, RELATIONS

SMALL = "two-sided-3x3-20-24"
INFO_KEYS = {"action_masks", "physics_mask", "coverage", "plane_coverage"}
STEP_KEYS = {"verdict", "success", "clipped"}

each_preset = pytest.mark.parametrize("name", PRESETS)
some_preset = st.sampled_from(sorted(PRESETS))


def make(name: str = SMALL, **kwargs) -> AssemblyEnv:
    env = gymnasium.make(env_id(name), **kwargs).unwrapped
    assert isinstance(env, AssemblyEnv)
    return env


def make_vector(count: int, name: str = SMALL, **kwargs) -> AssemblyVectorEnv:
    env = gymnasium.make_vec(env_id(name), num_envs=count, **kwargs)
    assert isinstance(env, AssemblyVectorEnv)
    return env


def pick(info: dict, rng: np.random.Generator, key: str = "physics_mask") -> int:
    """A random action of a mask; any legal one where the mask is empty."""
    choices = np.flatnonzero(info[key])
    return int(rng.choice(choices if len(choices) else np.flatnonzero(info["action_masks"])))


def play(env, seed: int, steps: int, key: str = "physics_mask") -> list:
    """Up to ``steps`` steps of one episode; everything the environment said."""
    rng = np.random.default_rng(seed)
    seen: list = [env.reset(seed=seed)]
    for _ in range(steps):
        seen.append(env.step(pick(seen[-1][-1], rng, key)))
        if seen[-1][2]:
            break
    return seen


# ---- contracts


@each_preset
def test_gymnasium_accepts_every_preset(name: str) -> None:
    check_env(make(name))


@each_preset
def test_make_gives_the_preset(name: str) -> None:
    env, task = make(name), get_task(name)
    assert env.task == task
    assert env.action_space.n == task.num_nodes**2 * task.num_actions
    obs, info = env.reset(seed=1)
    assert set(info) == INFO_KEYS
    assert obs["num_nodes"] == task.num_nodes
    low, high = task.block_range
    assert low <= task.num_nodes - obs["num_targets"] <= high
    assert obs["num_placed"] == 1 or task.objects == "bars"
    assert (info["plane_coverage"] == 0.0) == task.normalise_initial
    assert info["coverage"] >= 0.0
    _, _, _, _, info = env.step(pick(info, np.random.default_rng(0)))
    assert set(info) == INFO_KEYS | STEP_KEYS


def test_a_wrong_name_gets_the_nearest_one() -> None:
    with pytest.raises(NameNotFound, match="Did you mean: `two-sided-3x3-20-24`"):
        gymnasium.make("learn2assemble/two-sided-3x3-20-42-v0")
    with pytest.raises(UnknownNameError, match="did you mean 'two-sided-3x3-20-24'"):
        AssemblyEnv("two-sided-3x3-20-42")
    with pytest.raises(UnknownNameError, match="did you mean 'static'"):
        AssemblyEnv(SMALL, physics="statik")
    with pytest.raises(UnknownNameError, match="did you mean 'rgb_array'"):
        AssemblyEnv(SMALL, render_mode="rgb")
    with pytest.raises(UnknownNameError, match="did you mean 'NextStep'"):
        AssemblyVectorEnv(SMALL, autoreset_mode="next-step")
    with pytest.raises(InputError, match="num_envs"):
        AssemblyVectorEnv(SMALL, num_envs=0)


def test_registering_twice_is_silent() -> None:
    register_all()


def test_one_line_makes_an_environment_without_torch_or_mujoco() -> None:
    code = (
        "import sys, gymnasium\n"
        f"gymnasium.make('learn2assemble.envs:{env_id(SMALL)}').reset(seed=0)\n"
        "sys.exit(' '.join({'torch', 'mujoco'} & set(sys.modules)) or None)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr.strip()) == (0, "")


def test_observation_is_enough_for_connectivity() -> None:
    env = make()
    obs = play(env, 4, 3)[-1][0]
    batched = Graph(**{key: np.asarray(value)[None] for key, value in obs.items()})
    truth = env.simulator.observe(env.state)
    for kind in ("partial", "full"):
        assert np.array_equal(connectivity(batched, kind), connectivity(truth, kind))


# ---- seeding, determinism, copies


@settings(max_examples=10, deadline=None)
@given(some_preset, st.integers(0, 2**32))
def test_a_seed_determines_the_episode(name: str, seed: int) -> None:
    assert data_equivalence(play(make(name), seed, 9), play(make(name), seed, 9), exact=True)


def test_seeds_differ_and_unseeded_resets_go_on_drawing() -> None:
    env = make()
    problems = [env.reset(seed=s)[0]["nodes"].tobytes() for s in range(20)]
    problems += [env.reset()[0]["nodes"].tobytes() for _ in range(20)]
    assert len(set(problems)) == 40


@pytest.mark.parametrize("clone", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_copies_continue_alike_and_share_nothing(clone) -> None:
    env, rng = make(), np.random.default_rng(0)
    info = play(env, 3, 2)[-1][-1]
    twin, keep = clone(env), clone(env)
    action = pick(info, rng)
    assert data_equivalence(env.step(action), twin.step(action), exact=True)
    assert data_equivalence(env.reset(), twin.reset(), exact=True)
    assert data_equivalence(keep.step(action)[0], clone(keep)._observation(), exact=True)
    assert keep.state.num_placed[0] == 4


def test_vector_environments_can_be_pickled() -> None:
    env = make_vector(3)
    env.reset(seed=0)
    twin = pickle.loads(pickle.dumps(env))
    assert data_equivalence(env.step([0, 1, 2]), twin.step([0, 1, 2]), exact=True)


# ---- actions and masks


@given(some_preset, st.data())
def test_flat_actions_are_a_numbering(name: str, data) -> None:
    task = get_task(name)
    action = data.draw(st.integers(0, flat_actions.num_flat_actions(task) - 1))
    i, j, k = flat_actions.unflatten_action(task, action)
    assert 0 <= i < task.num_nodes
    assert 0 <= j < task.num_nodes
    assert 0 <= k < task.num_actions
    assert flat_actions.flatten_action(task, i, j, k) == action
    pair = flat_actions.unflatten_action(task, np.array([action, 0]))
    assert [x.tolist() for x in pair] == [[i, 0], [j, 0], [k, 0]]


@settings(max_examples=15, deadline=None)
@given(some_preset, st.integers(0, 2**32), st.integers(0, 12))
def test_masks_say_what_every_action_does(name: str, seed: int, steps: int) -> None:
    env = make(name)
    last = play(env, seed, steps)[-1]
    obs, info = last[0], last[-1]
    assert info["action_masks"].dtype == info["physics_mask"].dtype == np.int8
    if info["action_masks"].any():
        assert info["action_masks"][env.action_space.sample(info["action_masks"])]
    mask, stable = info["action_masks"].astype(bool), info["physics_mask"].astype(bool)
    assert not (stable & ~mask).any()
    assert np.array_equal(mask, env.action_masks())
    flat = np.flatnonzero(mask)
    if len(flat) == 0:
        assert last[2]
        return
    unplaced = obs["num_nodes"] - obs["num_targets"] - obs["num_placed"]
    assert len(flat) == unplaced * obs["num_placed"] * env.task.num_actions
    others = np.flatnonzero(~mask)
    worlds = env.state.take(np.zeros(len(others), np.int64))
    assert flat_actions.resolve_actions(env.task, worlds, others)[1].all()

    worlds = env.state.take(np.zeros(len(flat), np.int64))
    actions, clipped = flat_actions.resolve_actions(env.task, worlds, flat)
    assert not clipped.any()
    some = np.linspace(0, len(flat) - 1, 6).astype(int)
    reached = (
        env.simulator.step(worlds.take(some), actions[some]).verdict == PlacementVerdict.STABLE
    )
    # The mask knows no arm.
    verdict = Simulator(env.task.replace(arm="none")).step(worlds, actions).verdict
    assert np.array_equal(verdict == PlacementVerdict.STABLE, stable[flat])
    assert not (reached & ~stable[flat][some]).any()
    assert env.task.has_arm or np.array_equal(reached, stable[flat][some])
    i, j, k = flat_actions.unflatten_action(env.task, flat)
    sizes = (obs["object_id"][i][:, None] == obs["object_id"][-unplaced:]).sum(1)
    assert np.array_equal(worlds.num_placed, obs["num_placed"] + sizes)
    placed = obs["num_placed"]
    assert np.array_equal(worlds.object_id[:, placed], obs["object_id"][i])
    step = np.array([env.task.pitch, env.task.pitch, EDGE])
    target = obs["nodes"][j, :3] + step * DIRECTIONS[k // env.task.rotations]
    if env.task.action_spec.level:
        # The chosen cell is as far above its object's lowest as it was while waiting.
        waiting = obs["object_id"][-unplaced:], obs["nodes"][-unplaced:, 2]
        lowest = [waiting[1][waiting[0] == number].min() for number in obs["object_id"][i]]
        target[:, 2] += obs["nodes"][i, 2] - lowest
    assert np.allclose(worlds.position[:, placed], target, atol=1e-6)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.integers(0, 4499))
def test_illegal_nodes_are_clipped_like_the_published_code(seed: int, action: int) -> None:
    env = make()
    last = play(env, seed, 3)[-1]
    if len(last) == 5 and last[2]:
        return
    obs, twin = last[0], copy.deepcopy(env)
    first = int(obs["num_targets"])
    middle, end = first + int(obs["num_placed"]), int(obs["num_nodes"])
    i, j, k = flat_actions.unflatten_action(env.task, action)
    nearest = min(max(i, middle), end - 1), min(max(j, first), middle - 1), k
    legal = flat_actions.flatten_action(env.task, *nearest)
    assert last[-1]["action_masks"][legal]
    done, wanted = env.step(action), twin.step(legal)
    assert done[-1].pop("clipped") == (legal != action)
    assert not wanted[-1].pop("clipped")
    assert data_equivalence(done, wanted, exact=True)


@pytest.mark.parametrize("action", [-1, 4500, 1.0, "top", [1, 2], None])
def test_an_action_outside_the_space_is_refused(action) -> None:
    env = make()
    env.reset(seed=0)
    with pytest.raises(InputError, match=r"action: got .* expected 1 integer in 0\.\.4499"):
        env.step(action)
    vector = make_vector(2)
    vector.reset(seed=0)
    with pytest.raises(InputError, match="expected 2 integers"):
        vector.step([0, action])


def test_physics_mask_is_opt_out() -> None:
    assert "physics_mask" not in make(physics_mask=False).reset(seed=0)[1]
    assert "physics_mask" not in make_vector(2, physics_mask=False).reset(seed=0)[1]


# ---- episodes


def test_steps_need_a_reset() -> None:
    for env in (make(), make_vector(1)):
        for call in (env.action_masks, env.render, lambda env=env: env.step(np.array(0))):
            with pytest.raises(ResetNeeded):
                call()


@settings(max_examples=40, deadline=None)
@given(some_preset, st.integers(0, 2**32), st.sampled_from(["action_masks", "physics_mask"]))
def test_random_play_follows_the_rules(name: str, seed: int, key: str) -> None:
    env = make(name)
    seen = play(env, seed, env.task.max_blocks, key)
    state = env.state
    for _, reward, terminated, truncated, info in seen[1:]:
        assert reward in (-1.0, 0.0, 1.0) or (env.task.reward == "scaled" and 0 <= reward <= 4)
        assert (reward == -1.0) == (info["verdict"] != "STABLE")
        assert not truncated
        assert info["success"] == (
            info["verdict"] == "STABLE" and info["coverage"] > env.task.success_threshold
        )
        assert terminated or not info["success"]
    obs, _, terminated, _, info = seen[-1]
    assert terminated
    used_up = obs["num_targets"] + obs["num_placed"] == obs["num_nodes"]
    assert info["verdict"] != "STABLE" or info["success"] or used_up
    assert not info["action_masks"].any()
    assert not info["physics_mask"].any()
    span = state.mask_pixels[0] - state.initial_pixels[0]
    assert info["coverage"] == (state.complete_pixels[0] - state.initial_pixels[0]) / span
    assert info["plane_coverage"] == (state.plane_pixels[0] - state.initial_pixels[0]) / span
    with pytest.raises(ResetNeeded, match="ended"):
        env.step(0)


class Quake(StaticPhysics):
    """Nothing stands."""

    name = "quake"

    def settle(self, state, rows):
        return np.full(len(rows), PlacementVerdict.UNSTABLE, np.int8)


def test_physics_is_an_argument() -> None:
    env = AssemblyEnv(get_task(SMALL), physics=Quake())
    _, info = env.reset(seed=0)
    _, reward, terminated, _, info = env.step(pick(info, np.random.default_rng(0)))
    assert (reward, terminated, info["verdict"]) == (-1.0, True, "UNSTABLE")


# ---- many worlds


def rollout(env, steps: int, seed: int = 7, change: int | None = None) -> list:
    """Random steps of a vectorised environment; world ``change`` plays differently."""
    rng, other = np.random.default_rng(seed), np.random.default_rng(seed + 1)
    seen: list = [env.reset(seed=seed)]
    for _ in range(steps):
        masks = seen[-1][-1]["physics_mask"]
        size = masks.shape[1]
        actions = []
        for row, mask in enumerate(masks):
            draw = rng.random(2)
            if row == change:
                draw = other.random(2)
            good = np.flatnonzero(mask)
            anything = len(good) == 0 or draw[0] < 0.2
            actions.append(int(draw[1] * size) if anything else good[int(draw[1] * len(good))])
        seen.append(env.step(np.array(actions)))
    return seen


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("name", [SMALL, "one-sided-3x3-22-24", "four-sided-3x3-10-18"])
def test_vector_equals_single_environments_in_a_loop(name: str, mode: AutoresetMode) -> None:
    native = make_vector(5, name, autoreset_mode=mode)
    loop = gymnasium.make_vec(
        env_id(name), 5, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}
    )
    assert native.metadata["autoreset_mode"] is mode
    assert native.observation_space == loop.observation_space
    assert native.action_space == loop.action_space
    ours, theirs = rollout(native, 40), rollout(loop, 40)
    assert sum(step[2].sum() for step in ours[1:]) > 10
    for number, (a, b) in enumerate(zip(ours, theirs, strict=True)):
        assert data_equivalence(a, b, exact=True), f"step {number}"
        assert a[0] in native.observation_space


def test_vector_equals_single_environments_under_rigid_physics() -> None:
    native = make_vector(3, physics="rigid")
    loop = gymnasium.make_vec(env_id(SMALL), 3, vectorization_mode="sync", physics="rigid")
    ours, theirs = rollout(native, 10), rollout(loop, 10)
    assert any("STABLE" in step[-1]["verdict"] for step in ours[1:])
    for number, (a, b) in enumerate(zip(ours, theirs, strict=True)):
        assert data_equivalence(a, b, exact=True), f"step {number}"


def test_world_k_with_seed_s_is_a_single_world_with_seed_s_plus_k() -> None:
    obs, info = make_vector(4).reset(seed=100)
    for k in range(4):
        one, its_info = make().reset(seed=100 + k)
        assert data_equivalence(one, {key: value[k] for key, value in obs.items()}, exact=True)
        assert np.array_equal(its_info["physics_mask"], info["physics_mask"][k])
    env = make_vector(3)
    env.reset(seed=[5, 9, None])
    assert env.np_random_seed[:2] == (5, 9)
    with pytest.raises(InputError, match="seed"):
        env.reset(seed=[1, 2])


def test_worlds_do_not_leak_into_each_other() -> None:
    plain, changed = rollout(make_vector(4), 30), rollout(make_vector(4), 30, change=2)

    def world(seen: list, row: int) -> list:
        return [
            [
                {k: v[row] for k, v in s[0].items()},
                [x[row] for x in s[1:-1]],
                {k: v[row] for k, v in s[-1].items() if not k.endswith(tuple(STEP_KEYS))},
            ]
            for s in seen
        ]

    for row in (0, 1, 3):
        assert data_equivalence(world(plain, row), world(changed, row), exact=True)
    assert not data_equivalence(world(plain, 2), world(changed, 2), exact=True)


def test_what_the_caller_does_to_returned_arrays_has_no_effect() -> None:
    clean, dirty = make_vector(3), make_vector(3)
    rng = np.random.default_rng(0)
    a, b = clean.reset(seed=1), dirty.reset(seed=1)
    for _ in range(12):
        assert data_equivalence(a, b, exact=True)
        actions = np.array(
            [
                pick({k: v[r] for k, v in a[-1].items() if k in INFO_KEYS}, rng)
                if a[-1]["action_masks"][r].any()
                else 0
                for r in range(3)
            ]
        )
        for array in [*b[0].values(), *b[1:-1], *b[-1].values()]:
            array[:] = 0
        a, b = clean.step(actions), dirty.step(actions.copy())


def test_without_autoreset_the_caller_resets() -> None:
    env = make_vector(3, autoreset_mode="Disabled")
    env.reset(seed=0)
    legal = [int(np.flatnonzero(mask)[0]) for mask in env.action_masks()]
    targets = env.state.num_targets[1]
    into = flat_actions.flatten_action(
        env.task, env.task.num_nodes - 1, targets, RELATIONS.index("top")
    )
    obs, _, _, _, _ = env.step([legal[0], into, legal[2]])
    inside = env.state.position[1, :2]  # next to the first block: free, but floating or standing
    assert np.allclose(inside[1] - inside[0], (0, 0, EDGE))
    while not env._ended[1]:
        obs, _, ended, _, _ = env.step([int(mask.argmax()) for mask in env.action_masks()])
    with pytest.raises(ResetNeeded, match="reset_mask"):
        env.step([0, 0, 0])
    fresh, infos = env.reset(options={"reset_mask": ended})
    assert np.array_equal(infos["_coverage"], ended)
    assert (fresh["num_placed"][ended] == 1).all()
    assert np.array_equal(fresh["nodes"][~ended], obs["nodes"][~ended])
    env.step([0, 0, 0])
    with pytest.raises(InputError, match="reset_mask"):
        env.reset(options={"reset_mask": np.zeros(3, bool)})


# ---- drawings


@settings(max_examples=15, deadline=None)
@given(some_preset, st.integers(0, 2**32), st.integers(0, 15))
def test_the_image_shows_the_pixel_counts(name: str, seed: int, steps: int) -> None:
    env = make(name, render_mode="rgb_array")
    play(env, seed, steps)
    image, state = env.render(), env.state
    assert image.shape == (100 * SCALE, 100 * SCALE * env.task.num_sides, 3)
    pixels = image[::SCALE, ::SCALE]

    def count(colour: str) -> int:
        return int((pixels == COLOURS[colour]).all(-1).sum())

    assert count("filled") == state.plane_pixels[0]
    assert count("filled") + count("hidden") == state.complete_pixels[0]
    assert count("filled") + count("hidden") + count("target") == state.mask_pixels[0]


def test_the_text_shows_blocks_where_they_stand() -> None:
    env = make("one-sided-3x3-22-24", render_mode="ansi")
    obs, _ = env.reset(seed=2)
    first = int(obs["num_targets"])
    for relation in ("right", "top", "front"):
        last = first + int(obs["num_placed"]) - 1
        k = RELATIONS.index(relation)
        obs, *_ = env.step(flat_actions.flatten_action(env.task, env.task.num_nodes - 1, last, k))
    # The fourth block floats in front of the third and hides it.
    body = env.render().splitlines()[1:]
    assert re.fullmatch("=+", body[-1])
    middle = len(body[-1]) // 2
    assert set(body[-2][middle : middle + 2]) <= {"#", "x"}
    assert body[-3][middle + 1] == "o"
    assert sum("".join(body).count(mark) for mark in "#xo") == 3
    assert make().render_mode is None
    quiet = make()
    quiet.reset(seed=0)
    assert quiet.render() is None
    vector = make_vector(2, render_mode="ansi")
    vector.reset(seed=2)
    assert len(vector.render()) == 2


# ---- golden episodes


def transcript(name: str) -> str:
    """A readable episode: greedy by one look ahead, then one invalid placement."""
    env = AssemblyEnv(name, render_mode="ansi")
    rng = np.random.default_rng(11)
    obs, info = env.reset(seed=11)
    lines = [f"{env_id(name)}, seed 11", "targets (x, y, z) [m]:"]
    lines += [
        "  " + " ".join(f"{p:+.4f}" for p in node[:3])
        for node in obs["nodes"][: obs["num_targets"]]
    ]
    lines += ["", env.render(), ""]
    ended, number = False, 0
    while not ended:
        number += 1
        wanted = info["physics_mask"] if number <= 12 else 1 - info["physics_mask"]
        actions = rng.permutation(np.flatnonzero(wanted & info["action_masks"]))
        worlds = env.state.take(np.zeros(len(actions), np.int64))
        triples, _ = flat_actions.resolve_actions(env.task, worlds, actions)
        ahead = env.simulator.step(worlds, triples)
        action = int(actions[np.argmax(ahead.reward + ahead.success)])
        i, j, k = flat_actions.unflatten_action(env.task, action)
        relation, way = divmod(k, env.task.rotations)
        turned = f" after {way} quarter turns" if way else ""
        if env.task.action_mode == "grips":
            turned = f" by grip {way}"
        digits = 4 if env.task.reward == "scaled" else 0
        obs, reward, ended, _, info = env.step(action)
        lines.append(
            f"{number:2d}. action {action}: node {i}{turned} {RELATIONS[relation]} of node {j}: "
            f"{info['verdict']}, reward {reward:+.{digits}f}, F_co {info['coverage']:.4f}, "
            f"F_pl {info['plane_coverage']:.4f}, {info['action_masks'].sum()} legal, "
            f"{info['physics_mask'].sum()} good"
        )
    lines += ["", env.render(), "", "success" if info["success"] else "no success", ""]
    return "\n".join(lines)


EPISODES = Path(__file__).parent / "data" / "golden_episodes.txt"
BETWEEN = "-" * 100 + "\n"


def golden() -> dict[str, str]:
    """The golden episodes by preset, as their first lines say."""
    parts = EPISODES.read_text(encoding="utf-8").split(BETWEEN)
    return {part.partition("/")[2].partition("-v0,")[0]: part for part in parts}


GOLDEN = (
    "two-sided-3x3-20-24",
    "four-sided-3x3-10-18",
    "one-sided-5x5-15-17",
    "objects-two-sided-5x5-20-24",
    "objects21-two-sided-6x6-30-34",
    "bars-one-sided-5x5-25-27",
    "robot-two-sided-3x3-10-14",
    "robot-objects-two-sided-5x5-20-24",
)
"""One preset of every kind."""


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_episode(name: str) -> None:
    assert transcript(name) == golden()[name], f"differs: see python {Path(__file__).name}"


def test_no_golden_episode_besides() -> None:
    assert sorted(golden()) == sorted(GOLDEN)


if __name__ == "__main__":
    episodes = golden() if EPISODES.exists() else {}
    episodes |= {preset: transcript(preset) for preset in sys.argv[1:] or GOLDEN}
    text = BETWEEN.join(episodes[preset] for preset in GOLDEN if preset in episodes)
    EPISODES.write_text(text, encoding="utf-8")
