"""Words and rectangles in a picture of numbers, with the font that comes with matplotlib."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.font_manager import get_font

_FONTS = {False: "DejaVuSans.ttf", True: "DejaVuSans-Bold.ttf"}


@lru_cache(maxsize=512)
def lettering(text: str, size: float, bold: bool = False) -> tuple[np.ndarray, int]:
    """A line of text: how much ink, float32[h, w] from 0 to 1, and the row of its base line.

    Args:
        size: height of the font [px].
    """
    font = get_font(str(Path(matplotlib.get_data_path(), "fonts", "ttf", _FONTS[bold])))
    font.set_size(size, 72)
    font.set_text(text, 0.0)
    font.draw_glyphs_to_bitmap(antialiased=True)
    ink = np.asarray(font.get_image(), np.float32) / 255
    return ink, ink.shape[0] - round(font.get_descent() / 64)


def write(
    image: np.ndarray, text: str, x: float, y: float, size: float, colour: np.ndarray,
    bold: bool = False, align: str = "left",
) -> float:  # fmt: skip
    """Write a line of text with its base line at row ``y``; what does not fit is cut off.

    Args:
        image: uint8[h, w, 3], changed in place.
        x: left end, right end or middle [px], as ``align`` says.
        colour: 0 to 255.

    Returns:
        Where it ends [px].
    """
    if not text.strip():
        return x
    ink, base = lettering(text, size, bold)
    shift = {"left": 0.0, "right": ink.shape[1], "middle": ink.shape[1] / 2}[align]
    left, top = round(x - shift), round(y) - base
    cut = ink[max(-top, 0) :, max(-left, 0) :]
    part = image[max(top, 0) : top + ink.shape[0], max(left, 0) : left + ink.shape[1]]
    cut = cut[: part.shape[0], : part.shape[1], None]
    part[:] = np.round(part + cut * (colour - part)).astype(np.uint8)
    return left + ink.shape[1]


def fill_box(
    image: np.ndarray, x0: float, y0: float, x1: float, y1: float, colour: np.ndarray
) -> None:
    """Fill a rectangle; pixels that it covers in part along x are blended."""
    top, bottom = round(y0), round(y1)
    first = int(np.floor(x0))
    columns = np.arange(first, int(np.ceil(x1)))
    share = np.clip(np.minimum(columns + 1, x1) - np.maximum(columns, x0), 0, 1)[:, None]
    part = image[top:bottom, first : first + len(columns)]
    part[:] = np.round(part + share[: part.shape[1]] * (colour - part)).astype(np.uint8)


def number_picture(number: int | None, size: int) -> np.ndarray:
    """A number in the middle of a square: ink, float32[size, size]."""
    square = np.zeros((size, size), np.float32)
    if number is None:
        return square
    ink, _ = lettering(str(number), 0.62 * size, True)
    h, w = min(ink.shape[0], size), min(ink.shape[1], size)
    top, left = (size - h) // 2, (size - w) // 2
    square[top : top + h, left : left + w] = ink[:h, :w]
    return square


def rgb(colour: str) -> np.ndarray:
    """``"#0b7285"`` as float32[3], 0 to 255."""
    return np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)], np.float32)
