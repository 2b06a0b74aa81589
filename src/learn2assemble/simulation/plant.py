"""The simulated cell as a plant (``sim://``): arms and blocks together in MuJoCo.

It holds what is really the case and gives away readings.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from learn2assemble.plants.plant import Commands, Guards, Motion, Plant, Readings, Report
from learn2assemble.plants.setup import Setup
from learn2assemble.registry import Registry
from learn2assemble.simulation.arm_plant import ArmPlant
from learn2assemble.simulation.bench import Bench
from learn2assemble.simulation.dynamic_world import ArmInCell, DynamicWorld
from learn2assemble.simulation.kinematic_plant import KinematicPlant
from learn2assemble.simulation.simulation import NOBODY, SimulatedState, Simulation, Trace

STILL = 1e-4
"""Nothing comes of what is slower than this [m/s], [rad/s]."""


def register_plant(table: Registry[Any]) -> None:
    """Add ``sim://`` to the plants."""

    def made(_: str, setup: Setup) -> Plant:
        return simulated(setup)

    table.register("sim", made)


def simulated(setup: Setup) -> Plant:
    """The simulated plant that a setup asks for."""
    kinds = {"dynamic": DynamicPlant, "kinematic": KinematicPlant}
    return kinds[setup.simulated.physics](setup)


class DynamicPlant(DynamicWorld):
    """Arms and blocks, simulated together. As a plant it is its first arm; all of them are
    :attr:`plants`.

    A motion may be told piece by piece, as a controller is told of it cycle by cycle: each begins
    at the joints and with the velocity with which the one before has ended, and the world goes on
    in between from where it is. :meth:`stop` brakes an arm that was left moving.

    Args:
        setup: as things are meant to be.
    """

    plants: tuple[ArmPlant, ...]  # pyright: ignore[reportIncompatibleVariableOverride]
    simulated: SimulatedState
    acting: ArmInCell
    piecewise: bool = True

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        start = setup.arm.home if setup.joints is None else setup.joints
        starts = [start, *(arm.home for arm in setup.others)]
        self._begin([joints.copy() for joints in starts], [0.0] * len(starts), 0)

    def _begin(self, joints: list[np.ndarray], widths: list[float], begun: int) -> None:
        """All arms stand at joints float64[n] [rad], nothing is free to move."""
        self.simulated = self._state(set(), begun)
        self.plants = tuple(  # pyright: ignore[reportIncompatibleVariableOverride]
            ArmPlant(self, Simulation(self.simulated, arm, q, width, NOBODY, Trace(), number))
            for number, (arm, q, width) in enumerate(zip(self.arms, joints, widths, strict=True))
        )
        self.acting = self.plants[0]
        self._clutch([NOBODY] * len(self.plants))

    @property
    def bench(self) -> Bench:
        """Of the first arm."""
        return self.plants[0].bench

    def sense(self) -> Readings:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        return self.plants[0].sense()

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        return self.plants[0].execute(motion, commands, guards)

    def stop(self) -> None:
        """See :class:`~learn2assemble.plants.plant.Plant`: an arm that moves brakes as soon as its
        limits allow."""
        self.plants[0].stop()

    def held(self) -> str | None:
        """The block in the hand; for reports of a simulation only."""
        return self.plants[0].held()

    def measured(self) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`~learn2assemble.simulation.arm_plant.ArmPlant`."""
        return self.plants[0].measured()

    @property
    def time(self) -> float:
        """Of the clock of the cell [s]."""
        return self.simulated.time

    def loosen(self) -> None:
        """From now on every block may move; those that no motion touches are held still else."""
        if not set(self.things) <= set(self.number):
            self.enter(set(self.things))

    def rests(self) -> bool:
        """Whether nothing moves, so that nothing would change if time passed."""
        told = any(one.bench.sim.velocity.any() for one in self.plants)
        return not told and float(np.abs(self.simulated.data.qvel).max()) < STILL

    def where(self) -> np.ndarray:
        """See :class:`SimulatedCell`."""
        return self.plants[0].where()

    def state(self) -> dict[str, Any]:
        """See :class:`SimulatedCell`."""
        sims = [one.bench.sim for one in self.plants]
        more: dict[str, Any] = {
            "joints": sims[0].joints.tolist(),
            "width": float(sims[0].width),
            "steps": self.simulated.steps,
            "held": [name for name in (one.held() for one in self.plants) if name],
        }
        if self.setup.others:
            more["others"] = [[sim.joints.tolist(), float(sim.width)] for sim in sims[1:]]
        return super().state() | more

    def restore(self, state: dict[str, Any]) -> None:
        """See :class:`SimulatedCell`; what was in a hand has been taken out of it, and no vacuum
        is on."""
        super().restore(state)
        for name in state.get("held", ()):
            self.things.pop(name)
        arms = [(state["joints"], state["width"]), *state.get("others", ())]
        joints, widths = zip(*arms, strict=True)
        # A cup that goes on drawing takes hold of whatever it comes to, before it is told to.
        widths = [0.0 if a.suction else w for a, w in zip(self.arms, widths, strict=True)]
        self._begin([np.array(q) for q in joints], widths, state["steps"])
