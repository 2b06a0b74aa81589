"""Solids from files: meshes in STL, OBJ, PLY, GLB and 3DM, and cells in NPY and NPZ.

Meshes must be closed and may not cross themselves; separate objects of one file may overlap.
Cells are never unpickled, and nothing is read that a header only promises.
"""

from __future__ import annotations

import importlib.util
import io
import os
import re
import subprocess
import sys
import tempfile
import zipfile
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from learn2assemble.assembly.meshes import MeshPart, check_size, checked, read_parts
from learn2assemble.design.holes import close_holes
from learn2assemble.errors import InputError, MissingExtraError, Remedy, check_name
from learn2assemble.files import read_bytes
from learn2assemble.geometry.crossings import find_crossing

if TYPE_CHECKING:
    from manifold3d import Manifold

OBSTACLES = ("stl", "obj", "ply", "glb", "3dm")
"""Meshes that can be obstacles."""
MOST_BOXES, SPARE = 48, 0.15
"""A mesh is covered by so many boxes at most, and by no more than it takes to leave this share of
the room that its bounding box has to spare."""
FLAT = 1e-9
"""What is thinner than this share of the whole is no piece of it."""
Mesh = tuple[np.ndarray, np.ndarray]
"""Vertices ``float64[V, 3]`` and triangles ``int64[T, 3]``."""


@dataclass(frozen=True)
class Solid:
    """A closed surface.

    Args:
        triangles: ``float64[N, 3, 3]``, counter-clockwise from outside, in units of the file.
        metres: length of a unit [m]; None where the file does not say.
        up: the axis that points up, "y" or "z".
        holes: how wide every hole was that has been closed, in units of the file.
    """

    triangles: np.ndarray
    metres: float | None
    up: str
    holes: tuple[float, ...] = ()


@dataclass(frozen=True)
class Voxels:
    """Cells as a file gives them.

    Args:
        wanted: ``bool[X, Y, Z]``.
        cell: edges of a cell [m], where the file says.
        colours: ``uint8[X, Y, Z, 3]``, where the file says.
    """

    wanted: np.ndarray
    cell: tuple[float, float, float] | None = None
    colours: np.ndarray | None = None


# ---------------------------------------------------------------- meshes


def read_mesh(content: bytes, kind: str, source: str, repair: bool = False) -> Solid:
    """The solid in a mesh file.

    Args:
        kind: "stl", "obj", "ply", "glb", "off" or "3dm".
        repair: whether small holes are closed.
    """
    metres = 1.0 if kind == "glb" else None
    if kind == "3dm":
        check_size(content, source)
        meshes, metres = _rhino(content, source)
        parts = checked([MeshPart("", *mesh) for mesh in meshes], source)
    else:
        parts = read_parts(content, kind, source)
    meshes = [(part.vertices, part.faces) for part in parts]
    welded, holes = [_welded(*mesh) for mesh in meshes], ()
    if any(_open_edges(faces) for _, faces in welded):
        # Objects may be split by material; together they may be closed.
        welded = [_welded(*_joined(meshes))]
        if found := _open_edges(welded[0][1]):
            mended = close_holes(*welded[0])
            if mended is None or not repair:
                got = f"an open mesh: {found} of its edges do not join two faces that turn alike"
                help_ = () if mended is None else (Remedy("repair", True, mended.words),)
                expected = "a closed mesh (watertight, all faces outward)"
                raise InputError(source, got, expected, *help_)
            welded, holes = [mended.mesh], mended.widths
    parts = [_outward(vertices[faces]) for vertices, faces in welded]
    for (vertices, faces), part in zip(welded, parts, strict=True):
        if np.abs(_volume(part)) <= 1e-12 * float(np.ptp(vertices, axis=0).max()) ** 3:
            raise InputError(source, "a mesh without volume", "a closed mesh with an inside")
        if crossed(vertices, faces):
            raise InputError(source, "a mesh that crosses itself", "a surface without crossings")
    return Solid(_united(parts, source), metres, "y" if kind == "glb" else "z", holes)


def _rhino(content: bytes, source: str) -> tuple[list[Mesh], float | None]:
    """Meshes of a 3DM file, those kept with its surfaces included, and the length of its unit.

    A process of its own reads it: the library may take a damaged file for endless, or crash.
    """
    if importlib.util.find_spec("rhino3dm") is None:
        raise MissingExtraError("rhino3dm", "rhino")
    expected = "a whole 3DM file"
    if len(content) not in (int.from_bytes(content[-n:], "little") for n in (4, 8)):
        raise InputError(source, "3DM that is cut short", expected)
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder) / "design.3dm", Path(folder) / "meshes.npz"
        given.write_bytes(content)
        command = f"from {__name__} import write_rhino_meshes as run; run({folder!r})"
        try:
            done = subprocess.run(
                [sys.executable, "-c", command],
                env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
                timeout=20 + len(content) / 1e6,
                capture_output=True,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise InputError(source, "3DM that takes too long to read", expected) from None
        if done.returncode or not made.exists():
            raise InputError(source, "3DM that cannot be read", expected)
        with np.load(made) as arrays:
            found = dict(arrays)
    refused = str(found.pop("refused", ""))
    if refused:
        raise InputError(source, refused, "a 3DM file of meshes, blocks exploded")
    metres = float(found.pop("metres", np.nan))
    meshes = [(found[f"v{k}"], found[f"f{k}"]) for k in range(len(found) // 2)]
    return meshes, metres if metres > 0 else None


def _limit_processor_time(seconds: float) -> None:
    """End this process after so much more time of the processor, where the system can."""
    try:
        import resource
    except ImportError:  # Windows; the limit by the clock remains.
        return
    used = resource.getrusage(resource.RUSAGE_SELF)
    limit = int(np.ceil(used.ru_utime + used.ru_stime + seconds))
    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))


def write_rhino_meshes(folder: str) -> None:
    """Write ``meshes.npz`` from ``design.3dm``, both in ``folder``; nothing where it fails."""
    import rhino3dm

    given = Path(folder) / "design.3dm"
    _limit_processor_time(1.0 + given.stat().st_size / 5e6)
    model: Any = rhino3dm.File3dm.Read(str(given))
    if model is None:
        return
    refused, found = "", list[tuple[np.ndarray, np.ndarray]]()
    for item in model.Objects:
        shape: Any = item.Geometry
        if not item.Attributes.Visible:
            continue
        if isinstance(shape, rhino3dm.InstanceReference):
            refused = "blocks (instances)"
        meshes: list[Any] = []
        if isinstance(shape, rhino3dm.Mesh):
            meshes = [shape]
        elif isinstance(shape, rhino3dm.Extrusion):
            meshes = [shape.GetMesh(rhino3dm.MeshType.Any)]
        elif isinstance(shape, rhino3dm.Brep):
            faces: Any = shape.Faces
            meshes = [faces[k].GetMesh(rhino3dm.MeshType.Any) for k in range(len(faces))]
        elif isinstance(shape, rhino3dm.Surface):
            meshes = [None]
        if any(mesh is None or not len(mesh.Faces) for mesh in meshes):
            refused = "a surface saved without its mesh"
        elif meshes:  # curves, points and texts have none
            found.append(_joined([_rhino_mesh(mesh) for mesh in meshes]))
    unit = str(model.Settings.ModelUnitSystem).rpartition(".")[2]
    lengths = {
        "Millimeters": 1e-3,
        "Centimeters": 1e-2,
        "Decimeters": 0.1,
        "Meters": 1.0,
        "Inches": 0.0254,
        "Feet": 0.3048,
    }
    arrays: dict[str, Any] = {"metres": lengths.get(unit, np.nan), "refused": refused}
    for k, (vertices, faces) in enumerate(found):
        arrays |= {f"v{k}": vertices, f"f{k}": faces}
    np.savez(Path(folder) / "meshes.npz", **arrays)


def _rhino_mesh(mesh: Any) -> Mesh:
    vertices = np.array([(v.X, v.Y, v.Z) for v in mesh.Vertices], np.float64).reshape(-1, 3)
    quads = np.array([mesh.Faces[k] for k in range(len(mesh.Faces))], np.int64).reshape(-1, 4)
    second = quads[quads[:, 2] != quads[:, 3]][:, [0, 2, 3]]
    return vertices, np.concatenate([quads[:, :3], second])


def _joined(meshes: list[Mesh]) -> Mesh:
    """The faces of one body in one mesh."""
    starts = np.cumsum([0, *(len(v) for v, _ in meshes)])
    faces = [f + start for (_, f), start in zip(meshes, starts, strict=False)]
    return np.concatenate([v for v, _ in meshes]), np.concatenate(faces)


# ---------------------------------------------------------------- closed, not crossing, united


def _welded(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """The mesh with equal vertices as one, or nearly equal ones where that is not enough."""
    grid = 1e-6 * max(float(np.ptp(vertices, axis=0).max()), 1e-12)
    made = _merged(vertices, vertices, faces)
    return _merged(vertices, np.round(vertices / grid), faces) if _open_edges(made[1]) else made


def _merged(vertices: np.ndarray, keys: np.ndarray, faces: np.ndarray) -> Mesh:
    _, first, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    faces = group.reshape(-1)[faces]
    proper = (faces != np.roll(faces, 1, axis=1)).all(1)
    return vertices[first], faces[proper]


def _open_edges(faces: np.ndarray) -> int:
    """Edges that are not run through as often in one direction as in the other."""
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], -1).reshape(-1, 2)
    forward = ends[:, 0] < ends[:, 1]
    _, group = np.unique(_undirected(ends), return_inverse=True)
    balance = np.bincount(group, np.where(forward, 1.0, -1.0)) if len(ends) else ends
    return int(np.count_nonzero(balance))


def _undirected(ends: np.ndarray) -> np.ndarray:
    """``int64[E]``, equal for edges ``int64[E, 2]`` between the same vertices."""
    low, high = ends.min(1), ends.max(1)
    return low * (int(high.max(initial=0)) + 1) + high


def _volume(triangles: np.ndarray) -> float:
    if not len(triangles):
        return 0.0
    moved = triangles - triangles.reshape(-1, 3).mean(0)
    return float(np.einsum("ni,ni->n", moved[:, 0], np.cross(moved[:, 1], moved[:, 2])).sum() / 6)


def _outward(triangles: np.ndarray) -> np.ndarray:
    return triangles if _volume(triangles) >= 0 else triangles[:, ::-1]


def crossed(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Whether an edge of a mesh runs through a face that does not have its ends.

    Contact (a vertex on a face, faces in one plane) is no crossing.
    """
    points = (vertices - vertices.min(0)) / max(float(np.ptp(vertices, axis=0).max()), 1e-12)
    ends = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, first = np.unique(_undirected(ends), return_index=True)
    return find_crossing(points, ends[first], faces, 1e-7, 1e-7) is not None


def _united(parts: list[np.ndarray], source: str) -> np.ndarray:
    """Triangles of the union of closed parts."""
    if len(parts) == 1:
        return parts[0]
    from manifold3d import Error, Manifold, OpType

    bodies = [_manifold(part) for part in parts]
    if any(body.status() != Error.NoError for body in bodies):
        raise InputError(source, "an object that is no clean solid", "closed objects")
    whole: Any = Manifold.batch_boolean(bodies, OpType.Add).to_mesh64()
    corners: np.ndarray = np.asarray(whole.vert_properties)[:, :3]
    return corners[np.asarray(whole.tri_verts).astype(np.int64)]


def _manifold(triangles: np.ndarray) -> Manifold:
    from manifold3d import Manifold, Mesh64

    vertices, index = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    return Manifold(Mesh64(vertices, index.reshape(-1, 3).astype(np.uint64)))


# ---------------------------------------------------------------- cells

_HEADER = re.compile(
    rb"\{\s*'descr':\s*'([<>|=][biuf]\d+)',\s*'fortran_order':\s*(True|False),\s*"
    rb"'shape':\s*\(([\d, ]*)\),?\s*\}\s*$"
)


def read_npy(content: bytes, source: str, limit: int) -> Voxels:
    """``bool[X, Y, Z]`` of an NPY file; numbers that are all 0 or 1 will do."""
    return voxels_of(_array(content, source, limit**3), None, source)


def read_npz(content: bytes, source: str, limit: int) -> Voxels:
    """An NPZ file with ``wanted`` (or a single array), and perhaps ``cell`` and ``colours``."""
    arrays: dict[str, np.ndarray] = {}
    expected = "an NPZ file as numpy.savez writes it"
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            names = [info.filename for info in archive.infolist()]
            if len(names) > 8 or not all(name.endswith(".npy") for name in names):
                raise InputError(source, sorted(names)[:8], f"{expected}, at most 8 arrays")
            for name in names:
                with archive.open(name) as member:
                    head = member.read(8 * 3 * limit**3 + 10_001)
                arrays[name[:-4]] = _array(head, f"{source}: {name}", 3 * limit**3)
    # RuntimeError is how zipfile reports encrypted members, and what it cannot unpack.
    except (zipfile.BadZipFile, zlib.error, RuntimeError, OSError, EOFError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(source, f"a damaged ZIP archive ({error})", expected) from None
    if "wanted" not in arrays and len(arrays) == 1:
        arrays = {"wanted": arrays.popitem()[1]}
    if "wanted" not in arrays:
        raise InputError(f"{source}: arrays", sorted(arrays), "one called 'wanted', or only one")
    for name in arrays:
        check_name(f"{source}: array", name, ("wanted", "cell", "colours"))
    made = voxels_of(arrays["wanted"], arrays.get("colours"), source)
    cell, edges = arrays.get("cell"), None
    if cell is not None:
        if cell.size not in (1, 3) or not np.isfinite(cell.astype(np.float64)).all():
            raise InputError(f"{source}: cell", cell.tolist(), "one or three lengths [m]")
        x, y, z = (float(edge) for edge in np.broadcast_to(cell.reshape(-1), 3))
        edges = x, y, z
    return replace(made, cell=edges)


def voxels_of(values: np.ndarray, colours: Any, source: str) -> Voxels:
    """Cells and their colours from arrays.

    Args:
        values: ``[X, Y, Z]`` of bool, or of numbers that are all 0 or 1.
        colours: ``uint8[X, Y, Z, 3]``, or None.
        source: what messages call the file.
    """
    wanted = _cells(values, source)
    if colours is not None:
        shape = getattr(colours, "shape", ())
        given: object = colours
        kind: Any = getattr(colours, "dtype", type(given))
        if shape != (*wanted.shape, 3) or kind != np.uint8:
            got = f"{getattr(kind, 'name', kind)}{list(shape)}"
            raise InputError(f"{source}: colours", got, f"uint8{[*wanted.shape, 3]}")
        colours = np.array(colours)  # The caller's stays as it is.
    return Voxels(wanted, None, colours)


def _array(content: bytes, source: str, most: int) -> np.ndarray:
    """The array of an NPY file, read without any code of pickles."""
    version = content[6:7]
    length = int.from_bytes(content[8 : 10 if version == b"\1" else 12], "little")
    start = 10 if version == b"\1" else 12
    head = content[start : start + length]
    found = _HEADER.match(head) if content[:6] == b"\x93NUMPY" and len(head) < 10_000 else None
    if found is None:
        got = "a header that says something else"
        if named := re.search(rb"'descr':\s*'[<>|=]?([OcSUVmM])", head):
            got = {b"O": "pickled objects", b"c": "complex numbers"}.get(named[1], "no numbers")
        raise InputError(source, got, "an NPY file of bool[X, Y, Z], which is never unpickled")
    shape = [int(n[:20]) for n in found[3].decode().replace(" ", "").split(",") if n]
    size = 1
    for edge in shape:
        size *= edge
    if size > most:
        got = f"an array of shape {shape}, {size} values"
        raise InputError(source, got, f"at most {most} values")
    try:
        dtype = np.dtype(found[1].decode())
        values = np.frombuffer(content, dtype, size, start + length)
    except (ValueError, TypeError) as error:
        raise InputError(
            source, f"data cut short or unreadable ({error})", "a whole file"
        ) from None
    return values.reshape(shape, order="F" if found[2] == b"True" else "C")


def _cells(values: np.ndarray, source: str) -> np.ndarray:
    if values.dtype.kind not in "biuf":
        raise InputError(source, f"an array of {values.dtype}", "bool[X, Y, Z], or 0 and 1")
    if values.ndim != 3 or 0 in values.shape:
        raise InputError(source, f"an array of shape {list(values.shape)}", "bool[X, Y, Z]")
    ones = values == 1
    if not (ones | (values == 0)).all():
        strange = values[~(ones | (values == 0))].flat[0]
        raise InputError(source, f"a value {strange}", "true or false (1 or 0) in every cell")
    return np.ascontiguousarray(ones)


def mesh_boxes(path: Path, unit: float | None, where: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """Boxes (low, high), float64[3] each [m], that together contain a closed mesh, whose bounding
    box has its middle at x = y = 0 and stands on z = 0.

    Args:
        unit: length of a unit of the file [m]; by default what the file says, else 1.
        where: what messages call it.

    Raises:
        InputError: for a file that is no closed mesh, and for one that is too large.
    """
    kind = path.suffix.lower().lstrip(".")
    if kind not in OBSTACLES:
        raise InputError(where, str(path), f"a file in {', '.join(OBSTACLES)}")
    content, source = read_bytes(path, f"mesh ({where})")
    solid = read_mesh(content, kind, source)
    triangles = solid.triangles * (unit or solid.metres or 1.0)
    if solid.up == "y":
        triangles = triangles[..., [0, 2, 1]] * [1.0, -1.0, 1.0]
    low, high = triangles.min((0, 1)), triangles.max((0, 1))
    if (high - low).max() > 100 or (high - low).min() < 1e-4:
        expected = "0.1 mm to 100 m on every side; `unit` says how long a unit is [m]"
        raise InputError(where, [float(f"{v:.4g}") for v in high - low], expected)
    return _covering(triangles - [*(low + high)[:2] / 2, low[2]])


def _covering(triangles: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Boxes (low, high), float64[3] each, that together contain a closed mesh, in its unit.

    The piece whose bounding box has most room to spare is cut in two across its longest side,
    until that is little or there are :data:`MOST_BOXES`.

    Args:
        triangles: float64[T, 3, 3].
    """
    from manifold3d import Manifold, Mesh64

    corners, index = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    whole = Manifold(Mesh64(corners, index.reshape(-1, 3).astype(np.uint64)))

    def bounds(piece: Any) -> tuple[np.ndarray, np.ndarray]:
        box = np.array(piece.bounding_box())
        return box[:3], box[3:]

    def spare(piece: Manifold) -> float:
        low, high = bounds(piece)
        return float(np.prod(high - low)) - piece.volume()

    thin = FLAT * float(np.subtract(*bounds(whole)[::-1]).max())
    pieces, enough = [whole], SPARE * spare(whole) + 1e-9
    while len(pieces) < MOST_BOXES and sum(map(spare, pieces)) > enough:
        worst = max(pieces, key=spare)
        low, high = bounds(worst)
        axis = int(np.argmax(high - low))
        normal = [float(k == axis) for k in range(3)]
        halves = worst.split_by_plane(normal, float((low + high)[axis] / 2))
        pieces.remove(worst)
        # Where faces lie in the plane, rounding leaves slivers of them.
        pieces += [h for h in halves if np.subtract(*bounds(h)[::-1]).min() > thin]
    return [bounds(piece) for piece in pieces]
