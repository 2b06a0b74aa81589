"""Images of single bits made of pixels."""

from __future__ import annotations

import numpy as np

from learn2assemble.tasks.world.coverage import WORDS


def from_pixels(pixels: np.ndarray) -> np.ndarray:
    """Inverse of :func:`learn2assemble.tasks.world.coverage.to_pixels`."""
    padded = np.zeros((*pixels.shape[:-1], 64 * WORDS), bool)
    padded[..., : pixels.shape[-1]] = pixels
    return np.packbits(padded, -1, "little").view("<u8").astype(np.uint64)
