"""Tasks with hidden errors: what happens, what is told, and who gets through."""

from __future__ import annotations

import copy
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env, data_equivalence

from learn2assemble.cli import main
from learn2assemble.envs import env_id, hidden
from learn2assemble.envs.hidden import MOVE, STEP, HiddenEnv
from learn2assemble.envs.hidden_policies import (
    HiddenLookahead,
    PlannerWithoutLooks,
    RepairingPlanner,
)
from learn2assemble.envs.policies import RandomChoice, load_policy
from learn2assemble.envs.submission import check, enter
from learn2assemble.envs.suite import SuiteTask
from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.statics.rigid_blocks import check as check_statics
from learn2assemble.tasks.hidden_errors import (
    BIAS,
    LOOK,
    HiddenNumbers,
    Placing,
    draw_numbers,
    draw_placing,
)
from learn2assemble.tasks.hidden_world import (
    JOINT,
    STILL,
    TOLERANCE,
    GivenBlocks,
    HiddenWorld,
    corner_distance,
    exact_numbers,
    make_given_blocks,
    overlap,
)
from learn2assemble.tasks.task import HIDDEN_TASKS, HiddenTask

NAME = "hidden-designs-20"
TASK = HIDDEN_TASKS[NAME]
NONE = np.zeros(3)


def with_factor(times: float) -> HiddenTask:
    return replace(TASK, factor=times * TASK.factor)


def boxes(*ends: tuple[tuple[float, ...], tuple[float, ...]]) -> GivenBlocks:
    """Given blocks by their corners, in cells of 5 cm."""
    low, high = (0.05 * np.array([end[k] for end in ends], float) for k in (0, 1))
    size = high - low - [JOINT, JOINT, 0.0]
    return GivenBlocks("", (low + high) / 2, size, 800.0, tuple(range(len(ends))))


def wall() -> HiddenWorld:
    """Two bricks side by side, and one on top of both."""
    design = boxes(((0, 0, 0), (2, 1, 1)), ((2, 0, 0), (4, 1, 1)), ((1, 0, 1), (3, 1, 2)))
    return HiddenWorld(design, exact_numbers(3))


def play(env: HiddenEnv, policy, seed: int) -> tuple[float, bool]:
    observation, info = env.reset(seed=seed)
    if hasattr(policy, "begin"):
        policy.begin(env.imagined())
    total, ended = 0.0, False
    while not ended:
        observation, reward, ended, _, info = env.step(policy(observation, info))
        total += reward
    return total, info["success"]


def begun(seed: int = 3, task: HiddenTask = TASK) -> HiddenEnv:
    env = HiddenEnv(task)
    env.reset(seed=seed)
    return env


# ---------------------------------------------------------------- the environment


def test_gymnasium_accepts_it() -> None:
    env = gymnasium.make(env_id(NAME)).unwrapped
    assert isinstance(env, HiddenEnv)
    check_env(env, skip_render_check=True)


def test_a_seed_and_actions_determine_the_episode() -> None:
    seen = []
    for _ in range(2):
        env, rng = HiddenEnv(NAME), np.random.default_rng(1)
        told: list = [env.reset(seed=7)]
        for _ in range(40):
            allowed = np.flatnonzero(told[-1][-1]["action_masks"])
            allowed = allowed[allowed != env.actions.done]
            told.append(env.step(rng.choice(allowed)))
            if told[-1][2]:
                break
        seen.append(told)
    assert data_equivalence(*seen)
    assert {one[-1]["verdict"] for one in seen[0]} >= {"placed", "looked", "adjusted"}


def test_what_is_hidden_is_not_told() -> None:
    """Episodes that differ in hidden numbers alone look the same until something is looked at."""
    env = begun()
    others = [env.imagined(k) for k in range(3)]
    numbers = [one._world.numbers for one in [env, *others]]
    assert len({one.friction for one in numbers}) == 4
    assert len({tuple(one.bias) for one in numbers}) == 4
    place = int(np.flatnonzero(env.action_masks())[0])
    for actions in ((), (env.actions.adjust,), (place,)):
        told = []
        for one in others:
            one = copy.deepcopy(one)
            said: list = [one.observe(), one._info(hidden.Happened(""))]
            for action in actions:
                observation, _, ended, truncated, info = one.step(action)
                said = [observation, ended, truncated, info]
            told.append(said)
        assert data_equivalence(told[0], told[1])
        assert data_equivalence(told[0], told[2])
    looked = []
    for one in others:
        one.step(place)
        looked.append(one.step(env.actions.look)[0]["blocks"])
    assert (looked[0] != looked[1]).any()


def test_who_plays_is_given_other_numbers_and_no_seed() -> None:
    given = []

    class Curious(RandomChoice):
        def begin(self, env) -> None:
            given.append(env)

    task = SuiteTask(NAME)
    env = task.make()
    assert isinstance(env, HiddenEnv)
    task.play(env, 0, Curious())
    (told,) = given
    assert (told._world.numbers.bias != env._world.numbers.bias).all()
    assert told.np_random_seed == -1
    told.reset()
    assert (told.design.middle[:3] != env.design.middle[:3]).any()


def test_a_look_changes_what_is_believed() -> None:
    env = begun()
    block = int(np.flatnonzero(env.action_masks())[0])
    for action in (env.actions.adjust + 1, env.actions.adjust + 4, block):
        observation, *_ = env.step(action)
    row = observation["blocks"][block]
    assert row[hidden.STANDS] == 1
    assert row[hidden.SEEN] == 0
    assert (row[hidden.MEASURED] == 0).all()
    assert row[hidden.COMMANDED] == pytest.approx([STEP[0], 0, -STEP[2]])
    observation, *_, info = env.step(env.actions.look)
    row, world = observation["blocks"][block], env._world
    assert info["verdict"] == "looked"
    assert row[hidden.SEEN] == 1
    off = 1e3 * (world.pose[block] - np.append(world.design.middle[block, :2], 0))
    noise = 1e3 * TASK.factor * LOOK
    assert (np.abs(row[hidden.MEASURED] - off) < 5 * noise[:3]).all()
    assert (row[hidden.MEASURED] != row[hidden.COMMANDED]).all()
    size = 1e3 * world.numbers.size[block]
    assert (np.abs(row[hidden.EXTENT] - size) < 5 * noise[3:]).all()
    assert observation["clock"][1] == 0


def test_time_is_what_actions_take() -> None:
    env = begun()
    count, start = len(env.design), env._left
    assert start == round(MOVE * (TASK.moves[0] * count + TASK.moves[1]))
    env.step(env.actions.adjust)
    env.step(env.actions.look)
    assert env._left == start - MOVE - 1
    taken = env.actions.take
    assert env.step(taken)[-1]["verdict"] == "refused"
    assert env._left == start - 2 * MOVE - 1
    ended = False
    while not ended:
        _, reward, ended, _, info = env.step(env.actions.look)
        assert reward == 0
    assert env._left < MOVE
    assert not info["success"]
    with pytest.raises(ResetNeeded):
        env.step(env.actions.look)


def test_corrections_have_limits() -> None:
    env = begun()
    while env.action_masks()[env.actions.adjust + 3]:
        observation, *_ = env.step(env.actions.adjust + 3)
    assert observation["hand"].tolist() == [0, hidden.MOST[1], 0]
    assert env.step(env.actions.adjust + 3)[-1]["verdict"] == "refused"


def test_the_return_is_the_share_in_place_at_the_end() -> None:
    env = HiddenEnv(with_factor(1.0))
    total, success = play(env, PlannerWithoutLooks(), 5)
    share = env._world.in_place().mean()
    assert total == pytest.approx(share, abs=1e-12)
    assert success == (share == 1)


@pytest.mark.parametrize("action", [-1, 48, 3.5])
def test_an_action_that_is_none_is_refused(action) -> None:
    with pytest.raises(InputError, match="0 to 47"):
        begun().step(action)


def test_what_makes_no_sense_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'hidden-designs-20'"):
        HiddenEnv("hidden-design-20")
    with pytest.raises(InputError, match="render_mode"):
        HiddenEnv(NAME, render_mode="human")
    with pytest.raises(InputError, match="factor"):
        replace(TASK, factor=-1.0)
    for call in (HiddenEnv(NAME).action_masks, HiddenEnv(NAME).imagined):
        with pytest.raises(ResetNeeded):
            call()
    with pytest.raises(InputError, match="hidden-designs-"):
        RepairingPlanner().begin(gymnasium.make(env_id("goals-bridge")).unwrapped)


# ---------------------------------------------------------------- what happens


def test_errors_are_as_large_as_is_said() -> None:
    rng = np.random.default_rng(0)
    drawn = [draw_numbers(1, 2.0, rng) for _ in range(2000)]
    assert np.std([one.bias for one in drawn], 0) == pytest.approx(2 * BIAS, rel=0.1)
    friction = np.array([one.friction for one in drawn])
    assert friction.min() >= 0.5 / 4
    assert friction.max() <= 0.5 * 4
    slides = [
        np.mean([np.hypot(*draw_placing(mu, 1.0, rng).slip[:2]) for _ in range(2000)])
        for mu in (0.25, 1.0)
    ]
    assert slides[0] / slides[1] == pytest.approx(4, rel=0.15)
    none = draw_placing(0.5, 0.0, rng)
    assert not none.slip.any()
    assert not none.jolt.any()


def test_a_block_lies_where_the_hand_left_it() -> None:
    world = wall()
    world.numbers = HiddenNumbers(np.array([1e-3, 0, 0.01]), np.zeros((3, 2)), 0.5)
    slip = np.array([0, 2e-3, 0.01])
    assert world.place(0, np.array([-3e-3, 0, 0]), Placing(slip, np.zeros(2))).verdict == "placed"
    off = world.pose[0] - np.append(world.design.middle[0, :2], 0)
    assert off == pytest.approx([-2e-3, 2e-3, 0.02])
    assert not world.in_place()[0]
    moved = corner_distance(np.array([0, TOLERANCE, 0]), world.size[0, :2])
    assert moved == pytest.approx(TOLERANCE)
    turn = TOLERANCE / np.hypot(*world.size[0, :2] / 2)
    assert corner_distance(np.array([0, 0, turn]), world.size[0, :2]) == pytest.approx(
        TOLERANCE, rel=1e-3
    )


def test_a_block_that_would_overlap_is_not_put_down() -> None:
    world = wall()
    world.place(0, NONE, STILL)
    assert world.place(1, np.array([-1.01 * JOINT, 0, 0]), STILL).verdict == "collides"
    assert world.stands.tolist() == [True, False, False]
    assert world.place(1, np.array([-0.99 * JOINT, 0, 0]), STILL).verdict == "placed"


def test_overlaps_of_turned_rectangles() -> None:
    size = np.array([0.1, 0.05])
    at, beside = np.zeros(3), np.array([0.1, 0, np.pi / 2])
    assert overlap(at, size, beside, size) == pytest.approx(-0.025)
    assert overlap(at, size, beside - [0.03, 0, 0], size) == pytest.approx(0.005)
    corner = np.array([0.0875, 0, np.pi / 4])
    assert overlap(at, size, corner, size) == pytest.approx(0.0155, abs=1e-3)


def test_what_may_be_done_comes_from_below() -> None:
    world = wall()
    assert world.may_place().tolist() == [True, True, False]
    world.place(0, NONE, STILL)
    world.place(1, NONE, STILL)
    assert world.may_place().tolist() == [False, False, True]
    world.place(2, NONE, STILL)
    assert world.may_take().tolist() == [False, False, True]
    assert world.take(2, STILL).verdict == "taken"
    assert world.may_take().tolist() == [True, True, False]


def test_what_a_jolt_moves_falls_with_all_that_rests_on_it() -> None:
    column = boxes(*(((0, 0, k), (1, 1, k + 1)) for k in range(6)), ((2, 0, 0), (6, 4, 1)))
    world = HiddenWorld(column, exact_numbers(7))
    for block in (6, 0, 1, 2, 3, 4):
        assert world.place(block, NONE, STILL).verdict == "placed"
    jolt = Placing(NONE, np.array([0.0, 0.22]))
    happened = world.place(5, NONE, jolt)
    assert (happened.verdict, happened.fallen) == ("falls", (0, 1, 2, 3, 4, 5))
    assert world.stands.tolist() == [False] * 6 + [True]


def test_a_block_without_its_counterweight_falls() -> None:
    design = boxes(((0, 0, 0), (1, 1, 1)), ((0, 0, 1), (3, 1, 2)), ((0, 0, 2), (1, 1, 3)))
    world = HiddenWorld(design, exact_numbers(3))
    world.place(0, NONE, STILL)
    assert world.place(1, NONE, STILL) == hidden.Happened("falls", (1,))


def test_the_known_order_stands_without_errors() -> None:
    design = make_given_blocks(TASK, np.random.default_rng(4))
    assert TASK.blocks[0] <= len(design) <= TASK.blocks[1]
    world = HiddenWorld(design, exact_numbers(len(design)))
    for block in design.order:
        assert world.may_place()[block]
        assert world.place(block, NONE, STILL).verdict == "placed"
    assert world.in_place().all()


@pytest.mark.parametrize("seed", range(3))
def test_states_are_judged_as_by_the_check_of_assemblies(seed: int) -> None:
    """What stands where blocks truly are: verdict, and margin against the jolts."""
    rng = np.random.default_rng(seed)
    design = make_given_blocks(TASK, rng)
    world = HiddenWorld(design, draw_numbers(len(design), 2.0, rng))
    verdicts = set()
    for block in design.order:
        world.put(block, np.append(design.middle[block, :2], 0.0) + world.numbers.bias)
        others = np.flatnonzero(world.stands)
        size = world.size[:, :2]
        pairs = [(a, b) for a in others for b in others[others > a] if design.beside[a, b]]
        if any(overlap(world.pose[a], size[a], world.pose[b], size[b]) > 0 for a, b in pairs):
            world.stands[block] = False
            continue
        said = check_statics(world.assembly())
        stands = not world.moving(np.zeros(2))
        assert stands == (said.verdict == "stands")
        verdicts.add(stands)
        if not stands:
            world.stands[block] = False
    least = check_statics(world.assembly()).margin_g
    angles = np.arange(16) * np.pi / 8
    ways = np.stack([np.cos(angles), np.sin(angles)], 1)
    assert not any(world.moving(0.97 * least * way) for way in ways[::4])
    assert any(world.moving(1.1 * least * way) for way in ways)


def test_the_check_and_the_rules_agree_on_what_falls() -> None:
    design = boxes(((0, 0, 0), (1, 1, 1)), ((0, 0, 1), (3, 1, 2)))
    world = HiddenWorld(design, exact_numbers(2))
    for block in range(2):
        world.put(block, np.append(design.middle[block, :2], 0.1))
    assert world.moving(np.zeros(2)) == [1]
    assert check_statics(world.assembly()).verdict == "falls"


# ---------------------------------------------------------------- who gets through


def test_without_errors_the_exact_planner_completes_all() -> None:
    env = HiddenEnv(replace(TASK, factor=0.0))
    assert [play(env, RepairingPlanner(), seed) for seed in range(4)] == [(1.0, True)] * 4


def test_larger_errors_are_worse() -> None:
    policy, seeds = RepairingPlanner(), range(20, 22)
    usual, large = (
        np.mean([play(HiddenEnv(with_factor(times)), policy, seed)[0] for seed in seeds])
        for times in (1, 3)
    )
    assert usual > large + 0.3


def test_looks_are_what_helps() -> None:
    """Under a hand that is off by more than the tolerance."""
    bias = np.array([4e-3, -3e-3, 0.0])
    scores = []
    for policy in (RepairingPlanner(), PlannerWithoutLooks(), HiddenLookahead()):
        env = begun(2, with_factor(0.3))
        env._world.numbers = replace(env._world.numbers, bias=bias)
        policy.begin(env)
        observation, info, ended = env.observe(), env._info(hidden.Happened("")), False
        while not ended:
            observation, _, ended, _, info = env.step(policy(observation, info))
        scores.append(float(env._world.in_place().mean()))
    assert scores == [1.0, 0.0, 0.0]


def test_an_entry_is_played_again_and_what_was_tampered_with_is_refused(
    tmp_path, capsys: pytest.CaptureFixture[str]
) -> None:
    entry = enter(load_policy("planner-with-repair"), "planner", tasks=[NAME], problems=1)
    (path := tmp_path / "x.jsonl.gz").parent.mkdir(exist_ok=True)
    entry.write(path)
    assert check(path) == entry
    (one,) = entry.played
    look = HiddenEnv(NAME).actions.look
    changed = tuple(
        look if a < len(one.actions) and k == 0 else a for k, a in enumerate(one.actions)
    )
    replace(entry, played=(replace(one, actions=changed),)).write(path, overwrite=True)
    assert main(["benchmark", "check", str(path)]) == 2
    assert "problem 0" in capsys.readouterr().err
