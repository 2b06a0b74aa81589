"""Pictures in place of states, and policies that see them."""

from __future__ import annotations

import importlib.util

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from headless import ROOT
from learn2assemble.envs import env_id
from learn2assemble.envs.designs import DesignEnv
from learn2assemble.envs.hidden import HiddenEnv
from learn2assemble.envs.pictures import (
    HIDDEN_PIXEL,
    HIDDEN_SIZE,
    THERE,
    WAITING,
    WANTED,
    PictureObservation,
    pictures_of,
)
from learn2assemble.envs.policies import load_policy
from learn2assemble.envs.submission import check, enter
from learn2assemble.envs.suite import SuiteTask
from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.tasks.hidden_world import STILL
from learn2assemble.tasks.world.coverage import to_pixels

PLACEMENTS, HIDDEN = "two-sided-3x3-20-24", "hidden-designs-20"
SEEN = f"{ROOT / 'examples' / 'benchmark' / 'from_pictures.py'}:Seen"


def make(name: str):
    return SuiteTask(name).make()


@pytest.mark.parametrize("name", [PLACEMENTS, "designs-cubes-60", HIDDEN])
@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version")
def test_gymnasium_accepts_pictures(name: str) -> None:
    how = {"actions": "placements"} if name == PLACEMENTS else {}
    env = PictureObservation(gymnasium.make(env_id(name), **how).unwrapped)
    check_env(env, skip_render_check=True)
    assert env.observation_space["picture"].dtype == np.uint8
    assert env.action_masks().any()


def test_an_elevation_shows_target_and_blocks() -> None:
    env = make(PLACEMENTS)
    _, info = env.reset(seed=3)
    pictures = pictures_of(env)
    before = pictures.observe()
    action = int(np.flatnonzero(info["physics_mask"])[0])
    env.step(action)
    after = pictures.observe()
    for side in range(2):
        panel = after["picture"][:, 100 * side : 100 * (side + 1)]
        mask, covered = (to_pixels(v[0, side]) for v in (env.state.mask, env.state.covered))
        assert ((panel[..., WANTED] > 0) == mask).all()
        assert ((panel[..., THERE] > 0) & mask == covered & mask).all()
    # What has appeared in an elevation lies in the box of the action.
    shown = False
    for side in range(2):
        top, left, bottom, right = before["boxes"][action, side].round().astype(int)
        new = (after["picture"] > before["picture"])[:, 100 * side : 100 * (side + 1), THERE]
        if bottom:
            inside = np.zeros_like(new)
            inside[top - 1 : bottom + 1, left - 100 * side - 1 : right - 100 * side + 1] = True
            assert new.any()
            assert not (new & ~inside).any()
            shown = True
    assert shown
    plan = after["picture"][:, 200:]
    waits = before["picture"][:, 200:, WAITING].sum() - plan[..., WAITING].sum()
    assert waits > 0
    assert not before["boxes"][~env.action_masks()].any() or env.action_masks().all()


def test_a_design_shows_its_cells_and_its_heap() -> None:
    env = make("designs-lintels-60-heap-held-out")
    assert isinstance(env, DesignEnv)
    env.reset(seed=1)
    pictures, size = pictures_of(env), env.task.extent
    cells = env.world.site.wanted
    picture = pictures.observe()["picture"]
    assert picture[..., THERE].sum() == 0
    plan = picture[: cells.shape[1], : cells.shape[0], WANTED]
    assert (plan == cells.sum(2).T * 255 // size).all()
    front = picture[size - cells.shape[2] :, size : size + cells.shape[0], WANTED]
    assert (front == cells.sum(1).T[::-1] * 255 // size).all()
    heap = picture[:, 3 * size :, WAITING] > 0
    height = size // len(env.world.heap)
    assert heap[::height][: len(env.world.heap)].sum(1).tolist() == env.world.heap.tolist()
    top, left, bottom, right = pictures.observe()["boxes"][0, 1].astype(int)
    env.step(0)
    after = pictures.observe()["picture"]
    new = np.argwhere(after[:, size : 2 * size, THERE] > 0) + np.array([0, size])
    assert new.min(0).tolist() == [top, left]
    assert (new.max(0) + 1).tolist() == [bottom, right]


def test_millimetres_show_where_errors_are_hidden() -> None:
    env = make(HIDDEN)
    assert isinstance(env, HiddenEnv)
    env.reset(seed=1)
    pictures, block = pictures_of(env), int(np.flatnonzero(env.action_masks())[0])
    place = pictures.observe()
    assert (place["picture"][..., WAITING] == place["picture"][..., WANTED]).all()
    for _ in range(4):
        env.step(env.actions.adjust + 1)
    env._world.place = lambda block, correction, placing: type(env._world).place(
        env._world, block, -env._world.numbers.bias, STILL
    )
    env.step(block)
    seen = pictures.observe()["picture"]
    assert (seen[..., WAITING] != place["picture"][..., WAITING]).any()
    plan = seen[:HIDDEN_SIZE, :HIDDEN_SIZE, THERE].astype(float) / 255
    x = (np.arange(HIDDEN_SIZE) + 0.5 - HIDDEN_SIZE / 2) * HIDDEN_PIXEL
    # Believed where the correction was: 2 mm along x.
    assert (plan.sum(0) @ x) / plan.sum() == pytest.approx(
        env.design.middle[block, 0] + 2e-3, abs=2e-4
    )
    assert place["boxes"][env.actions.look :].sum() == 0


def test_what_has_no_pictures_is_refused() -> None:
    with pytest.raises(InputError, match="pictures of"):
        PictureObservation(gymnasium.make(env_id("goals-bridge")))
    with pytest.raises(InputError, match="actions='placements'"):
        PictureObservation(gymnasium.make(env_id(PLACEMENTS)))

    def choose(observation, info) -> int:
        return 0

    choose.observations = "film"
    with pytest.raises(UnknownNameError, match="observations of the policy"):
        enter(choose, "x", tasks=[PLACEMENTS], problems=1)


def test_a_policy_enters_that_sees_pictures(tmp_path) -> None:
    """Its entry is actions, like any other, and is checked without pictures."""
    entry = enter(load_policy(SEEN), "seen", tasks=[PLACEMENTS, HIDDEN], problems=2)
    assert entry.knows == "observation"
    assert entry.scores(PLACEMENTS).mean() > 0.6
    entry.write(path := tmp_path / "seen.jsonl.gz")
    assert check(path) == entry


def test_the_example_is_a_class() -> None:
    spec = importlib.util.spec_from_file_location("seen", SEEN.rpartition(":")[0])
    assert spec is not None
    assert load_policy(SEEN).observations == "picture"
