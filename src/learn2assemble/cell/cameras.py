"""Builds whose blocks are seen by the cameras of the layout."""

from __future__ import annotations

from collections.abc import Sequence

from learn2assemble.cell.pieces import Piece
from learn2assemble.errors import InputError
from learn2assemble.motion.plant import Plant
from learn2assemble.motion.setup import Setup
from learn2assemble.sensing.camera import DepthCamera
from learn2assemble.sensing.eyes import SeeingPlant, Sort
from learn2assemble.sensing.pictures import pictures_of


def through_cameras(
    plant: Plant, setup: Setup, pieces: Sequence[Piece], cameras: Sequence[DepthCamera]
) -> Plant:
    """A plant whose blocks are seen by cameras; the plant itself where there are none, or where
    something else is said to see blocks.

    Args:
        plant: a simulated cell shows itself to the cameras; of others ``setup.around.pictures``
            takes the pictures.
        setup: the cell as it is meant to be.
        pieces: blocks of the plan.
        cameras: of the layout.

    Raises:
        InputError: where nothing takes pictures.
    """
    pictures = setup.around.pictures
    if not cameras or setup.around.look is not None:
        return plant
    if pictures is None:
        pictures = pictures_of(plant, setup, cameras)
    if pictures is None:
        raise no_pictures(cameras)
    sorts = {piece.id: Sort(piece.shape, tuple(piece.turns())) for piece in pieces}
    fixed = [(kind.shape, pose) for kind, pose in setup.fixed]
    return SeeingPlant(plant, setup.arm, cameras, pictures, sorts, setup.waiting, fixed)


def no_pictures(cameras: Sequence[DepthCamera]) -> InputError:
    """Nothing takes pictures with the cameras of a layout."""
    names = ", ".join(camera.name for camera in cameras)
    expected = "what takes their pictures (`Surroundings(pictures=...)`), or a layout without"
    return InputError("cameras", names, expected)
