"""Edges that run through triangles: against every pair in turn, and fans of narrow triangles."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from learn2assemble.design.solids import crossed
from learn2assemble.geometry.crossings import find_crossing


def slow(points: np.ndarray, edges: np.ndarray, triangles: np.ndarray) -> set[tuple[int, int]]:
    """The edges that run through triangles, by the solution of a linear system for every pair."""
    found = set()
    for i, j in edges.tolist():
        for triangle in triangles.tolist():
            if {i, j} & set(triangle):
                continue
            a, b, c = points[triangle]
            system = np.column_stack([b - a, c - a, points[i] - points[j]])
            if abs(np.linalg.det(system)) < 1e-12:
                continue
            s, t, along = np.linalg.solve(system, points[i] - a)
            if min(s, t, 1 - s - t) > 0 and 0 < along < 1:
                found.add((i, j))
    return found


def case(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, edges and triangles at random."""
    random = np.random.default_rng(seed)
    edges = np.array([random.permutation(24)[:2] for _ in range(3)])
    triangles = np.array([random.permutation(24)[:3] for _ in range(int(random.integers(1, 6)))])
    return random.random((24, 3)), edges, triangles


@pytest.mark.parametrize("seed", range(24))
def test_the_first_edge_that_crosses_is_found(seed: int) -> None:
    points, edges, triangles = case(seed)
    through = slow(points, edges, triangles)
    found = find_crossing(points, edges, triangles, 1e-9, 0.0)
    crossing = [tuple(edge) for edge in edges.tolist() if tuple(edge) in through]
    assert (None if found is None else tuple(found.tolist())) == (crossing or [None])[0]


def test_the_cases_have_both_answers() -> None:
    answers = [bool(slow(*case(seed))) for seed in range(24)]
    assert 5 < sum(answers) < 20


def test_a_fan_of_narrow_triangles_is_searched_at_once() -> None:
    """Of 160,000 triangles nearly all boxes of the two caps overlap: 10⁹ pairs, each of which was
    written down. A spike through a cap is found among them."""
    tube = trimesh.creation.cylinder(1.0, height=2.0, sections=40_000)
    vertices, faces = np.asarray(tube.vertices), np.asarray(tube.faces)
    assert not crossed(vertices, faces)
    spike = trimesh.creation.cone(0.01, height=1.0, sections=8)
    spike.apply_translation((0.4, 0.3, 0.5))
    both = trimesh.util.concatenate([tube, spike])
    assert crossed(np.asarray(both.vertices), np.asarray(both.faces))
