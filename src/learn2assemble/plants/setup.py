"""How a plant is opened: the cell as its owner describes it, what is around it, and what goes
otherwise in a simulated one.

World frame: z up, the top of the table at 0; quaternions (w, x, y, z); metres, radians, seconds,
newtons, kilograms.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.errors import InputError, look_up
from learn2assemble.plants.plant import BlockReading, Plant, Request
from learn2assemble.plants.settings import ProgramSettings
from learn2assemble.registry import Registry, add_plugin
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.bodies import Shape
from learn2assemble.robot.studs import Studs


class BlockKind(NamedTuple):
    """What a block is, by the name that it has in the plan."""

    shape: Shape
    density: float
    """[kg/m3]; from :data:`~learn2assemble.robot.moves.IMMOVABLE` on nothing moves it."""


UNWANTED = 2.5
"""See :attr:`Surroundings.feel`."""


def _sleep(seconds: float, came: Callable[[], float]) -> None:
    time.sleep(seconds)


class PlantClock(NamedTuple):
    """By which whoever tells a controller what to do waits for it."""

    now: Callable[[], float] = time.monotonic
    """[s]"""
    wait: Callable[[float, Callable[[], float]], None] = _sleep
    """Returns after so long [s]. It is told what says of when the last state is that has come [s of
    the controller]: a clock that drives its controller waits for what that has sent."""


WALL = PlantClock()
"""Of this machine; a simulated controller may bring its own, which goes on while it is waited
for."""


class Surroundings(NamedTuple):
    """What belongs to a cell beside the controller of its arm; a simulated one needs none of it."""

    program: ProgramSettings = ProgramSettings()
    """Which output and input the tool is wired to, and how far the arm may be from where a motion
    begins."""
    look: Callable[[], Sequence[BlockReading]] | None = None
    """Cameras or tags: called whenever the plant is asked what it senses; None: no block is ever
    seen."""
    pictures: Callable[[], Sequence[Any]] | None = None
    """Takes a depth picture (:class:`~learn2assemble.sensing.camera.DepthPicture`) with each camera
    of the layout, from which it is told where blocks are; ``look`` comes before it."""
    serve: Callable[[Request], None] | None = None
    """Magazines and people: returns when a request has been met; None: all are met at once, as by
    magazines that are never empty."""
    feel: float = 8.0
    """Smallest force that the robot can tell from noise [N]: so much counts as a contact that is
    wanted, and :data:`UNWANTED` times as much as one that is not."""
    trust_placements: bool = False
    """Where nothing sees blocks, they are taken to be where they were put."""
    patience: float = 0.25
    """Longest silence towards the controller before the arm stops by itself [s of its clock]."""
    silence: float = 0.25
    """Longest silence of the controller before it counts as lost [s of ``clock``]."""
    answer: float = 2.0
    """In which a controller has to begin with what it was told [s of its clock]."""
    clock: PlantClock = WALL
    """By which a controller is waited for."""


class Noise(NamedTuple):
    """Of readings: standard deviations, and what becomes of them."""

    place: float = 0.0
    """x and y [m]"""
    turn: float = 0.0
    """About each axis [rad]"""
    height: float | None = None
    """z [m]; None: as x and y."""
    missing: float = 0.0
    """Share of readings of blocks that are missing."""
    outliers: float = 0.0
    """Share that is off by far."""
    late: float = 0.0
    """Share that is as old as the look before."""


class Disturbance(NamedTuple):
    """What goes otherwise than planned in a simulated cell."""

    supply: tuple[float, float] = (0.0, 0.0)
    """Standard deviations of where a presented block stands [m] and of its yaw [rad]."""
    friction: float = 0.0
    """Share by which friction differs, and ..."""
    mass: float = 0.0
    """... largest share by which masses differ."""
    drop: frozenset[int] = frozenset()
    """Numbers of grasps, from 1, after which the block is let go on the way."""
    push: frozenset[int] = frozenset()
    """Numbers of grasps after whose return a block that carries nothing is pushed by 15 mm."""
    table: tuple[float, float] = (0.0, 0.0)
    """Largest height by which the table is off [m], and largest angle it leans by [rad]."""
    height: float = 0.0
    """Largest amount by which blocks are higher or lower than meant [m]."""
    tracking: tuple[float, float] = (0.0, 0.0)
    """By how much joints are elsewhere than they are told: standard deviation of where their
    encoders have zero, one number a joint that stays and that no reading shows [rad], and largest
    error at full speed, which varies slowly, is gone at rest, and which encoders show [rad]."""
    cameras: tuple[tuple[float, ...], ...] = ()
    """By how much each camera of the layout truly is elsewhere, in their order: along the axes of
    the world [m] and a rotation vector about the camera [rad]; left out: it is where it says."""


class Simulated(NamedTuple):
    """What a simulated plant is; others do not look at it."""

    physics: str = "dynamic"
    """``dynamic``, or ``kinematic``: blocks follow the hand and stay where they are let go."""
    seed: int = 0
    noise: Noise = Noise()
    disturbance: Disturbance = Disturbance()


class Setup(NamedTuple):
    """The cell as its owner describes it, that is, as it is meant to be."""

    arm: Arm
    """With its tool, at its place."""
    kinds: Mapping[str, BlockKind]
    """Blocks of the plan by their names."""
    waiting: Mapping[str, np.ndarray]
    """float64[7]: poses of those that lie on the table from the beginning; all others are in
    magazines until they are presented."""
    fixed: tuple[tuple[BlockKind, np.ndarray], ...] = ()
    """Obstacles, and their poses float64[7]."""
    friction: float = 0.5
    """Of blocks on one another and on the table."""
    joints: np.ndarray | None = None
    """float64[n] where the arm stands [rad]; None: at home."""
    studs: Studs | None = None
    """Where blocks clutch: the joints they have where they belong. Their cells are numbers of
    ``kinds``; a block that is called otherwise has those of its kind."""
    around: Surroundings = Surroundings()
    simulated: Simulated = Simulated()
    others: tuple[Arm, ...] = ()
    """Further arms in the same cell, each at home in the beginning."""


PLANTS: Registry[Callable[[str, Setup], Plant]] = Registry("plant", {})
"""What opens a plant, by the scheme of its address: called with what follows ``SCHEME://`` and the
cell as it is meant to be."""
add_plugin("learn2assemble.simulation.plant", "plant")


def check_address(address: str) -> tuple[str, str]:
    """Scheme and place of an address.

    Raises:
        InputError: for an address without a scheme, for a scheme nobody knows, and for a host of
            what is simulated.
    """
    scheme, mark, place = address.partition("://")
    if not mark:
        raise InputError("robot", address, "an address as sim:// or ur://HOST")
    look_up("robot", scheme, PLANTS)
    if scheme == "sim" and place:
        raise InputError("robot", address, "sim:// alone: what is simulated has no host")
    return scheme, place


def open_plant(address: str, setup: Setup) -> Plant:
    """The plant behind an address, as ``sim://`` or ``ur://192.168.0.2``.

    Raises:
        InputError: see :func:`check_address`; also for a place that is none.
        PlantError: where nobody answers, or another arm.
    """
    scheme, place = check_address(address)
    return PLANTS[scheme](place, setup)
