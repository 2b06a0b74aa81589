"""Small random structures of given blocks, planned and, independently, tried out.

``python test_random_structures.py 300 [WORD]``, in this folder and with ``tests`` in PYTHONPATH,
runs 300 cases of every comparison, or of those with that word in their name, and prints what
differs.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import learn2assemble as l2a
from l2a_lab.fewest_posts import fewest_posts, random_assembly
from l2a_lab.states import states_of
from learn2assemble.assembly.blocks import Assembly, hull_block
from learn2assemble.assembly.contacts import find_contacts
from learn2assemble.errors import InputError
from learn2assemble.planning.tiling.exact import plan_exact
from learn2assemble.planning.tiling.ordering import to_assembly
from learn2assemble.statics.forces.equilibrium import solve
from learn2assemble.statics.proofs import LOCAL, PROGRAM
from learn2assemble.statics.rigid_blocks import FALLS, UNCERTAIN
from test_small_designs import random_design, random_kit

ALIKE = "alike"


def polygons(seed: int) -> Assembly:
    """Prisms over random convex polygons in two to four layers, some of them over the edge."""
    rng = np.random.default_rng(seed)
    blocks, height = [], 0.05
    below = [np.zeros(2)] + [np.array([0.21 * k, 0.0]) for k in range(1, int(rng.integers(1, 4)))]
    for layer in range(int(rng.integers(2, 5))):
        places: list[np.ndarray] = []
        for on in below:
            at = on + rng.normal(scale=0.025, size=2) * (layer > 0)
            if any(np.linalg.norm(at - other) < 0.2 for other in places):
                continue
            places.append(at)
            sides = int(rng.integers(3, 9))
            angle = (np.arange(sides) + rng.uniform(0, 0.6, sides)) * 2 * np.pi / sides
            corners = at + 0.1 * np.column_stack([np.cos(angle), np.sin(angle)])
            both = [[*xy, z] for z in (height * layer, height * (layer + 1)) for xy in corners]
            name = f"p{layer}{len(places)}"
            blocks.append(hull_block(name, both, density=float(rng.choice([500, 2000]))))
        below = places
        if len(places) > 1 and rng.random() < 0.5:  # One over the gap between two.
            below = [(places[0] + places[1]) / 2, *places[2:]]
    return Assembly(tuple(blocks), friction=float(rng.choice([0.3, 0.6])))


def planned(assembly: Assembly, **options: object) -> l2a.Plan:
    return l2a.build(assembly, seconds=600, **options)  # pyright: ignore[reportArgumentType]


# ---------------------------------------------------------------- comparisons of one case


def certificate(seed: int) -> str:
    """States that are proven by passing loads down, and a program of forces without friction."""
    plan = planned(polygons(seed), supports="none")
    assert plan.assembly is not None
    proofs = [step.proof for step in plan.steps]
    assert len(proofs) == len(plan.assembly.steps)
    for proof, state in zip(proofs, states_of(plan.assembly), strict=True):
        if proof in (LOCAL, PROGRAM):
            found = solve(state, find_contacts(state), 0.0, coupled=False)
            if not found.stands:
                return f"accepted with {len(state.blocks)} blocks, refused by the program"
    told = "complete" if plan.complete else "not complete"
    return f"{ALIKE}, {told}, {sorted({str(proof) for proof in proofs})}"


def lattice(seed: int) -> str:
    """Blocks of a kit in an order found among cells, and as blocks that are given."""
    rng = np.random.default_rng(seed)
    wanted, kit = random_design(rng), random_kit(rng)
    tiling, ordering = plan_exact(wanted, kit, props_allowed=False)
    used = Counter(block.kind for block in tiling.placements)
    size = {kind.name: len(kind.cells) for kind in kit.kinds}
    enough = all(kind.count is None or used[kind.name] <= kind.count for kind in kit.kinds)
    if not enough or sum(size[kind] * count for kind, count in used.items()) < wanted.sum():
        return f"{ALIKE}, not filled"
    by_cells = ordering is not None and ordering.status == "complete"
    assembly = to_assembly(tiling, None, kit)
    by_blocks = planned(assembly, supports="none").complete
    if by_cells == by_blocks:
        return f"{ALIKE}, {'complete' if by_cells else 'not complete'}"
    return f"by cells {by_cells}, by blocks {by_blocks}"


def order(seed: int) -> str:
    """An order of blocks without help, and all of them."""
    assembly = random_assembly(seed) if seed % 2 else polygons(seed)
    if len(assembly.blocks) > 8:
        return f"{ALIKE}, too many"
    plan = planned(assembly, supports="none")
    exists = orders_exist(assembly)
    if plan.complete == exists:
        return f"{ALIKE}, {'complete' if exists else 'not complete'}"
    return f"complete: {plan.complete}, an order exists: {exists}"


def orders_exist(assembly: Assembly) -> bool:
    """Whether blocks can follow one another so that every state is balanced, by trying all."""
    contacts = find_contacts(assembly)
    count = len(assembly.blocks)
    reached, queue = {0}, [0]
    for state in queue:
        for k in range(count):
            after = state | 1 << k
            if after not in reached:
                present = np.array([bool(after >> j & 1) for j in range(count)])
                if solve(assembly, contacts, present=present).stands:
                    reached.add(after)
                    queue.append(after)
    return (1 << count) - 1 in reached


def posts(seed: int) -> str:
    """The posts of a plan, and the fewest by trying everything."""
    assembly = random_assembly(seed)
    plan = planned(assembly)
    assert plan.assembly is not None
    used = len(plan.assembly.blocks) - len(assembly.blocks)
    least = fewest_posts(assembly)
    if plan.complete and used == least:
        return f"{ALIKE}, {used} posts"
    return f"{len(assembly.blocks)} blocks, {plan.status}, {used} posts, {least} would do"


def told_otherwise(assembly: Assembly, change: str, rng: np.random.Generator) -> Assembly:
    """The same structure in other words: turned, mirrored, in another unit, in another order."""
    blocks = list(assembly.blocks)
    if change == "order":
        return replace(assembly, blocks=tuple(blocks[k] for k in rng.permutation(len(blocks))))
    angle = rng.uniform(0, 2 * np.pi)
    c, s = np.cos(angle), np.sin(angle)
    matrix = {
        "turn": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]),
        "mirror": np.diag([-1.0, 1.0, 1.0]),
        "unit": np.eye(3) * float(rng.choice([0.1, 25.4])),
    }[change]
    flip = change == "mirror"
    moved = [
        replace(
            b,
            vertices=b.vertices @ matrix.T,
            faces=tuple(f[::-1] for f in b.faces) if flip else b.faces,
        )
        for b in blocks
    ]
    return replace(assembly, blocks=tuple(moved))


def verdicts(assembly: Assembly) -> tuple[str, bool]:
    """What the check says, and whether it is built with posts."""
    try:
        return l2a.check(assembly).verdict, planned(assembly).complete
    except InputError:
        return "refused", False


def words(seed: int) -> str:
    """A structure and the same one told otherwise."""
    rng = np.random.default_rng(seed)
    assembly = random_assembly(seed) if seed % 2 else polygons(seed)
    plain = verdicts(assembly)
    for change in ("turn", "mirror", "unit", "order"):
        other = verdicts(told_otherwise(assembly, change, rng))
        if other != plain:
            return f"{plain}, after {change} {other}"
    return f"{ALIKE}, {plain}"


# ---------------------------------------------------------------- in the suite

COMPARED: dict[str, Callable[[int], str]] = {
    "certificate": certificate,
    "lattice": lattice,
    "order": order,
    "posts": posts,
    "words": words,
}
IN_SUITE = {
    **{"certificate": range(25), "lattice": range(25), "order": range(16), "words": range(8)},
    "posts": (1, 3, 5, 7, 14, 16, 22, 24),
}
"""Cases of each in the suite; hundreds of them take minutes. Of posts two arches, two of courses
and four of beams, of few blocks: every set of posts is tried."""


@pytest.mark.parametrize(
    ("name", "seed"), [(name, seed) for name, seeds in IN_SUITE.items() for seed in seeds]
)
def test_what_is_planned_is_what_trying_out_says(name: str, seed: int) -> None:
    told = COMPARED[name](seed)
    assert told.startswith(ALIKE), told


def test_random_structures_stand_and_fall() -> None:
    """The comparisons compare something."""
    found = {l2a.check(polygons(seed)).verdict for seed in range(12)}
    assert len(found - {UNCERTAIN}) > 1
    assert FALLS in found


if __name__ == "__main__":
    for told, compare in COMPARED.items():
        if any(word not in told for word in sys.argv[2:]):
            continue
        results: Counter[str] = Counter()
        for number in range(int(sys.argv[1])):
            results[text := compare(number)] += 1
            if not text.startswith(ALIKE):
                print(told, number, text, flush=True)
        print(told, dict(results), flush=True)
