"""What a hand presses with: forces well inside the joints, and an arm that feels them."""

from __future__ import annotations

import runpy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.contacts import Contacts, find_contacts
from learn2assemble.assembly.hands import Hand
from learn2assemble.cell.pressing import (
    AT_ONCE,
    FARTHEST,
    SHARES,
    TURNS,
    PressingHand,
    contact_force,
)
from learn2assemble.constants import GRAVITY
from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix, rotation_of
from learn2assemble.motion.plant import Guard, Motion, ToolReading
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.inverse import solve
from learn2assemble.robot.kinematics import forward, get_chain
from learn2assemble.statics.block_forces import System
from learn2assemble.statics.states import State

ARCH = Path(__file__).parents[1] / "examples" / "structures" / "arch.py"
STRONG = Hand.within((0.0, 0.0, 0.0), np.vstack([np.eye(6), -np.eye(6)]), np.full(12, 100.0))


def half_arch(placed: int) -> tuple[Assembly, Contacts, State]:
    """Of 21 voussoirs the first ones, the last of them held."""
    arch = runpy.run_path(str(ARCH))["arch"](21, radius=0.5, thickness=0.14)
    state = State(np.zeros(21, bool), np.zeros(21, bool)).change(place=range(placed))
    return arch, find_contacts(arch), state.change(hold=[placed - 1], hand=STRONG)


@pytest.mark.parametrize("placed", [7, 11, 14])
def test_the_forces_balance_every_block_and_leave_no_joint_at_an_edge(placed: int) -> None:
    arch, contacts, state = half_arch(placed)
    system = System(arch, contacts, state.present, state.held, dict(state.hands))
    share = SHARES[0]
    forces = system.centred(arch.friction, share)
    assert forces is not None
    every = system.newtons(forces)
    for patch in np.unique(contacts.patch):
        bears = every[contacts.patch == patch] @ contacts.normal[patch]
        if np.abs(bears).max() > 0:
            assert np.abs(bears).min() >= share * np.abs(bears).mean() * (1 - 1e-4)
            along = every[contacts.patch == patch] - np.outer(bears, contacts.normal[patch])
            assert np.linalg.norm(along, axis=1).max() <= arch.friction * np.abs(bears).max() + 1e-3
    for block in range(placed - 1):
        on = contacts.b[contacts.patch] == block
        off = contacts.a[contacts.patch] == block
        total = every[on].sum(0) - every[off].sum(0)
        weight = GRAVITY * arch.blocks[block].mass
        assert np.abs(total - [0.0, 0.0, weight]).max() < 1e-3 * weight


def test_what_the_held_block_feels_is_what_its_only_neighbour_does_to_it() -> None:
    arch, contacts, state = half_arch(11)
    felt = contact_force(arch, contacts, state, 10)
    assert felt is not None
    # Block 9 presses it away from itself, and hangs on it: the hand bears the rest.
    apart = arch.blocks[10].centroid - arch.blocks[9].centroid
    assert felt @ apart > 0
    assert felt[2] < 0


def test_where_no_hand_can_hold_it_nothing_is_said() -> None:
    arch, contacts, _ = half_arch(11)
    state = State(np.zeros(21, bool), np.zeros(21, bool)).change(place=range(11))
    weak = Hand.within((0.0, 0.0, 0.0), np.vstack([np.eye(6), -np.eye(6)]), np.full(12, 1e-3))
    assert contact_force(arch, contacts, state.change(hold=[10], hand=weak), 10) is None


# ---------------------------------------------------------------- an arm on springs


class Springs:
    """An attempt by an arm whose drives are springs, with its block on a wall that is one, too.

    Args:
        way: float64[3], unit vector into the wall, on which the block just is.
        wall: its stiffness [N/m].
    """

    drives = 2e4

    def __init__(self, way: np.ndarray, wall: float = 1e5) -> None:
        self.way, self.wall, self.arm = way, wall, get_arm("panda", "suction")
        self.joints = self.arm.home.copy()
        """As they are told to be."""
        self.start, self.turn = forward(get_chain(self.arm), self.joints)
        self.rig = SimpleNamespace(plant=self)
        self.felt, self.most = np.zeros(3), 0.0
        self.real = self.joints

    def sense(self) -> SimpleNamespace:
        x, y, z = self.felt.tolist()
        return SimpleNamespace(joints=self.real, tool=ToolReading(force=(x, y, z)))

    def do(self, run: Motion, guards: tuple[Guard, ...]) -> None:
        self.most = max(self.most, float(np.abs(run.joints[1] - run.joints[0]).max()))
        self.joints = run.joints[1]
        told, turn = forward(get_chain(self.arm), self.joints)
        into = max(float(self.way @ (told - self.start)), 0.0)
        back = into * self.wall / (self.wall + self.drives)
        found = solve(self.arm, told - self.way * back, turn, self.joints, restarts=0)
        self.real, self.felt = found.joints, -self.way * (into - back) * self.wall

    @property
    def presses(self) -> float:
        return float(-self.way @ self.felt)


def held(springs: Springs, newtons: float) -> PressingHand:
    """A block of 0.4 kg that is where it shall be, and is to be pressed on the wall."""
    where, turn = forward(get_chain(springs.arm), springs.joints)
    in_hand = np.array([0.0, 0.0, 0.03]), np.eye(3)
    pose = np.array([*(where + turn @ in_hand[0]), *matrix_quaternion(turn)])
    run: Any = springs
    return PressingHand(run, springs.arm, in_hand, pose, springs.way, -newtons * springs.way, 0.4)


@pytest.mark.parametrize("newtons", [2.0, 20.0])
@pytest.mark.parametrize("wall", [2e4, 2e5])
def test_a_hand_presses_until_it_feels_the_force(newtons: float, wall: float) -> None:
    springs = Springs(np.array([0.6, 0.0, -0.8]), wall)
    hold = held(springs, newtons)
    for _ in range(TURNS):
        hold.press()
    assert springs.presses == pytest.approx(newtons, rel=0.05)
    off = forward(get_chain(springs.arm), springs.real)[0] - springs.start
    assert np.abs(off - springs.way * (springs.way @ off)).max() < 5e-5
    for _ in range(TURNS):
        hold.stay()
    assert springs.presses == pytest.approx(newtons, rel=0.1)


def test_where_no_force_is_felt_a_hand_stops() -> None:
    """The block meets nothing, or nothing measures what it meets."""
    springs = Springs(np.array([0.0, 0.0, -1.0]), wall=0.0)
    hold = held(springs, 20.0)
    for _ in range(10 * TURNS):
        hold.press()
    gone = forward(get_chain(springs.arm), springs.real)[0] - springs.start
    assert np.linalg.norm(gone) == pytest.approx(FARTHEST, rel=0.01)
    for _ in range(10 * TURNS):
        hold.ease()
    gone = forward(get_chain(springs.arm), springs.real)[0] - springs.start
    assert np.linalg.norm(gone) < 1.01 * FARTHEST


def test_without_a_force_it_only_keeps_its_place() -> None:
    springs = Springs(np.array([0.0, 0.0, -1.0]))
    hold = held(springs, 20.0)
    kept = PressingHand(hold.run, springs.arm, hold.in_hand, hold.pose, springs.way, None, 0.4)
    for _ in range(TURNS):
        kept.press()
    gone = forward(get_chain(springs.arm), springs.real)[0] - springs.start
    assert np.abs(gone).max() < 2e-5


def test_before_it_lets_go_it_bears_nothing() -> None:
    springs = Springs(np.array([0.0, 0.0, -1.0]))
    hold = held(springs, 20.0)
    for _ in range(TURNS):
        hold.press()
    for _ in range(TURNS):
        hold.ease()
    assert springs.presses == pytest.approx(0.4 * GRAVITY, rel=0.1)


def test_a_block_that_is_off_is_brought_to_its_place_in_small_steps() -> None:
    springs = Springs(np.array([0.0, 0.0, -1.0]))
    hold = held(springs, 0.0)
    meant = rotation_of(np.array([0.0, 0.0, 0.004])) @ quaternion_matrix(hold.pose[3:])
    hold.pose[:2] += [2e-3, -1.5e-3]
    hold.pose[3:] = matrix_quaternion(meant)
    for _ in range(TURNS):
        hold.press()
    where, turn = forward(get_chain(springs.arm), springs.real)
    assert np.abs((where + turn @ hold.in_hand[0] - hold.pose[:3])[:2]).max() < 5e-5
    assert np.abs(turn - meant).max() < 5e-4
    assert springs.most <= AT_ONCE + 1e-12
