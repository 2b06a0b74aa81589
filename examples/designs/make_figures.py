"""Writes ``figure.png``, ``soma_cube.npy``, ``dome.npy`` and ``dome.stl`` beside this file.

The figure is a tree in three colours, one pixel one cell. The dome is a half shell of radius 6
cells and thickness 2; as a mesh (in mm, cells of 50 mm) it is the surface around those cells.
"""

from pathlib import Path

import numpy as np
from PIL import Image

HERE = Path(__file__).parent
COLOURS = {
    " ": (0, 0, 0, 0),
    "g": (46, 125, 50, 255),
    "r": (198, 40, 40, 255),
    "b": (109, 76, 65, 255),
}
TREE = [
    "   gg   ",
    "  gggg  ",
    " ggrggg ",
    " gggggg ",
    "ggggrggg",
    "grgggggg",
    "   bb   ",
    "   bb   ",
    "  bbbb  ",
]


def dome(radius: int = 6, thickness: int = 2) -> np.ndarray:
    """``bool[X, Y, Z]``: cells whose centres lie in the upper half of a shell."""
    x, y, z = np.indices((2 * radius, 2 * radius, radius)) + 0.5
    distance = np.sqrt((x - radius) ** 2 + (y - radius) ** 2 + z**2)
    return (distance < radius) & (distance >= radius - thickness)


def surface(cells: np.ndarray, edge: float) -> np.ndarray:
    """Triangles ``float32[N, 3, 3]`` around the cells, outward."""
    padded, found = np.pad(cells, 1), []
    for axis in range(3):
        for step in (1, -1):
            faces = np.argwhere(padded & ~np.roll(padded, -step, axis)) - 1.0
            u, v = _across(axis, step)
            corner = faces + (np.eye(3)[axis] if step > 0 else 0)
            found += [
                np.stack([corner, corner + u, corner + u + v], 1),
                np.stack([corner, corner + u + v, corner + v], 1),
            ]
    return (np.concatenate(found) * edge).astype(np.float32)


def _across(axis: int, step: int) -> tuple[np.ndarray, np.ndarray]:
    """Edges of a face, so that their cross product points along ``step`` times the axis."""
    u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
    return (u, v) if step > 0 else (v, u)


def write_stl(triangles: np.ndarray, path: Path) -> None:
    """A binary STL file."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    rows = np.zeros(len(triangles), record)
    rows["corners"] = triangles
    path.write_bytes(bytes(80) + len(rows).to_bytes(4, "little") + rows.tobytes())


if __name__ == "__main__":
    pixels = np.array([[COLOURS[c] for c in row] for row in TREE], np.uint8)
    Image.fromarray(pixels).save(HERE / "figure.png")
    np.save(HERE / "soma_cube.npy", np.ones((3, 3, 3), bool))
    np.save(HERE / "dome.npy", dome())
    write_stl(surface(dome(), 50.0), HERE / "dome.stl")
