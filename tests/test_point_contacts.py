"""Contacts of edges and points, against hand-computed truth and what a simulation settled."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from learn2assemble.assembly.blocks import Assembly, Block, hull_block
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.contacts import across
from learn2assemble.assembly.files import from_json
from learn2assemble.assembly.point_contacts import middle_of
from learn2assemble.planning.given import plan_assembly
from learn2assemble.statics.rigid_blocks import FALLS, STANDS, UNCERTAIN, Check, check

_LINES = (Path(__file__).parent / "data" / "point_contacts.jsonl").read_text().splitlines()
SAMPLES = {document["name"]: from_json(document) for document in map(json.loads, _LINES)}
"""Assemblies by name. ``settled/...`` settled in MuJoCo, where they stay within 1 mm for two
seconds; ``falling/...`` are heaps without one of the stones that carry them, which move by more
than 20 mm in a second. See settled.py."""


def ridge(name: str, x: float, height: float = 0.1) -> Block:
    """A prism whose upper edge lies along y at ``x``."""
    ends = [(x - 0.1, 0.0), (x + 0.1, 0.0), (x, height)]
    vertices = np.array([(u, y, z) for y in (-0.1, 0.1) for u, z in ends])
    faces = ((0, 1, 2), (5, 4, 3), (0, 3, 4, 1), (1, 4, 5, 2), (2, 5, 3, 0))
    return Block(name, vertices, faces)


def plank(low: float, high: float, z: float = 0.1) -> Block:
    return box_block("plank", (low, -0.05, z), (high, 0.05, z + 0.04))


@pytest.mark.parametrize("name", [name for name in SAMPLES if name.startswith("settled/")])
def test_what_settled_on_edges_and_points_stands(name: str) -> None:
    answer = check(SAMPLES[name])
    assert answer.verdict == STANDS
    assert "certain" not in answer.proof


@pytest.mark.parametrize("name", [name for name in SAMPLES if name.startswith("falling/")])
def test_what_falls_in_simulation_is_not_said_to_stand(name: str) -> None:
    assert check(SAMPLES[name]).verdict in (FALLS, UNCERTAIN)


def test_there_are_samples() -> None:
    assert Counter(name.partition("/")[0] for name in SAMPLES) == {"settled": 12, "falling": 4}


@pytest.mark.parametrize("name", ["ck2_plank_on_ridges", "ck2_log_in_V", "planks-1", "log-0"])
def test_what_rests_on_edges_gets_an_order(name: str) -> None:
    """Plans of given blocks see the contacts that the check sees."""
    plan = plan_assembly(SAMPLES[f"settled/{name}"])
    assert plan.complete
    assert all((step.margin_g or 0) > 0 for step in plan.steps)


def test_a_heap_that_needs_all_its_stones_is_said_to_stand_once_they_are_there() -> None:
    """In MuJoCo its stones 0 and 1 fall without stone 2, and stand with it."""
    heap = SAMPLES["settled/ck2_heap0"]
    plan = plan_assembly(heap)
    assert not plan.complete
    assert "with one block held at a time it is built" in (plan.reason or "")
    assert plan_assembly(heap, holds=1).complete


def test_a_state_on_edges_that_is_not_certain_is_not_said_to_fall() -> None:
    for off, verdict, words in (
        (1e-2, FALLS, "the finished structure falls: plank would move first"),
        (1e-3, UNCERTAIN, "is not certain: plank may move"),
    ):
        beside = Assembly((ridge("base", 0.0), plank(-0.2 + off, 0.2 + off)))
        assert check(beside).verdict == verdict
        assert words in (plan_assembly(beside).reason or "")


def test_half_a_roof_falls_and_both_halves_stand() -> None:
    """What is not known of the ridge says nothing of a slab alone."""
    roof = SAMPLES["settled/roof-0"]
    assert check(Assembly(roof.blocks[:1], friction=roof.friction)).verdict == FALLS
    assert "falls with any of" in (plan_assembly(roof).reason or "")


@pytest.mark.parametrize("gap", [-0.0002, 0.0, 0.0002])
def test_a_plank_on_two_ridges_stands(gap: float) -> None:
    two = Assembly((ridge("left", -0.2), ridge("right", 0.2), plank(-0.3, 0.3, 0.1 + gap)))
    assert check(two).verdict == STANDS


def test_what_may_not_touch_carries_nothing() -> None:
    """One of the ridges is lower by 0.2 mm, a seventh of the tolerance."""
    low, high = ridge("left", -0.2, 0.0998), ridge("right", 0.2)
    answer = check(Assembly((low, high, plank(-0.3, 0.3))))
    assert answer.verdict == UNCERTAIN
    assert check(Assembly((low, high, plank(-0.15, 0.55)))).verdict == STANDS


def test_a_block_balanced_on_an_edge_is_no_step() -> None:
    """Forces balance it, and the least push tips it: its edge is known to the tolerance."""
    corners = np.array([(x, y, z) for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1)])
    turned = corners.copy()
    turned[:, 0] = (corners[:, 0] - corners[:, 2]) / np.sqrt(2)
    turned[:, 2] = (corners[:, 0] + corners[:, 2]) / np.sqrt(2)
    cube = Assembly((hull_block("cube", turned),))
    assert "without a margin" in check(cube).proof
    assert not plan_assembly(cube, supports="none").complete


def test_a_plank_off_the_middle_of_one_ridge_falls() -> None:
    answer = check(Assembly((ridge("base", 0.0), plank(-0.1, 0.2))))
    assert answer.verdict == FALLS
    assert answer.moving == ("plank",)
    assert "for certain" in answer.proof


def test_a_plank_within_the_tolerance_of_its_middle_is_not_said_to_fall() -> None:
    """Its centre is 0.1 mm beside the edge, which is known to less than that."""
    answer = check(Assembly((ridge("base", 0.0), plank(-0.1999, 0.2001))))
    assert answer.verdict in (STANDS, UNCERTAIN)
    assert "falls for certain" not in answer.proof


def test_crossed_edges_touch_at_points() -> None:
    """A prism upside down lies with its edge, along x, across two ridges along y: it rolls off."""
    upper = ridge("upper", 0.0)
    turned = upper.vertices[:, [1, 0, 2]] * [4.0, 0.5, -1.0] + [0, 0, 0.2]
    assembly = Assembly(
        (ridge("left", -0.2), ridge("right", 0.2), Block("upper", turned, upper.faces))
    )
    answer = check(assembly)
    edges = answer.contacts.only(answer.contacts.a >= 0)
    assert len(edges.a) == 2
    np.testing.assert_allclose(np.abs(edges.normal[:, 2]), 1.0, atol=1e-9)
    np.testing.assert_allclose(np.sort(edges.points[:, 0]), [-0.2, 0.2], atol=1e-9)
    assert "falls for certain" not in answer.proof, "within the tolerance it is balanced"


def _possible_normals(answer: Check, patch: int, count: int = 64) -> np.ndarray:
    """float64[count, 3]: unit vectors at the largest angle from the normal of a patch."""
    normal, spread = answer.contacts.normal[patch], answer.contacts.spread[patch]
    u, v = across(normal[None])[0]
    angle = 2 * np.pi * np.arange(count)[:, None] / count
    return np.cos(spread) * normal + np.sin(spread) * (np.cos(angle) * u + np.sin(angle) * v)


@pytest.mark.parametrize("name", ["roof-0", "roof-1", "stones-0"])
def test_forces_are_possible_along_whatever_direction_a_contact_pushes(name: str) -> None:
    """Of two ridges that touch, planes of many directions separate the slabs."""
    roof = SAMPLES[f"settled/{name}"]
    answer = check(roof)
    contacts = answer.contacts
    spread = np.flatnonzero(contacts.spread > np.radians(1))
    assert len(spread)
    for patch in spread:
        forces = answer.forces[contacts.patch == patch]
        assert np.linalg.norm(forces, axis=1).max() > 0
        for normal in _possible_normals(answer, int(patch)):
            along = forces @ normal
            aside = np.linalg.norm(forces - along[:, None] * normal, axis=1)
            size = np.linalg.norm(forces, axis=1)
            assert (aside <= roof.friction * along + 1e-6 * size.max()).all()


@pytest.mark.parametrize("friction", [0.55, 0.7, 0.9])
def test_what_stands_only_along_one_of_many_directions_is_not_certain(friction: float) -> None:
    """Edges of a roof with a right angle push within 45 degrees of level, so friction has to
    hold what is pushed along the steepest of them: its angle is 45 degrees at 1."""
    slabs = []
    for name, side in (("left", -1.0), ("right", 1.0)):
        along, across_ = np.array([-side, 1.0]), np.array([side, 1.0])
        foot = np.array([side * 0.5, 0.0])
        ends = [foot + t * along + h * across_ for t in (0.0, 0.5) for h in (0.0, 0.05)]
        corners = [(x, y, z) for x, z in ends for y in (-0.1, 0.1)]
        slabs.append(hull_block(name, corners))
    answer = check(Assembly(tuple(slabs), friction=friction))
    assert answer.verdict == UNCERTAIN
    assert check(Assembly(tuple(slabs), friction=0.3)).verdict == FALLS
    wide = check(Assembly(tuple(slabs), friction=1.1))
    assert wide.verdict == STANDS
    ridge_ = wide.contacts.a >= 0
    np.testing.assert_allclose(wide.contacts.spread[ridge_], np.pi / 4, atol=1e-3)


def test_the_middle_of_directions_is_as_far_from_the_farthest_as_said() -> None:
    rng = np.random.default_rng(5)
    for _ in range(200):
        axes = rng.normal(size=(rng.integers(1, 9), 3)) * [0.5, 0.5, 0.3] + [0, 0, 1.5]
        axes /= np.linalg.norm(axes, axis=1)[:, None]
        middle, spread = middle_of(axes)
        angles = np.arccos(np.clip(axes @ middle, -1, 1))
        np.testing.assert_allclose(angles.max(), spread, atol=1e-7)
        apart = np.arccos(np.clip(axes @ axes.T, -1, 1)).max()
        assert apart / 2 - 1e-6 <= spread <= apart / np.sqrt(3) + 0.03
