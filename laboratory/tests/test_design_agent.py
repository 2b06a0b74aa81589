"""The learned builder of designs: candidates, proofs, designs with solutions, the environment."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from safetensors.numpy import save_file

import learn2assemble.envs
from l2a_lab.builder import measure as builders
from l2a_lab.builder.network import (
    Builder,
    forward,
    initial_weights,
    load_builder,
    save_builder,
)
from l2a_lab.builder.search import RULES, lowest_largest, scarcest_cell
from l2a_lab.builder.search import build as build_site
from l2a_lab.builder.train import TEACHERS, BuilderConfig, train
from learn2assemble.assembly.kit import load_kit, orientations
from learn2assemble.design.cells import CellDesign
from learn2assemble.envs.designs import DesignEnv
from learn2assemble.errors import InputError
from learn2assemble.planning.plan import CellCount
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.planning.tiling.cover.ways import support_margin
from learn2assemble.planning.tiling.exact import plan_exact
from learn2assemble.planning.tiling.planners import PlannerChoice
from learn2assemble.planning.tiling.stack import find_stack
from learn2assemble.planning.tiling.world import LatticeWorld, make_site, run
from learn2assemble.statics.rigid_blocks import check
from learn2assemble.tasks.design_features import (
    NUM_FEATURES,
    NUM_SUMMARY,
    describe,
    mirrored,
)
from learn2assemble.tasks.designs import (
    FAMILIES,
    HELD_OUT,
    TRAINED,
    draw,
    draw_letter,
    make_design,
)
from learn2assemble.tasks.networks.agent_file import described
from learn2assemble.tasks.task import DESIGN_TASKS, DesignTask
from test_ordering import imbalance

KITS = [load_kit(name) for name in ("cubes", "bricks", "bricks-lintels", "tetrominoes")]
LITTLE = DesignTask("little", TRAINED, blocks=(3, 12))


def random_cells(rng: np.random.Generator) -> np.ndarray:
    cells = rng.random(tuple(rng.integers(1, 6, 3))) < rng.uniform(0.5, 1)
    cells[0, 0, 0] = True
    return cells


def legal_by_hand(world: LatticeWorld) -> set[tuple[int, tuple[int, int, int]]]:
    """Ways and origins of what may be put down, cell by cell from the definition."""
    site, found = world.site, set()
    wanted, filled = site.wanted, (world.owner >= 0).reshape(site.wanted.shape)
    for number, way in enumerate(orientations(site.kit)):
        kind = site.kit.kinds[way.kind]
        used = sum(site.kind[c] == way.kind for c in world.placed)
        if kind.count is not None and used >= kind.count:
            continue
        for origin in np.ndindex(wanted.shape):
            cells = np.array(way.cells) + origin
            if (cells >= wanted.shape).any() or not wanted[tuple(cells.T)].all():
                continue
            if filled[tuple(cells.T)].any():
                continue
            own = {tuple(c) for c in cells.tolist()}
            below = [(x, y, z - 1) for x, y, z in own]
            on_table = [z < 0 for _, _, z in below]
            wanted_below = [
                b
                for b, low in zip(below, on_table, strict=True)
                if not low and b not in own and wanted[b]
            ]
            if not all(filled[b] for b in wanted_below):
                continue
            carried = np.array(
                [
                    z == 0 or ((x, y, z - 1) not in own and bool(wanted[x, y, z - 1]))
                    for x, y, z in cells.tolist()
                ]
            )
            if support_margin(cells, carried, site.kit) > 1e-9:
                found.add((number, origin))
    return found


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_candidates_and_proofs_against_their_definitions(seed: int) -> None:
    """Legal candidates, cover counts and joints stay right while blocks are put down at random."""
    rng = np.random.default_rng(seed)
    kit = KITS[int(rng.integers(len(KITS)))]
    world = LatticeWorld(make_site(random_cells(rng), kit))
    site = world.site
    for _ in range(6):
        legal = world.legal()
        named = {
            (int(site.found.way[c]), tuple(int(v) for v in site.found.origin[c])) for c in legal
        }
        assert named == legal_by_hand(world)
        cover = np.zeros(site.wanted.size, int)
        for c in np.flatnonzero(world.alive):
            cover[site.cells(int(c))] += 1
        np.testing.assert_array_equal(cover, world.cover)
        if not len(legal):
            break
        world.place(int(rng.choice(legal)), program=True)
    if world.placed:
        whole = find_stack(tuple(site.placement(c) for c in world.placed), kit, site.wanted.shape)
        stack = world.proof.stack
        for name in ("weight", "centre", "upper", "start", "rank"):
            np.testing.assert_allclose(getattr(stack, name), getattr(whole, name), atol=1e-12)
        for a, b in zip(stack.start[:-1], stack.start[1:], strict=True):
            one, two = (
                sorted(
                    map(tuple, np.column_stack([s.point[a:b], s.lower[a:b], s.share[a:b]]).tolist())
                )
                for s in (stack, whole)
            )
            np.testing.assert_allclose(one, two, atol=1e-9)
        assert imbalance(world.proof, np.ones(len(world.proof.stack), bool)) < 1e-6


@settings(max_examples=20, deadline=None)
@given(cells=arrays(bool, (4, 3, 2)))
def test_features_of_a_mirrored_design_are_mirrored(cells: np.ndarray) -> None:
    cells[0, :, 0] = True
    kit = KITS[2]
    rows = {}
    for flip in (False, True):
        world = LatticeWorld(make_site(cells[::-1] if flip else cells, kit))
        legal = world.legal()
        features, _ = describe(world, legal)
        assert (np.abs(features) < 100).all()
        for c, row in zip(legal, features, strict=True):
            at = world.site.found.ways[world.site.found.way[c]]
            x, y, z = world.site.found.origin[c].tolist()
            extent = np.max(at.cells, axis=0) + 1
            x = 4 - x - int(extent[0]) if flip else x
            along_x = bool(extent[0] >= extent[1])
            rows[flip, at.kind, tuple(extent), x, y, z] = (
                mirrored(row[None], along_x, not along_x)[0] if flip else row
            )
    assert {key[1:] for key in rows if key[0]} == {key[1:] for key in rows if not key[0]}
    for key, row in rows.items():
        np.testing.assert_allclose(row, rows[(not key[0], *key[1:])], atol=1e-6)


@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_draws(family: str) -> None:
    drawn = [draw(family, np.random.default_rng(seed), 12.0, False) for seed in range(5)]
    sizes = {cells.shape for cells in drawn if cells is not None}
    assert len(sizes) > 1
    for cells in drawn:
        assert cells is None or cells[:, :, 0].any()


def test_what_is_held_out_is_not_trained_on() -> None:
    assert set(HELD_OUT) | set(TRAINED) == set(FAMILIES)
    assert not set(HELD_OUT) & set(TRAINED)


def test_letters() -> None:
    rows = ["".join("#" if c else "." for c in row) for row in draw_letter("H", 5, 1, 1, 1).T[::-1]]
    assert rows == ["#...#", "#...#", "#####", "#...#", "#...#"]
    with pytest.raises(InputError):
        draw_letter("?", 5, 1, 1, 1)


@pytest.mark.parametrize(
    "task",
    [LITTLE, DesignTask("heap", ("letters", "towers"), "bricks-lintels", (3, 15), True)],
    ids=lambda task: task.name,
)
def test_designs_have_the_solution_they_come_with(task: DesignTask) -> None:
    for seed in range(3):
        solved = make_design(task, np.random.default_rng(seed))
        world = LatticeWorld(solved.site)
        assert all(world.place(c, program=True) for c in solved.order)
        assert world.complete
        assert task.blocks[0] <= len(solved.order) <= task.blocks[1]
        if task.limited_heap:
            assert (world.heap == 0).all()
        else:
            tiling, ordering = plan_exact(solved.site.wanted, solved.kit)
            assert ordering is not None
            assert tiling.status == ordering.status == "complete"
            assert not any(block.prop for block in tiling.placements)


def test_the_environment() -> None:
    env_id = learn2assemble.envs.env_id("designs-cubes-60")
    assert gymnasium.spec(env_id)
    env = gymnasium.make("learn2assemble/designs-cubes-60-v0").unwrapped
    check_env(env, skip_render_check=True)


def test_an_episode_of_the_known_solution_returns_two() -> None:
    env = gymnasium.make("learn2assemble/designs-lintels-60-v0", task=LITTLE).unwrapped
    observation, info = env.reset(seed=3)
    total, ended = 0.0, False
    for candidate in env.solved.order:
        assert not ended
        assert observation["candidates"].shape == (1024, NUM_FEATURES)
        action = int(np.flatnonzero(env._offered == candidate)[0])
        assert info["action_masks"][action]
        observation, reward, ended, _, info = env.step(action)
        total += float(reward)
    assert ended
    assert info["success"]
    assert total == pytest.approx(2.0)


def test_a_pool_has_so_many_problems_and_a_seed_gives_another_one() -> None:
    def designs(seed: int) -> list[bytes]:
        env = gymnasium.make("learn2assemble/designs-lintels-60-v0", task=LITTLE, pool=3).unwrapped
        found = []
        for k in range(14):
            env.reset(seed=seed if k == 0 else None)
            wanted = env.world.site.wanted
            assert not env.world.placed
            assert env.world.open == wanted.sum()
            found.append(wanted.tobytes() + bytes(wanted.shape))
            env.step(0)
        return found

    first = designs(5)
    assert len(set(first)) == 3
    assert designs(5) == first
    assert not set(designs(6)) & set(first)
    for none in (0, 2.5):
        with pytest.raises(InputError, match="pool: got"):
            gymnasium.make("learn2assemble/designs-lintels-60-v0", pool=none)


def test_the_last_problem_is_not_drawn_twice() -> None:
    """Policies that play the same one share it, and what comes after it is the same."""
    env = DesignEnv(LITTLE)
    drawn = []
    for seed in (5, None, 5, None):
        env.reset(seed=seed)
        drawn.append(env.solved)
    env.reset(seed=5)
    first = env.solved
    env.reset(seed=5)
    assert env.solved is first
    cells = [one.site.wanted.tobytes() for one in drawn]
    assert cells[:2] == cells[2:]
    assert cells[0] != cells[1]
    assert drawn[0].site is not drawn[2].site  # Another one was drawn in between.


def test_presets_of_designs() -> None:
    for name, task in DESIGN_TASKS.items():
        assert task.name == name
        assert f"learn2assemble/{name}-v0" in gymnasium.registry


# ---------------------------------------------------------------- the agent


def cells_of(rows: str) -> np.ndarray:
    """A wall one cell thick from lines of ``#`` and ``.``, the top one first."""
    return np.array([[c == "#" for c in row] for row in rows.split("/")])[::-1].T[:, None, :]


H = cells_of("#...#/#...#/#####/#...#/#...#")


def test_weights_are_the_same_after_a_file(tmp_path: Path) -> None:
    builder = Builder("trial", initial_weights(3, 16, 8), {"seed": 3})
    again = load_builder(save_builder(builder, tmp_path))
    assert (again.name, again.origin) == ("trial", {"seed": 3})
    for name, value in builder.weights.items():
        np.testing.assert_array_equal(value, again.weights[name])
    world = LatticeWorld(make_site(H, KITS[2]))
    seen = describe(world, world.legal())
    np.testing.assert_array_equal(builder.scores(*seen), again.scores(*seen))


@pytest.mark.parametrize("damage", ["short", "nan", "shape", "other"])
def test_damaged_weights_are_refused(tmp_path: Path, damage: str) -> None:
    weights = initial_weights(0, 16, 8)
    if damage == "nan":
        weights["score"][0] = np.nan
    if damage == "shape":
        weights["score"] = weights["score"][1:]
    path = save_builder(Builder("trial", weights), tmp_path)
    if damage == "short":
        path.write_bytes(path.read_bytes()[:-100])
    if damage == "other":
        save_file(weights, path, described({"format": "learn2assemble-agent"}))
    with pytest.raises(InputError, match="builder"):
        load_builder(path)


def test_learning_and_playing_compute_the_same() -> None:
    rng = np.random.default_rng(0)
    weights = initial_weights(1, 16, 8)
    features = rng.normal(size=(2, 5, NUM_FEATURES)).astype(np.float32)
    summary = rng.normal(size=(2, 1, NUM_SUMMARY)).astype(np.float32)
    logits = forward(weights, features, summary)
    tensors = {k: torch.from_numpy(v) for k, v in weights.items()}
    other = forward(tensors, torch.from_numpy(features), torch.from_numpy(summary))
    np.testing.assert_allclose(logits, other.numpy(), rtol=1e-3, atol=1e-4)
    # A candidate is scored by itself.
    alone = forward(weights, features[1, :3], summary[1])
    np.testing.assert_allclose(alone, logits[1, :3], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("teacher", TEACHERS)
def test_a_short_training_learns(teacher: str) -> None:
    config = BuilderConfig(
        "trial",
        teacher,
        designs=(("designs-cubes-60", 2), ("designs-lintels-60", 3)),
        states=150,
        batch=8,
        memory=100,
        hidden=16,
        width=8,
    )
    builder = train(config)
    assert builder.origin["demonstrations"] == (teacher == "exact")
    assert builder.origin["states"] >= 150
    before = initial_weights(0, 16, 8)
    assert not np.allclose(before["first"], builder.weights["first"])
    assert build_site(make_site(H[:, :, :1], KITS[2]), builder).complete


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_what_is_built_is_within_the_rules(seed: int) -> None:
    """With a heap that may be too small and designs that may not stand: never a wrong claim."""
    rng = np.random.default_rng(seed)
    cells = random_cells(rng)
    kinds = tuple(
        dataclasses.replace(kind, count=int(rng.integers(0, 6))) if rng.random() < 0.5 else kind
        for kind in KITS[2].kinds
    )
    kit = dataclasses.replace(KITS[2], kinds=kinds)
    budget = int(rng.choice([1, 3, 10]))
    player = None if rng.random() < 0.5 else load_builder()
    outcome = build_site(make_site(cells, kit), player, budget=budget, seed=seed)
    world = outcome.world
    assert outcome.expanded <= budget * (len(cells.reshape(-1)) + 1)
    filled = np.zeros(cells.size, int)
    for candidate in world.placed:
        filled[world.site.cells(candidate)] += 1
    assert filled.max(initial=0) <= 1
    assert not (filled.reshape(cells.shape).astype(bool) & ~cells).any()
    assert world.complete == bool((filled.reshape(cells.shape) > 0)[cells].all())
    for index, kind in enumerate(kit.kinds):
        used = sum(world.site.kind[c] == index for c in world.placed)
        assert kind.count is None or used <= kind.count
    assert run(world.site, world.placed) is not None


def test_a_plan_of_the_agent_is_proven_again() -> None:
    design = CellDesign("H", H, (0.05, 0.05, 0.05), None, 0.0, None, "H", None)
    plan = plan_cells(design, "bricks-lintels", planner=PlannerChoice("agent"))
    assert plan.complete, plan.reason
    assert (plan.planner, plan.agent) == ("agent", "builder-s0")
    assert plan.cells == CellCount(int(H.sum()), 0, 0)
    assert all(step.proof for step in plan.steps)
    assert plan.search is not None
    assert plan.search.budget == 10
    assert plan.assembly is not None
    assert check(plan.assembly).verdict == "stands"


def test_what_the_agent_cannot_build_is_said() -> None:
    span = cells_of("#########/#.......#")
    design = CellDesign("span", span, (0.05, 0.05, 0.05), None, 0.0, None, "span", None)
    plan = plan_cells(design, "bricks", planner=PlannerChoice("agent"))
    assert plan.status == "incomplete"
    assert plan.cells is not None
    assert plan.cells.missing
    assert plan.reason
    assert "cells are open, the first at" in plan.reason


@pytest.mark.parametrize(("span", "kit"), [(4, "bricks"), (8, "bricks-lintels")])
def test_props_hold_what_does_not_stand_yet(span: int, kit: str) -> None:
    """A bridge whose halves only balance once the deck is whole: as many props as the exact
    planner takes, all gone in the end, every state proven."""
    pier = span // 2 + 1
    wall = "/".join(["#" * (2 * pier + span)] * 4 + ["#" * pier + "." * span + "#" * pier])
    cells = cells_of(wall)
    design = CellDesign("bridge", cells, (0.05, 0.05, 0.05), None, 0.0, None, "bridge", None)
    plan, exact = (
        plan_cells(design, kit, planner=PlannerChoice(who)) for who in ("agent", "exact")
    )
    assert plan.complete, plan.reason
    assert plan.planner == "agent"
    assert plan.cells == CellCount(int(cells.sum()), 0, 0)
    props = {step.block for step in plan.steps if step.action == "remove"}
    assert len(props) == sum(step.action == "remove" for step in exact.steps) > 0
    assert plan.assembly is not None
    assert props == {n for n, block in enumerate(plan.assembly.blocks) if block.prop}
    standing = dataclasses.replace(
        plan.assembly, steps=(), blocks=tuple(b for b in plan.assembly.blocks if not b.prop)
    )
    assert check(standing).verdict == "stands"
    assert not plan_cells(design, kit, planner=PlannerChoice("agent"), props=False).complete


def test_a_design_too_large_for_the_agent_is_refused() -> None:
    solid = np.ones((64, 64, 16), bool)
    design = CellDesign("solid", solid, (0.05, 0.05, 0.05), None, 0.0, None, "solid", None)
    with pytest.raises(InputError, match="exact, for more than"):
        plan_cells(design, "bricks-lintels", planner=PlannerChoice("agent"))


def test_a_measurement_tells_the_players_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    sets = {"letters": ("little", 0.5), "letters, limited heap": ("little-heap", 0.5)}
    for name, heap in (("little", False), ("little-heap", True)):
        task = DesignTask(name, ("letters",), blocks=(3, 15), limited_heap=heap)
        monkeypatch.setitem(DESIGN_TASKS._entries, name, task)
    monkeypatch.setattr(builders, "SETS", sets)
    found = builders.measure([load_builder()], builders.Measure(3, 1, 2), None)
    for row in found["sets"].values():
        assert row["designs"] == 3
        played = row["players"]
        assert set(played) == {"builder-s0", *RULES}
        assert all(set(how) == {"with search", "alone"} for how in played.values())
        network, chance = played["builder-s0"], played["random"]
        assert network["with search"]["complete"] >= chance["alone"]["complete"]
        assert network["alone"]["expanded_per_block"] <= 1.5
        assert row["planners"]["exact"]["complete_and_proven"] == 1


def test_rules_score_as_their_names_say() -> None:
    """On a wall two cells high that ends beside a tower, built from nothing and half built."""
    picture = np.array([[c == "#" for c in row] for row in ("######..#", "#########")])[::-1].T
    world = LatticeWorld(make_site(picture[:, None, :], load_kit("bricks-lintels")))
    found, size = world.site.found, world.site.found.size()
    for _ in range(2):
        legal = world.legal()
        order = legal[np.argsort(-lowest_largest(world, legal), kind="stable")]
        keys = [(int(found.origin[c, 2]), -int(size[c])) for c in order]
        assert keys == sorted(keys)
        assert len(set(keys)) > 2
        scores = scarcest_cell(world, legal)
        ways = np.zeros(world.owner.size, int)
        for c in np.flatnonzero(world.alive):
            ways[world.site.cells(int(c))] += 1
        least = np.array([ways[world.site.cells(int(c))].min() for c in legal])
        first = int(np.argmax(scores))
        assert least[first] == least.min()
        assert size[legal[first]] == size[legal[least == least.min()]].max()
        assert world.place(int(order[0]))


@pytest.mark.parametrize("name", RULES)
def test_rules_build_with_the_same_search(name: str) -> None:
    """A plain wall: nothing can go wrong but for chance, and every state stands."""
    site = make_site(np.ones((8, 1, 4), bool), load_kit("bricks-lintels"))
    outcome = build_site(site, RULES[name])
    assert outcome.complete
    assert outcome.expanded <= 10 * len(outcome.world.placed)
