"""Contacts of edges and points, against hand-computed truth and what a simulation settled."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from learn2assemble.assembly.blocks import Assembly, Block, box_block
from learn2assemble.assembly.files import from_json
from learn2assemble.planning.given import plan_assembly
from learn2assemble.statics.rigid_blocks import FALLS, STANDS, UNCERTAIN, check

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
