"""Blocks as closed polyhedra, and assemblies of them with the order in which they are placed.

Lengths are metres in the world frame, z up. Values are validated when they are made, so whatever
reaches a solver is finite, closed and has a volume.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Annotated, Any, Literal, TypedDict, Unpack

import numpy as np

from learn2assemble.assembly.hands import Hand
from learn2assemble.assembly.joints import (
    DRY,
    MOST_AGE,
    Joint,
    JointOf,
    joint_of_json,
    joints_of_json,
)
from learn2assemble.assembly.values import Colour, as_colour, coordinates
from learn2assemble.errors import InputError, check_name, is_number
from learn2assemble.geometry.hulls import convex_hull, cross_product
from learn2assemble.values import By

MAX_VERTICES = 20_000
"""Of one block; also the limit of its faces."""
MAX_BLOCKS = 10_000
LARGEST, THINNEST = 1e6, 1e-9
"""Largest coordinate, and volume of a block against the cube of its extent."""
MAX_RATIO = 1e4
"""Of the extents of the largest and the smallest block of one assembly."""
SMALLEST = 1e-6
"""Size and thickness of a block of an assembly, at least [m]."""
FLAT = 1e-6
"""How far a vertex may stand over a face of a convex block, in extents of the block."""


@dataclass(frozen=True, eq=False)
class Block:
    """A closed polyhedron of one density.

    It may be convex, not convex, or several closed shells that touch; see :func:`convex_parts`.

    Args:
        id: unique in an assembly.
        vertices: float64[V, 3] [m, world].
        faces: vertex indices of each face, counter-clockwise seen from outside.
        kind: the kind of a kit it is of, or "".
        density: [kg/m³].
        support: it is fixed to the ground, or part of it.
        prop: it is temporary.
        colour: red, green, blue, 0..255.

    Raises:
        InputError: naming the block, where it is open, flat, inside out, or not finite.
    """

    id: str
    vertices: Annotated[np.ndarray, By(coordinates)]
    faces: tuple[tuple[int, ...], ...]
    kind: str = ""
    density: float = 1000.0
    support: bool = False
    prop: bool = False
    colour: Colour | None = None

    def __post_init__(self) -> None:
        # Files and callers may give anything here.
        known = isinstance(self.id, str)  # pyright: ignore[reportUnnecessaryIsInstance]
        if not known or not 0 < len(self.id) <= 200:
            raise InputError("block id", self.id, "a text of 1 to 200 characters")
        where = f"block {self.id!r}"
        if not is_number(self.density, 0, LARGEST) or self.density == 0:
            raise InputError(f"{where}: density", self.density, "a number in (0, 1e6] [kg/m3]")
        if not isinstance(self.kind, str):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise InputError(f"{where}: kind", self.kind, "a text")
        for name in ("support", "prop"):
            value: Any = getattr(self, name)
            if type(value) not in (bool, np.bool_):
                raise InputError(f"{where}: {name}", value, "True or False")
            object.__setattr__(self, name, bool(value))
        if self.colour is not None:
            object.__setattr__(self, "colour", as_colour(self.colour, f"{where}: colour"))
        vertices = _vertices(self.vertices, where)
        try:
            faces = tuple(tuple(int(k) for k in face) for face in self.faces)
        except (TypeError, ValueError):
            raise InputError(f"{where}: faces", self.faces, "lists of vertex numbers") from None
        _check_faces(faces, len(vertices), where)
        vertices.setflags(write=False)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)
        size = self.extent
        if not self.volume > THINNEST * size**3:
            inside_out = self.volume < -THINNEST * size**3
            expected = "faces counter-clockwise from outside" if inside_out else "more than 0"
            raise InputError(f"{where}: volume", self.volume, expected)

    @cached_property
    def extent(self) -> float:
        """The largest of its extents along the axes [m]."""
        return float((self.vertices.max(0) - self.vertices.min(0)).max())

    @cached_property
    def _moments(self) -> tuple[float, np.ndarray]:
        """Volume and centroid from the tetrahedra between a vertex and every face."""
        origin = self.vertices[0]
        corners = fan_triangles(self.vertices - origin, self.faces)
        six = np.einsum("ij,ij->i", corners[:, 0], cross_product(corners[:, 1], corners[:, 2]))
        total = six.sum()
        if abs(total) < 1e-300:
            return 0.0, origin
        return float(total) / 6, origin + six @ corners.sum(1) / (4 * total)

    @property
    def volume(self) -> float:
        """[m³]."""
        return self._moments[0]

    @property
    def centroid(self) -> np.ndarray:
        """float64[3]: centre of mass [m]."""
        return self._moments[1]

    @property
    def mass(self) -> float:
        """[kg]."""
        return self.volume * self.density

    @property
    def thickness(self) -> float:
        """The volume over half of the surface, which of a plate is how thick it is [m]."""
        a, b, c = fan_triangles(self.vertices, self.faces).swapaxes(0, 1)
        surface = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2
        return 2 * self.volume / surface

    @cached_property
    def is_convex(self) -> bool:
        """Whether no vertex stands over any face."""
        corners = fan_triangles(self.vertices, self.faces)
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normal, axis=1)
        solid = length > 1e-12 * length.max()
        normal, foot = normal[solid] / length[solid, None], corners[solid, 0]
        over = self.vertices @ normal.T - np.einsum("ij,ij->i", normal, foot)
        return bool(over.max() <= FLAT * self.extent)


Action = Literal["place", "remove", "hold", "release"]
"""What a step does to a block."""


@dataclass(frozen=True)
class AssemblyStep:
    """One step of building: exactly one of the ids is given.

    Args:
        place: the block that is put to its place.
        remove: the block that is taken away.
        hold: the block, in its place, that a hand holds from now on.
        release: the block that the hand lets go.
        by_hand: whether a person does it while an arm waits; None where all is done alike.
        way: of a brick that clutches and does not come from above: ``"below"``; ``"beside"``, it
            is built on another one beside, and brought with it.
        wait: hours that one waits before the step, until the mortar of all that stands holds.
        hand: of a step that holds, what the hand can give; without it, it bears any load.
        arm: the arm that does it, where there are several.
    """

    place: str | None = None
    remove: str | None = None
    hold: str | None = None
    release: str | None = None
    by_hand: bool | None = None
    way: Literal["below", "beside"] | None = None
    wait: float | None = None
    hand: Hand | None = None
    arm: str | None = None

    def __post_init__(self) -> None:
        given = [self.place, self.remove, self.hold, self.release]
        if sum(id_ is not None for id_ in given) != 1:
            expected = "one block, to place, remove, hold or release"
            raise InputError("step", tuple(id_ for id_ in given if id_ is not None), expected)
        if self.way is not None:
            check_name("step: way", self.way, ("below", "beside"))
        if self.wait is not None and not is_number(self.wait, 0.0, MOST_AGE):
            raise InputError("step: wait", self.wait, f"0 to {MOST_AGE:g} h")
        if self.hand is not None and self.hold is None:
            raise InputError("step: hand", f"a step that does {self.action}", "a step that holds")

    @property
    def action(self) -> Action:
        """What is done."""
        if self.place is not None:
            return "place"
        if self.remove is not None:
            return "remove"
        return "hold" if self.hold is not None else "release"

    @property
    def block(self) -> str:
        """The id of the block it is done to."""
        return self.place or self.remove or self.hold or self.release or ""


@dataclass(frozen=True, eq=False)
class Assembly:
    """Blocks where they stand when all are placed, and the steps in which they are.

    Args:
        blocks: with distinct ids.
        steps: in order; empty where it is not known. Props are removed again by a step, and so are
            blocks that stood from the start and do not stay.
        friction: Coulomb coefficient of every contact.
        not_built: ids of blocks that are wanted and that no step places, of steps that do not
            finish the structure. Any other block that no step places, or that one removes before,
            stands from the start.
        joint: how its joints hold.
        joints: other laws of single joints, before ``joint``; the last one that fits counts.

    Raises:
        InputError: for ids that repeat, steps that place or remove what they cannot, a friction
            that is not a number >= 0, a name that is no text, blocks that are thinner than
            :data:`SMALLEST` or of absurdly different sizes, or blocks that are placed and not
            built.
    """

    blocks: tuple[Block, ...]
    steps: tuple[AssemblyStep, ...] = ()
    friction: float = 0.5
    name: str = ""
    not_built: tuple[str, ...] = ()
    joint: Annotated[Joint, By(joint_of_json)] = DRY
    joints: Annotated[tuple[JointOf, ...], By(joints_of_json)] = ()
    _index: dict[str, int] = field(init=False, repr=False, metadata={"file": False})

    def __post_init__(self) -> None:
        for name, kind in (
            ("blocks", Block),
            ("steps", AssemblyStep),
            ("not_built", str),
            ("joints", JointOf),
        ):
            given: Any = getattr(self, name)
            listed: object = given  # Callers may give anything.
            if not isinstance(listed, Sequence) or not all(isinstance(one, kind) for one in given):
                raise InputError(name, given, f"a list of {kind.__name__}s")
            object.__setattr__(self, name, tuple(given))
        if not 0 < len(self.blocks) <= MAX_BLOCKS:
            raise InputError("blocks", len(self.blocks), f"1 to {MAX_BLOCKS} blocks")
        check_friction(self.friction)
        if not isinstance(self.name, str):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise InputError("name", self.name, "a text")
        if not isinstance(self.joint, Joint):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise InputError("joint", self.joint, "a Joint")
        index = {block.id: k for k, block in enumerate(self.blocks)}
        if len(index) < len(self.blocks):
            twice = Counter(block.id for block in self.blocks).most_common(1)[0][0]
            raise InputError("block id", twice, "every id once")
        object.__setattr__(self, "_index", index)
        sizes = [block.extent for block in self.blocks]
        for block, size in zip(self.blocks, sizes, strict=True):
            thin = block.volume < 3 * SMALLEST * size**2 and block.thickness < SMALLEST
            if size < SMALLEST or thin:
                got = block.thickness if thin else size
                raise InputError(f"block {block.id!r}: thickness", got, f"at least {SMALLEST} m")
        if max(sizes) > MAX_RATIO * min(sizes):
            small = self.blocks[int(np.argmin(sizes))].id
            raise InputError(
                f"block {small!r}: size", min(sizes), f"at least 1/{MAX_RATIO:.0f} of the largest"
            )
        # What is taken away before it is placed stands from the start.
        first = {step.block: step.action for step in reversed(self.steps)}
        standing = {id_ for id_, action in first.items() if action == "remove"}
        held: set[str] = set()
        for number, step in enumerate(self.steps):
            where, id_, action = f"steps[{number}]", step.block, step.action
            if id_ not in index:
                raise InputError(where, id_, "the id of a block")
            if (id_ in standing) == (action == "place"):
                raise InputError(where, id_, "a new one" if step.place else "a block in its place")
            if action != "place" and (id_ in held) != (action == "release"):
                raise InputError(
                    where, id_, f"a block that is {'' if step.release else 'not '}held"
                )
            standing ^= {id_} if action in ("place", "remove") else set()
            held ^= {id_} if action in ("hold", "release") else set()
        placed = {step.place for step in self.steps}
        for number, id_ in enumerate(self.not_built):
            if id_ not in index or id_ in placed:
                expected = "the id of a block that no step places"
                raise InputError(f"not_built[{number}]", id_, expected)
        named = [id_ for one in self.joints for id_ in one.blocks or ()]
        unknown = [id_ for id_ in named if id_ not in index]
        if unknown:
            raise InputError("joints", unknown[0], "the id of a block")
        if len(self.not_built) >= len(self.blocks):
            raise InputError("not_built", len(self.not_built), "fewer than all blocks")

    @property
    def holds(self) -> bool:
        """Whether any of its joints can pull."""
        return any(joint.holds for joint in self.laws)

    @property
    def laws(self) -> tuple[Joint, ...]:
        """The laws of its joints, that of most of them first."""
        return (self.joint, *(one.joint for one in self.joints))

    @property
    def age(self) -> float:
        """Hours until all mortar holds that is laid at one time; 0 where none is, or at once."""
        mortars = (joint for joint in self.laws if joint.law == "mortar" and joint.holds)
        return max((joint.age for joint in mortars), default=0.0)

    def with_capacity(self, capacity: float) -> Assembly:
        """The same with clutches of another capacity [N]; other laws stay.

        Raises:
            InputError: where no joint is a clutch, or for a capacity that is none.
        """
        if all(joint.law != "clutch" for joint in self.laws):
            raise InputError("capacity", capacity, "an assembly whose joints clutch (`kit=lego`)")

        def changed(joint: Joint) -> Joint:
            return replace(joint, capacity=capacity) if joint.law == "clutch" else joint

        joints = tuple(replace(one, joint=changed(one.joint)) for one in self.joints)
        return replace(self, joint=changed(self.joint), joints=joints)

    def as_far_as_placed(self, first: Iterable[str] = ()) -> Assembly:
        """The same where free blocks that no step places are not built; itself without steps, but
        where something stands before the first one.

        Args:
            first: ids of the blocks that stand before the first step.
        """
        there = set(first)
        placed = there | {step.place for step in self.steps}
        left = tuple(b.id for b in self.blocks if b.id not in placed and not b.support)
        return replace(self, not_built=left) if self.steps or there else self

    def block(self, id_: str) -> Block:
        """The block called ``id_``."""
        return self.blocks[self.index(id_)]

    def index(self, id_: str) -> int:
        """Where in ``blocks`` the block called ``id_`` is."""
        if id_ not in self._index:
            raise InputError("block id", id_, "the id of a block of the assembly")
        return self._index[id_]

    @property
    def at_first(self) -> tuple[bool, ...]:
        """Of each block, whether it stands before the first step."""
        first = dict.fromkeys(self.not_built, "place")
        first |= {step.block: step.action for step in reversed(self.steps)}
        return tuple(first.get(block.id) != "place" for block in self.blocks)

    @cached_property
    def finished(self) -> Assembly:
        """What stands after the last step: without removed blocks and those that are not built,
        and without steps.

        Without steps, every block stands but the props.
        """
        standing = {block.id: not (block.prop and not self.steps) for block in self.blocks}
        for step in self.steps:
            standing[step.block] = step.action != "remove"
        standing |= dict.fromkeys(self.not_built, False)
        if all(standing.values()):
            return replace(self, steps=()) if self.steps else self
        here = tuple(block for block in self.blocks if standing[block.id])
        kept = tuple(one for one in self.joints if all(standing[id_] for id_ in one.blocks or ()))
        return replace(self, blocks=here, steps=(), not_built=(), joints=kept)


def hull_block(id: str, points: Sequence[Sequence[float]] | np.ndarray, **kwargs: Any) -> Block:
    """The convex hull of points as a block, each of its plane faces as one polygon.

    Args:
        id: of the block.
        points: float64[N, 3], at least four that lie in no plane [m, world].
        kwargs: further fields of :class:`Block`.

    Raises:
        InputError: where the points lie in a plane, or are no points.
    """
    where = f"block {id!r}"
    given = _vertices(points, where)
    try:
        corners, faces = convex_hull(given)
    except ValueError:
        raise InputError(f"{where}: points", "points in a plane", "a hull with volume") from None
    return Block(id, corners, faces, **kwargs)


def check_friction(friction: float) -> None:
    """Refuse what is no Coulomb coefficient."""
    kinds = int, float, np.floating  # Callers may give anything.
    number = isinstance(friction, kinds)  # pyright: ignore[reportUnnecessaryIsInstance]
    number = number and not isinstance(friction, bool)
    if not number or not 0 <= friction <= 10:
        raise InputError("friction", friction, "a number from 0 to 10")


def fan_triangles(vertices: np.ndarray, faces: Sequence[Sequence[int]]) -> np.ndarray:
    """float64[T, 3, 3]: triangles from the first corner of each face.

    Their signed sums are right for any face; as surface they serve only where faces are convex.
    """
    return vertices[_fans(tuple(map(tuple, faces)))]


@lru_cache(maxsize=64)
def _fans(faces: tuple[tuple[int, ...], ...]) -> np.ndarray:
    """int64[T, 3]: the corners of the triangles. Blocks by the thousand have the same ones."""
    return np.array([(f[0], f[k], f[k + 1]) for f in faces for k in range(1, len(f) - 1)])


def _vertices(vertices: Sequence[Sequence[float]] | np.ndarray, where: str) -> np.ndarray:
    try:
        array = np.array(vertices, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{where}: vertices", vertices, "numbers of shape (V, 3)") from None
    if array.ndim != 2 or array.shape[1] != 3 or not 4 <= len(array) <= MAX_VERTICES:
        raise InputError(f"{where}: vertices", array.shape, f"shape (4..{MAX_VERTICES}, 3)")
    farthest = float(np.abs(array).max())
    if not math.isfinite(farthest):
        raise InputError(f"{where}: vertices", "NaN or infinity", "finite coordinates")
    if farthest > LARGEST:
        raise InputError(f"{where}: vertices", farthest, "at most 1e6 [m]")
    return array


def _check_faces(faces: tuple[tuple[int, ...], ...], count: int, where: str) -> None:
    fault = _fault_of(faces, count)
    if fault is not None:
        what, got, expected = fault
        raise InputError(f"{where}: {what}", got, expected)


@lru_cache(maxsize=64)
def _fault_of(
    faces: tuple[tuple[int, ...], ...], count: int
) -> tuple[str, int | tuple[int, ...], str] | None:
    """What is wrong with the faces of a block: which, what it is and what it should be. Blocks by
    the thousand have the same ones."""
    if not 4 <= len(faces) <= MAX_VERTICES:
        return "faces", len(faces), f"4 to {MAX_VERTICES} faces"
    edges: Counter[tuple[int, int]] = Counter()
    for number, face in enumerate(faces):
        if len(face) < 3 or min(face) < 0 or max(face) >= count:
            return f"faces[{number}]", face, f"3 or more vertex numbers in 0..{count - 1}"
        edges.update(zip(face, (*face[1:], face[0]), strict=True))
    for (start, end), times in edges.items():
        if start == end or edges[end, start] != times:
            expected = "a closed surface, every edge once in each direction"
            return "edge between vertices", (start, end), expected
    return None


class BlockRest(TypedDict, total=False):
    """What a :class:`Block` has besides its name and its surface."""

    kind: str
    density: float
    support: bool
    prop: bool


def outward(
    id: str,
    vertices: np.ndarray,
    faces: tuple[tuple[int, ...], ...],
    **kwargs: Unpack[BlockRest],
) -> Block:
    """A block whose faces may all be turned inside; arguments as :class:`Block`."""
    try:
        return Block(id, vertices, faces, **kwargs)
    except InputError as error:
        if not error.what.endswith(": volume"):
            raise
    return Block(id, vertices, tuple(face[::-1] for face in faces), **kwargs)


def check_count(count: int, source: str) -> None:
    """Refuse a file of no blocks, or of too many."""
    if not 0 < count <= MAX_BLOCKS:
        raise InputError(f"{source}: blocks", count, f"1 to {MAX_BLOCKS} blocks")
