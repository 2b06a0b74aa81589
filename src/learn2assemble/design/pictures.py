"""Pictures on cells, and colours that count as one."""

from __future__ import annotations

import io

import numpy as np

from learn2assemble.errors import InputError, Remedy, trusted

MAX_COLOURS = 32
"""Most colours of a picture that are told apart."""
_SHADES = 40.0
"""How far apart shades of one colour are, where there are many [of 255]."""
MAX_PIXELS = 16_000_000
"""Most pixels of a picture."""
USUAL_WIDE = 32
"""Cells across that are proposed."""
MAX_LINES = 100_000
"""Most edges of pixels that are kept as the outline of a picture."""
LOSSY = {"png": False, "jpeg": True, "webp": True}
"""Kinds of pictures, and whether pixels of one colour may differ in the file."""


def read_picture(
    content: bytes, kind: str, source: str, wide: int | None, limit: int, aspect: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """A picture on cells, the margin around its material left out.

    Where some pixels are transparent, the others are material. In an opaque picture those are that
    are dark (luminance below one half, or by a quarter below that of the lightest pixel), and
    strongly coloured ones.

    Args:
        kind: one of :data:`LOSSY`.
        wide: cells across; None is one pixel one cell.
        limit: largest number of cells each way.
        aspect: width of a cell by its height.

    Returns:
        share of material ``float64[X, Z]`` and its most frequent colour ``uint8[X, Z, 3]``, z up;
        lines between material and nothing, ``float64[L, 2, 2]`` [cells], None where a pixel is a
        cell or where there are very many. Of more than 32 colours, and of those of a lossy kind,
        near ones count as one.
    """
    pixels = _pixels(content, kind, source).astype(np.float64)
    colour, alpha = pixels[:, :, :3], pixels[:, :, 3]
    material = alpha >= 128
    if material.all():
        luminance = colour @ (0.299, 0.587, 0.114)
        dark = luminance < max(128, luminance.max() - 64)
        material = dark | (np.ptp(colour, axis=2) >= 96)
    if not material.any():
        raise InputError(source, "no opaque or dark pixel", "a picture of something")
    rows, columns = np.flatnonzero(material.any(1)), np.flatnonzero(material.any(0))
    window = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    material, colour = material[window][::-1].T, colour[window][::-1].transpose(1, 0, 2)
    if wide is None:
        if max(material.shape) > limit:
            got = f"{material.shape[0]} x {material.shape[1]} pixels of material"
            raise InputError(
                source,
                got,
                f"at most {limit} each way where a pixel is a cell",
                *_fitting(material.shape, min(limit, USUAL_WIDE), limit, aspect),
            )
        return material.astype(np.float64), _plain(colour.astype(np.uint8), material, kind), None
    per_cell = len(material) / wide
    high = _cells_high(material.shape, wide, aspect)
    if high > limit:
        raise InputError(
            f"{source}: cells_wide",
            wide,
            f"fewer: it would be {high} cells high",
            *_fitting(material.shape, wide, limit, aspect),
        )
    edges = (np.arange(wide + 1) * per_cell, np.arange(high + 1) * (per_cell / aspect))
    size = edges[0][1] * edges[1][1]
    share = _sums(material, edges)
    palette, which = _palette(colour, material)
    amounts = np.stack([_sums(material & (which == k), edges) for k in range(len(palette))])
    if len(palette) == MAX_COLOURS:  # Shades of one colour are seen as one.
        apart = np.square(palette[:, None].astype(float) - palette).sum(-1)
        amounts = np.tensordot(np.exp(-apart / (2 * _SHADES**2)), amounts, 1) * (amounts > 0)
    outline = _outline(material) / (per_cell, per_cell / aspect)
    colours = _plain(palette[amounts.argmax(0)], share > 0, kind)
    return share / size, colours, outline if len(outline) <= MAX_LINES else None


def _cells_high(shape: tuple[int, ...], wide: int, aspect: float) -> int:
    """Of a picture of pixels (x, z) that is so many cells wide."""
    return int(np.ceil(shape[1] / (shape[0] / wide / aspect) - 1e-9))


def _fitting(shape: tuple[int, ...], wide: int, limit: int, aspect: float) -> tuple[Remedy, ...]:
    """The largest number of cells across, up to ``wide``, with which a picture fits."""
    for fewer in range(wide, 0, -1):
        high = _cells_high(shape, fewer, aspect)
        if high <= limit:
            return (Remedy("cells_wide", fewer, f"gives {fewer} × {high} cells"),)
    return ()


def _outline(material: np.ndarray) -> np.ndarray:
    """Edges between pixels of material and others, ``float64[L, 2, 2]`` [pixels]."""
    padded = np.pad(material, 1).astype(np.int8)
    found = list[np.ndarray]()
    for axis in (0, 1):
        along = np.array([axis == 1, axis == 0], np.int64)
        start = np.argwhere(np.diff(padded, axis=axis)) - along
        found.append(np.stack([start, start + along], 1))
    return np.concatenate(found).astype(float)


def _plain(colour: np.ndarray, used: np.ndarray, kind: str) -> np.ndarray:
    """Colours of cells, near ones as one where the kind of picture has blurred them."""
    if not LOSSY[kind]:
        return colour
    made, seen = colour.copy(), colour[used]
    made[used] = seen[near_colours(seen)]
    return made


def near_colours(colours: np.ndarray) -> np.ndarray:
    """``int64[n]``: for every one of ``uint8[n, 3]`` the first of the colour it counts as.

    The most frequent colour takes all near ones, then the most frequent of what is left, and so on.
    """
    exact, first, index, count = np.unique(
        colours, axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    taken = np.full(len(exact), -1)
    while (taken < 0).any():
        left = np.flatnonzero(taken < 0)
        most = left[count[left].argmax()]
        apart = np.square(exact[left].astype(float) - exact[most]).sum(-1)
        taken[left[apart <= _SHADES**2]] = most
    return first[taken][index.reshape(-1)]


def _palette(colour: np.ndarray, material: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``uint8[K, 3]``, at most ``MAX_COLOURS``, and which of them each pixel has, ``int[W, H]``."""
    from PIL import Image

    used = colour[material].astype(np.uint8)
    exact, index = np.unique(used, axis=0, return_inverse=True)
    if len(exact) > MAX_COLOURS:
        image = Image.fromarray(used[None]).quantize(MAX_COLOURS, Image.Quantize.MEDIANCUT)
        index = np.asarray(image)[0].astype(np.int64)
        count = np.maximum(np.bincount(index, minlength=MAX_COLOURS), 1)[:, None]
        sums = [np.bincount(index, used[:, k], MAX_COLOURS) for k in range(3)]
        exact = np.round(np.stack(sums, -1) / count).astype(np.uint8)
    which = np.full(material.shape, -1)
    which[material] = index.reshape(-1)
    return exact, which


def _sums(values: np.ndarray, edges: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Integral of pixels over the rectangles between the edges [pixels]."""
    for axis, edge in enumerate(edges):
        total = np.cumsum(values, axis=axis, dtype=np.float64)
        total = np.concatenate([np.zeros_like(total.take([0], axis)), total], axis)
        low = np.minimum(edge.astype(np.int64), values.shape[axis] - 1)
        share = np.minimum(edge - low, 1.0).reshape((-1, 1) if axis == 0 else (1, -1))
        at = total.take(low, axis) * (1 - share) + total.take(low + 1, axis) * share
        values = np.diff(at, axis=axis)
    return values


def _pixels(content: bytes, kind: str, source: str) -> np.ndarray:
    """``uint8[H, W, 4]``, red to alpha, as a viewer turns the picture."""
    from PIL import Image, ImageOps
    from PIL.JpegImagePlugin import JpegImageFile
    from PIL.PngImagePlugin import PngImageFile
    from PIL.WebPImagePlugin import WebPImageFile

    expected = f"a whole {kind.upper()} picture of at most {MAX_PIXELS} pixels"
    # Not Image.open, which has a limit and a warning of its own before the size is known.
    readers = {"png": PngImageFile, "jpeg": JpegImageFile, "webp": WebPImageFile}
    with trusted(source, expected), readers[kind](io.BytesIO(content)) as image:
        if not 0 < image.width * image.height <= MAX_PIXELS:
            raise InputError(source, f"{image.width} x {image.height} pixels", expected)
        turned = ImageOps.exif_transpose(image)
        if turned.mode.startswith("I"):
            turned = Image.fromarray((np.asarray(turned) >> 8).astype(np.uint8))
        return np.asarray(turned.convert("RGBA"))
