"""What is reached with blocks that are given, measured: ``results/structures.json``.

Order with supports and proof, checks, the fewest posts, every state against MuJoCo, and meshes that
are built of bricks (:mod:`.meshes`). ``seconds``
are of the processor, so that other programs on the machine do not count.
"""

from __future__ import annotations

import runpy
import time
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from l2a_lab.designs import recorded
from l2a_lab.fewest_posts import fewest_posts, random_assembly
from l2a_lab.measured import Figures, Result, by_kind
from l2a_lab.meshes import MESHES, mesh_entry, mesh_rows
from l2a_lab.rebuilding import CARRIED, PAIRS, RATIO, carried_entry, rebuild_entry
from l2a_lab.states import GAP, count_states, every, largest_moves
from l2a_lab.states import SECONDS as SIMULATED
from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.cuts import POST
from learn2assemble.assembly.files import from_json
from learn2assemble.assembly.instructions.words import count_words
from learn2assemble.files import read_json_lines
from learn2assemble.planning.given import plan_assembly
from learn2assemble.planning.plan import Plan
from learn2assemble.statics.rigid_blocks import check

CARRIERS = {"carried": 1, "carried-two": 2}
"""How many arms turn one structure into another."""
STRUCTURES, REFERENCE = Path("examples/structures"), Path("../shared/reference")
SECONDS = 600.0
"""Limit of a plan."""
PILES, RANDOM = 40, 40
STONES = 20
LIMIT = 1e-3
"""How far a block may get in the simulation of a state [m]."""
MOST_STATES = 40
"""States of a large structure that are simulated, evenly spread."""


class Case(NamedTuple):
    """A structure, and what is asked of its order."""

    make: Callable[[], Assembly]
    seconds: float
    """Asked, of the processor."""
    posts: int | None = None
    """Asked, at most at once."""
    holds: int = 0
    file: Path = STRUCTURES
    """What it is made from."""


def script(file: str, function: str, **arguments: Any) -> Callable[[], Assembly]:
    """What makes an example of given blocks."""
    return lambda: runpy.run_path(str(STRUCTURES / f"{file}.py"))[function](**arguments)


VAULT, ARMADILLO = REFERENCE / "crossvault.json.gz", REFERENCE / "masonry_armadillo.json.gz"


def cross_vault() -> Assembly:
    """The recorded cross vault of 184 voussoirs."""
    return from_json(next(read_json_lines(VAULT, "assembly")))


def armadillo() -> Assembly:
    """The recorded shell of 399 blocks."""
    return recorded(ARMADILLO)[0][1]


_ARCHES = {
    9: script("arch", "arch", voussoirs=9),
    21: script("arch", "arch", voussoirs=21, radius=0.5, thickness=0.14),
}
ORDERS: dict[str, Case] = {
    "turned wall, 64 bricks": Case(script("turned_wall", "turned_wall", bricks=64), 0.5),
    "turned wall, 500 bricks": Case(script("turned_wall", "turned_wall", bricks=500), 5),
    "turned wall, 2,000 bricks": Case(script("turned_wall", "turned_wall", bricks=2000), 45),
    "arch, 9 voussoirs": Case(_ARCHES[9], 1, posts=4),
    "arch, 21 voussoirs": Case(_ARCHES[21], 1, posts=6),
    "arch, 9 voussoirs, one hold": Case(_ARCHES[9], 1, posts=0, holds=1),
    "arch, 21 voussoirs, one hold": Case(_ARCHES[21], 1, posts=0, holds=1),
    "barrel vault, 10 x 9": Case(script("vaults", "barrel_vault"), 30),
    "dome, 121 voussoirs": Case(script("dome", "dome"), 30),
    "spiral stair, 24 steps": Case(script("spiral_stair", "spiral_stair"), 30),
    "cross vault, 184 voussoirs": Case(cross_vault, 60, file=VAULT),
    "armadillo, 399 blocks": Case(armadillo, 240, file=ARMADILLO),
}
STATES = (
    "turned wall, 64 bricks",
    "arch, 9 voussoirs",
    "arch, 9 voussoirs, one hold",
    "arch, 21 voussoirs",
    "barrel vault, 10 x 9",
    "dome, 121 voussoirs",
    "spiral stair, 24 steps",
)
"""Of these every state is simulated, or as many as there is time for."""
CHECKS: dict[str, Case] = {
    "cross vault, 184 voussoirs": Case(cross_vault, 1, file=VAULT),
    "armadillo, 399 blocks": Case(armadillo, 3, file=ARMADILLO),
}


def names() -> list[str]:
    """Every measurement: kind / structure or seed. Recorded ones where their files are."""
    found = [f"order/{name}" for name, case in ORDERS.items() if case.file.exists()]
    found += [f"check/{name}" for name, case in CHECKS.items() if case.file.exists()]
    found += [f"mesh/{name}" for name in MESHES]
    found += [f"posts/{seed}" for seed in range(RANDOM)]
    found += [f"pile/{seed}" for seed in range(PILES)]
    found += [f"rebuild/{seed}" for seed in range(PAIRS)]
    found += [f"{kind}/{seed}" for kind in CARRIERS for seed in range(CARRIED)]
    return found + [f"states/{name}" for name in STATES if ORDERS[name].file.exists()]


def configuration() -> Result:
    """Limits, and how states are simulated."""
    return {
        "seconds_limit": SECONDS,
        "stones": STONES,
        "joints_m": GAP,
        "simulated_s": SIMULATED,
        "states_of_a_structure_at_most": MOST_STATES,
    }


def entry(name: str) -> Result:
    """One measurement by its name."""
    kind, _, what = name.partition("/")
    if kind == "order":
        return order_entry(ORDERS[what])
    if kind == "check":
        return check_entry(CHECKS[what])
    if kind == "states":
        return states_entry(ORDERS[what])
    if kind == "mesh":
        return mesh_entry(what)
    if kind == "rebuild":
        return rebuild_entry(int(what))
    if kind in CARRIERS:
        return carried_entry(int(what), CARRIERS[kind])
    return pile_entry(int(what)) if kind == "pile" else posts_entry(int(what))


@cache
def _warm() -> None:
    """Plan and check something small, which loads and compiles what they use."""
    for holds in (0, 1):
        plan_assembly(script("arch", "arch", voussoirs=5)(), holds=holds)
    # What a stair takes and an arch does not.
    plan_assembly(script("spiral_stair", "spiral_stair", steps=6)())
    check(script("arch", "arch", voussoirs=5)())


# ---------------------------------------------------------------- entries


def _planned(assembly: Assembly, holds: int = 0) -> tuple[Plan, Result]:
    """Order, supports and proof, and what there is to say about them."""
    _warm()
    started = time.process_time()
    plan = plan_assembly(assembly, holds=holds, seconds=SECONDS)
    seconds = time.process_time() - started
    made = plan.assembly
    assert made is not None
    kinds = {block.id: block.kind for block in made.blocks}
    posts = [(s.action, s.block) for s in made.steps if kinds[s.block] == POST]
    return plan, {
        "status": plan.status,
        "reason": plan.reason or "",
        "blocks": len(assembly.blocks),
        "placed": plan.blocks.used,
        "steps": len(plan.steps),
        "states": count_states(made),
        "seconds": round(seconds, 3),
        "posts": len({block for _, block in posts}),
        "posts_at_once": _most([action for action, _ in posts], "place", "remove"),
        "held_at_once": _most([s.action for s in made.steps], "hold", "release"),
        "margin_g": min((s.margin_g for s in plan.steps if s.margin_g is not None), default=None),
        "proofs": dict(Counter(step.proof for step in plan.steps)),
    }


def _most(actions: list[str], more: str, less: str) -> int:
    """The largest number of blocks at once, where one action adds one and another takes one."""
    count = most = 0
    for action in actions:
        count += (action == more) - (action == less)
        most = max(most, count)
    return most


def order_entry(case: Case) -> Result:
    """Order, supports and proof of one structure."""
    _, result = _planned(case.make(), case.holds)
    return result | {"seconds_asked": case.seconds, "posts_asked": case.posts}


def check_entry(case: Case) -> Result:
    """Whether all blocks together stand; the margin is found when it is asked for."""
    assembly = case.make()
    _warm()
    started = time.process_time()
    found = check(assembly)
    verdict, told = found.verdict, time.process_time()
    return {
        "verdict": verdict,
        "verdict_s": round(told - started, 3),
        "proof": found.proof,
        "margin_g": found.margin_g,
        "blocks": found.blocks,
        "seconds": round(time.process_time() - started, 3),
        "seconds_asked": case.seconds,
    }


def posts_entry(seed: int) -> Result:
    """The posts of a small random assembly, and the fewest by trying everything."""
    assembly = random_assembly(seed)
    _, result = _planned(assembly)
    return result | {"fewest_posts": fewest_posts(assembly)}


def pile_entry(seed: int) -> Result:
    """A pile of laid stones: its order, and how far stones get in each of its states.

    Where stones touch at points there are no joints to open; all faces drawn in are stones that lie
    0.1 mm above one another, so this move has their way down in it.
    """
    pile = script("stones", "stones", count=STONES, seed=seed, laid=True)()
    plan, result = _planned(pile)
    assert plan.assembly is not None
    moves = largest_moves(plan.assembly)
    result |= {"simulated": len(moves), "largest_move_m": round(max(moves, default=0.0), 6)}
    moves = largest_moves(plan.assembly, every)
    return result | {"largest_move_all_faces_m": round(max(moves, default=0.0), 6)}


def states_entry(case: Case) -> Result:
    """How far blocks get in the states of a plan."""
    plan, result = _planned(case.make(), case.holds)
    assert plan.assembly is not None
    moves = largest_moves(plan.assembly, most=MOST_STATES)
    return result | {"simulated": len(moves), "largest_move_m": round(max(moves), 6)}


# ---------------------------------------------------------------- in words


def summary(entries: dict[str, Result]) -> list[tuple[str, str, str]]:
    """What was asked, and what was reached: (what, asked, got)."""
    rows: list[tuple[str, str, str]] = []
    groups = by_kind(entries)
    for name, one in groups["order"].items():
        asked, got = f"<= {one['seconds_asked']:g} s", f"{one['seconds']:.1f} s, {one['status']}"
        if one["posts_asked"] is not None:
            asked += f", <= {one['posts_asked']} posts at once"
        got += f", {one['posts_at_once']} posts and {one['held_at_once']} held at once"
        rows.append((name, asked, got + (f" ({one['reason']})" if one["reason"] else "")))
    for name, one in groups["check"].items():
        got = f"{one['seconds']:.1f} s, {one['verdict']}"
        rows.append((f"check: {name}", f"<= {one['seconds_asked']:g} s", got))
    rows += mesh_rows(groups["mesh"])
    if posts := groups["posts"]:
        known = {name: one for name, one in posts.items() if one["fewest_posts"] is not None}
        same = [
            name
            for name, one in known.items()
            if one["status"] == "complete" and one["posts"] == one["fewest_posts"]
        ]
        left = ", ".join(sorted(set(known) - set(same), key=int)) or "none"
        rows.append(("fewest posts", "all", f"{len(same)} of {len(known)}; not: {left}"))
    if piles := groups["pile"]:
        rows += _pile_rows(piles)
    if pairs := groups["rebuild"]:
        rows += _pair_rows(pairs)
    for kind, arms in CARRIERS.items():
        if carried := groups[kind]:
            rows.append(
                (
                    f"pairs carried out by {count_words(arms, 'arm')}",
                    "all",
                    _carried_words(carried),
                )
            )
    for name, one in groups["states"].items():
        got = f"{1e3 * one['largest_move_m']:.3f} mm, {one['simulated']} of {one['states']} states"
        rows.append((f"MuJoCo: {name}", f"<= {1e3 * LIMIT:g} mm", got))
    return rows


def _carried_words(carried: dict[str, Result]) -> str:
    done = [one for one in carried.values() if one["status"] == "complete"]
    got = f"{len(done)} of {len(carried)} complete"
    if not done:
        return got
    tried = sum(one["attempts"] for one in done) / sum(one["steps"] for one in done)
    worst = 1e3 * max(one["error_worst"] for one in done)
    return f"{got}, {tried:.3f} attempts a step, {worst:.2f} mm at most"


def _pile_rows(piles: dict[str, Result]) -> list[tuple[str, str, str]]:
    done = [name for name, one in piles.items() if one["status"] == "complete"]
    left = ", ".join(sorted(set(piles) - set(done), key=int)) or "none"
    rows = [("piles", "all", f"{len(done)} of {len(piles)} with every state proven; not: {left}")]
    for key, words in (("largest_move_m", ""), ("largest_move_all_faces_m", ", all faces")):
        moves = {name: one[key] for name, one in piles.items()}
        more = ", ".join(name for name in sorted(moves, key=int) if moves[name] > LIMIT) or "none"
        got = f"{1e3 * max(moves.values()):.3f} mm at most; more in: {more}"
        rows.append((f"MuJoCo: piles{words}", f"<= {1e3 * LIMIT:g} mm", got))
    return rows


def _pair_rows(pairs: dict[str, Result]) -> list[tuple[str, str, str]]:
    proven = [
        name
        for name, one in pairs.items()
        if one["status"] == "complete" and not one["states_that_fall"]
    ]
    ratio = {name: pairs[name]["moves"] / max(pairs[name]["moves_bound"], 1) for name in proven}
    few = [name for name in proven if ratio[name] <= RATIO]
    left = ", ".join(sorted(set(pairs) - set(few), key=int)) or "none"
    worst = f"; {max(ratio.values()):.3f} at most" if ratio else ""
    return [
        ("one design into another", "all", f"{len(proven)} of {len(pairs)} with all states proven"),
        (
            "moves over their bound",
            f"<= {RATIO:g}",
            f"{len(few)} of {len(pairs)}{worst}; not: {left}",
        ),
    ]


FIGURES = Figures("learn2assemble-structure-figures", names, entry, configuration, summary)
