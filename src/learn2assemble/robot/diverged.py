"""What to do when a simulation leaves the numbers."""

# The compiled module has no stubs that pyright finds.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import tempfile
from pathlib import Path

import mujoco
import numpy as np

from learn2assemble.errors import Learn2AssembleError
from learn2assemble.robot.mjcf import World


class SimulationDivergedError(Learn2AssembleError, ArithmeticError):
    """Some position or velocity is not finite any more.

    Args:
        time: since the attempt began [s].
        folder: has ``scene.xml``, the model, and ``state.npz``: ``qpos``, ``qvel``, ``ctrl``,
            ``time``, ``stage`` and ``began``, the poses of the objects at the beginning.
    """

    def __init__(self, time: float, folder: Path) -> None:
        super().__init__(f"simulation diverged at {time:.3f} s; model and state are in {folder}")
        self.time, self.folder = time, folder


def diverged(
    world: World, data: mujoco.MjData, time: float, folder: Path | None, **more: np.ndarray | str
) -> SimulationDivergedError:
    """Write model and state into a folder, by default a new one, and return the error to raise."""
    folder = folder or Path(tempfile.mkdtemp(prefix="l2a-diverged-"))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.xml").write_text(world.spec.to_xml(), encoding="utf-8")
    state = {"qpos": data.qpos, "qvel": data.qvel, "ctrl": data.ctrl, "time": time, **more}
    np.savez(folder / "state.npz", **state)
    return SimulationDivergedError(time, folder)
