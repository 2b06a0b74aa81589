"""The state of many worlds at once: one structure of arrays with a leading batch dimension.

``B`` worlds, ``S`` sides, ``V`` vertices a side at most, ``M`` blocks at most, images of
``ROWS x WORDS`` words (:mod:`learn2assemble.tasks.world.coverage`). A single world is a batch of
one. Blocks are kept in node order: the placed ones by time of placement, then the unplaced ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.tasks.world.coverage import ROWS, WORDS


class State(NamedTuple):
    """Everything a world is. Copying it is a full snapshot; assigning rows restores it exactly."""

    vertices: np.ndarray
    """float64[B, S, V, 2]: target outline of each side, local (x, z) [m]."""
    num_vertices: np.ndarray
    """int64[B, S]."""
    mask: np.ndarray
    """uint64[B, S, ROWS, WORDS]: target mask of each side."""
    mask_rows: np.ndarray
    """int64[B, 2]: first and one past the last image row with mask pixels."""
    mask_pixels: np.ndarray
    """int64[B]: A, mask pixels over all sides."""
    position: np.ndarray
    """float64[B, M, 3]: block centres [m, world]."""
    quaternion: np.ndarray
    """float64[B, M, 4]: block orientations (w, x, y, z)."""
    object_id: np.ndarray
    """int64[B, M]: blocks with the same number are cells of one rigid object. They stand side by
    side in the list, and all of them are placed or none."""
    num_placed: np.ndarray
    """int64[B]."""
    num_blocks: np.ndarray
    """int64[B]: placed and unplaced."""
    covered: np.ndarray
    """uint64[B, S, ROWS, WORDS]: see :mod:`learn2assemble.tasks.world.coverage`."""
    occluded: np.ndarray
    """uint64[B, S, ROWS, WORDS]."""
    initial_pixels: np.ndarray
    """int64[B]: c0, plane-filtered cover right after reset; 0 where coverage is relative to the
    whole target instead of what is open at the start."""
    plane_pixels: np.ndarray
    """int64[B]: c_pl, plane-filtered cover now."""
    complete_pixels: np.ndarray
    """int64[B]: c_co, complete-filtered cover now."""
    terminated: np.ndarray
    """bool[B]: the episode of this row has ended; stepping it changes nothing."""

    @property
    def batch_size(self) -> int:
        return len(self.num_placed)

    @property
    def num_unplaced(self) -> np.ndarray:
        """int64[B]."""
        return self.num_blocks - self.num_placed

    @property
    def num_targets(self) -> np.ndarray:
        """int64[B]: target vertices over all sides."""
        return self.num_vertices.sum(1)

    @property
    def plane_coverage(self) -> np.ndarray:
        """F_pl, float64[B], relative to the initial cover."""
        return _relative(self.plane_pixels, self)

    @property
    def complete_coverage(self) -> np.ndarray:
        """F_co, float64[B]."""
        return _relative(self.complete_pixels, self)

    def copy(self) -> State:
        """A snapshot that shares nothing."""
        return State(*[field.copy() for field in self])

    def take(self, rows: np.ndarray) -> State:
        """Copies of the given rows (repeats allowed), in that order."""
        return State(*[field[rows] for field in self])

    def put(self, rows: np.ndarray, other: State) -> None:
        """Overwrite ``rows`` with the rows of ``other``."""
        for mine, theirs in zip(self, other, strict=True):
            mine[rows] = theirs


def _relative(pixels: np.ndarray, state: State) -> np.ndarray:
    return (pixels - state.initial_pixels) / (state.mask_pixels - state.initial_pixels)


def empty_state(batch: int, sides: int, vertices: int, blocks: int) -> State:
    """A state of zeros with identity orientations; reset every row before use."""
    image = (batch, sides, ROWS, WORDS)
    quaternion = np.zeros((batch, blocks, 4))
    quaternion[..., 0] = 1.0
    return State(
        vertices=np.zeros((batch, sides, vertices, 2)),
        num_vertices=np.zeros((batch, sides), np.int64),
        mask=np.zeros(image, np.uint64),
        mask_rows=np.zeros((batch, 2), np.int64),
        mask_pixels=np.zeros(batch, np.int64),
        position=np.zeros((batch, blocks, 3)),
        quaternion=quaternion,
        object_id=np.tile(np.arange(blocks), (batch, 1)),
        num_placed=np.zeros(batch, np.int64),
        num_blocks=np.zeros(batch, np.int64),
        covered=np.zeros(image, np.uint64),
        occluded=np.zeros(image, np.uint64),
        initial_pixels=np.zeros(batch, np.int64),
        plane_pixels=np.zeros(batch, np.int64),
        complete_pixels=np.zeros(batch, np.int64),
        terminated=np.zeros(batch, np.bool_),
    )
