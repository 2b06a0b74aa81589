"""A small renderer: triangles with shadows into an image, on the processor, without any GL.

The same triangles give the same picture on every machine.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.viewer.raster import (
    SAMPLES,
    SHADOW_SIZE,
    fill,
    fill_shadow,
    place,
    project,
    project_light,
)
from learn2assemble.viewer.shading import VALUES, shade, slopes


class Camera(NamedTuple):
    """A pinhole camera."""

    position: np.ndarray
    """float64[3] [m, world]."""
    axes: np.ndarray
    """float64[3, 3]: rows right, down and forward, world frame."""
    focal: float
    """Focal length [px]."""
    centre: np.ndarray
    """float64[2]: where the view axis meets the picture [px]."""


class Light(NamedTuple):
    """Sunlight and the square in which it casts shadows."""

    axes: np.ndarray
    """float64[3, 3]: rows right, up and towards the sun, world frame."""
    low: np.ndarray
    """float64[2]: lower corner of the square, along right and up [m]."""
    size: float
    """Side of the square [m]."""


class Triangles(NamedTuple):
    """All triangles of a scene, on bodies that move."""

    vertices: np.ndarray
    """float32[v, 3]: in the frame of their body [m]."""
    normals: np.ndarray
    """float32[v, 3]."""
    marks: np.ndarray
    """float32[v, 2]: place on the face of a block, 0 to 1."""
    body: np.ndarray
    """int32[v]."""
    faces: np.ndarray
    """int32[f, 3]."""
    kind: np.ndarray
    """uint8[f]."""
    number: np.ndarray
    """int32[f]: which picture of a number a block's face carries; -1: none."""


class Buffers:
    """Memory of one picture size, used again for every frame."""

    def __init__(self, triangles: Triangles, width: int, height: int) -> None:
        count = len(triangles.vertices)
        self.world = np.empty((count, 3), np.float32)
        self.normals = np.empty((count, 3), np.float32)
        self.screen = np.empty((count, 3), np.float32)
        self.depth = np.empty((height * SAMPLES, width * SAMPLES), np.float32)
        self.seen = np.empty((height * SAMPLES, width * SAMPLES), np.int32)
        self.shadow = np.empty((SHADOW_SIZE, SHADOW_SIZE), np.float32)
        self.slope = np.zeros((len(triangles.faces), 2 + 3 * VALUES), np.float32)
        self.owner = triangles.body[triangles.faces[:, 0]]
        self.image = np.empty((height, width, 3), np.uint8)


def render(
    triangles: Triangles, buffers: Buffers, camera: Camera, light: Light, position: np.ndarray,
    rotation: np.ndarray, shown: np.ndarray, colour: np.ndarray, sky: np.ndarray, rim: np.ndarray,
    numbers: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """One picture: uint8[height, width, 3], valid until the next call with these buffers.

    Args:
        position: float64[b, 3] of the bodies [m, world].
        rotation: float64[b, 3, 3].
        shown: bool[b].
        colour: float32[b, 3] of the bodies, 0 to 255; likewise ``sky`` and ``rim``, float32[3].
        numbers: float32[n, NUMBER_SIZE, NUMBER_SIZE], how much ink, 0 to 1.
    """
    b = buffers
    place(triangles.vertices, triangles.normals, triangles.body, position, rotation, b.world,
           b.normals)  # fmt: skip
    project_light(b.world, light.axes, light.low, light.size, b.screen)
    b.shadow.fill(-1e9)
    fill_shadow(b.screen, triangles.faces, triangles.kind, triangles.body, shown, b.shadow)
    project(b.world, camera.position, camera.axes, camera.focal, camera.centre, b.screen)
    b.depth.fill(0.0)
    b.seen.fill(-1)
    fill(b.screen, triangles.faces, triangles.body, shown, b.depth, b.seen)
    slopes(
        b.screen, b.world, b.normals, triangles.faces, triangles.body, shown, triangles.marks,
        light.axes, light.low, SHADOW_SIZE / light.size, b.slope,
    )  # fmt: skip
    shade(
        b.seen, b.slope, b.owner, triangles.kind, triangles.number, colour, numbers, rim,
        sky.astype(np.uint8), light.axes[2], b.shadow, camera.focal, b.image,
    )  # fmt: skip
    return b.image
