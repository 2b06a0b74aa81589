"""Every state of a plan of blocks, and how far simulated blocks get in it.

What is proven of a state rests on blocks that touch exactly. MuJoCo is the other judge: blocks are
let go all at once with joints that are open by a tenth of a millimetre.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np

from learn2assemble.assembly.blocks import Assembly, Block
from learn2assemble.export.formats import mjcf
from learn2assemble.geometry.hulls import area_vector
from learn2assemble.statics.rigid_blocks import SIDE

GAP = 1e-4
"""Width of the joints that are open [m]."""
SECONDS = 1.0
"""Of every simulation."""
EVERY = 10
"""Steps of the simulation between two looks at where the blocks are."""


def states_of(assembly: Assembly) -> Iterator[Assembly]:
    """What stands after each step, as a structure without steps.

    Props are blocks like others, and what a hand holds is a support. Between putting a block down
    and holding it there is no state: the hand that placed it has it still.
    """
    there = {block.id for block in assembly.blocks if block.support}
    held: set[str] = set()
    for number, step in enumerate(assembly.steps):
        known = held if step.action in ("hold", "release") else there
        (known.add if step.action in ("place", "hold") else known.remove)(step.block)
        if _held_next(assembly, number):
            continue
        blocks = tuple(
            replace(block, prop=False, support=block.support or block.id in held)
            for block in assembly.blocks
            if block.id in there
        )
        yield replace(assembly, blocks=blocks, steps=(), not_built=())


def count_states(assembly: Assembly) -> int:
    """How many :func:`states_of` an assembly gives, which takes time where there are thousands."""
    return sum(not _held_next(assembly, number) for number in range(len(assembly.steps)))


def _held_next(assembly: Assembly, number: int) -> bool:
    """Whether the step after that of a number, from 0, holds the same block."""
    after = assembly.steps[number + 1 : number + 2]
    return bool(after) and after[0].hold == assembly.steps[number].block


def upright(normals: np.ndarray) -> np.ndarray:
    """bool[F]: faces that no weight presses by itself, of unit normals float64[F, 3]."""
    return np.abs(normals[:, 2]) <= SIDE


def every(normals: np.ndarray) -> np.ndarray:
    """bool[F]: all faces, of unit normals float64[F, 3]."""
    return np.ones(len(normals), bool)


def opened(
    assembly: Assembly, gap: float = GAP, which: Callable[[np.ndarray], np.ndarray] = upright
) -> Assembly:
    """An assembly with joints of some width: faces are drawn in by half of it.

    Args:
        assembly: blocks where they stand.
        gap: width of a joint [m].
        which: the faces, of their unit normals float64[F, 3] as bool[F].
    """
    blocks = tuple(_drawn_in(block, gap / 2, which) for block in assembly.blocks)
    return replace(assembly, blocks=blocks)


def _drawn_in(block: Block, depth: float, which: Callable[[np.ndarray], np.ndarray]) -> Block:
    """A block with some of its faces moved inwards; corners of many faces as well as they can."""
    corners = [block.vertices[list(face)] for face in block.faces]
    normals = np.array([area_vector(c) for c in corners])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    moves = np.where(which(normals), -depth, 0.0)
    vertices = block.vertices.copy()
    for k in range(len(vertices)):
        mine = [n for n, face in enumerate(block.faces) if k in face]
        vertices[k] += np.linalg.lstsq(normals[mine], moves[mine], rcond=1e-6)[0]
    return replace(block, vertices=vertices)


def largest_move(assembly: Assembly, seconds: float, ground: bool = False) -> float:
    """Largest distance of any block of the finished structure from its place, at any time of a
    simulation of its MuJoCo model [m].

    Args:
        assembly: blocks where they stand.
        seconds: of the simulation.
        ground: z = 0 is one beside blocks that are supports, too, as those that are held.
    """
    import mujoco

    made = ElementTree.fromstring(mjcf(assembly))
    world = made.find("worldbody")
    assert world is not None
    if ground and world.find("geom[@name='table']") is None:
        # The first geom, where models of blocks on the ground have it.
        plane = ElementTree.Element("geom", name="table", type="plane", size="0 0 0.05")
        world.insert(1, plane)
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(made, encoding="unicode"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    before, worst = data.xpos.copy(), 0.0
    for step in range(1, int(seconds / model.opt.timestep) + 1):
        mujoco.mj_step(model, data)
        if step % EVERY == 0:
            worst = max(worst, float(np.linalg.norm(data.xpos - before, axis=1).max()))
    return worst


def largest_moves(
    assembly: Assembly,
    which: Callable[[np.ndarray], np.ndarray] = upright,
    *,
    gap: float = GAP,
    seconds: float = SECONDS,
    most: int | None = None,
) -> list[float]:
    """Of every state, the largest distance of a block from its place at any time [m].

    Args:
        assembly: blocks and steps.
        which: faces that are drawn in, as of :func:`opened`.
        gap: width of the joints [m].
        seconds: of every simulation.
        most: how many states are looked at, evenly spread, the last one among them; all by default.
    """
    states: list[Assembly] = list(states_of(assembly))
    if most is not None and len(states) > most:
        chosen = np.linspace(0, len(states) - 1, most).round().astype(int)
        states = [states[k] for k in chosen.tolist()]
    # What is held is a support, whose ground is that of all others.
    ground = not any(block.support for block in assembly.blocks)
    return [largest_move(opened(state, gap, which), seconds, ground) for state in states]
