"""The fonts of pictures, videos and PDFs: DejaVu Sans with the letters of European languages, in
Latin, Greek and Cyrillic.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont

FONTS = Path(__file__).parent / "assets" / "fonts"


def font_file(bold: bool = False) -> Path:
    """The file of a font (TrueType)."""
    return FONTS / ("DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf")


@lru_cache(maxsize=16)
def font_of(size: int, bold: bool = False) -> FreeTypeFont:
    """A font for pictures.

    Args:
        size: its height [px].
        bold: whether its strokes are thick.
    """
    from PIL import ImageFont

    return ImageFont.truetype(str(font_file(bold)), size)
