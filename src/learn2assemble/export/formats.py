"""An assembly as files: bill, instructions, GLB, COMPAS, LDraw, MJCF and our own JSON.

Every writer makes the whole file before anything is replaced on disk.
"""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from learn2assemble.assembly.blocks import Assembly, Block, fan_triangles
from learn2assemble.assembly.bricks.ldraw import to_ldraw
from learn2assemble.assembly.compas import write_compas
from learn2assemble.assembly.contacts import GROUND, find_contacts
from learn2assemble.assembly.cuts import POST, Cut, cut_of
from learn2assemble.assembly.files import read_assembly, write_assembly
from learn2assemble.assembly.instructions.appearance import colour_words, kinds_and_colours, rgb
from learn2assemble.assembly.instructions.shapes import Shapes
from learn2assemble.assembly.instructions.steps import shapes_of
from learn2assemble.assembly.parts import convex_parts
from learn2assemble.constants import GRAVITY
from learn2assemble.errors import InputError
from learn2assemble.export.cards import step_cards
from learn2assemble.export.pdf import pdf
from learn2assemble.files import as_path, check_new, write_file
from learn2assemble.registry import Registry
from learn2assemble.values import rounded

_PLATE = 0.01
"""Thickness of the ground below a prop beside supports [m]."""


def bill_of_blocks(assembly: Assembly) -> str:
    """The kinds an assembly needs, in every colour, as CSV: how many are built in, how many serve
    as props only.

    Kinds are the shapes of page and cards, and called as there; ``shape`` is their letters, several
    where blocks of one line have other colours there, as props have. Sizes are those of the shape
    as it is drawn. A prop that is removed again may be used again, so ``props`` is the largest
    number of a kind that stands at one time. What stands from the start is ``built_in``, too, and
    what has been taken away may come again as another block: it counts once. ``placed`` is how many
    of what stands at last the steps have placed, ``not_placed`` how many an incomplete plan leaves
    over; without steps, all are placed. Posts have a line for every cut: the section of the bar
    (``length_m``, ``width_m``), its longest (``height_m``) and shortest upright edge, and the
    angles of the faces of its top from level.
    """
    shapes = shapes_of(assembly)
    entry = _entries(assembly, shapes)
    own = [not (b.prop or b.support) for b in assembly.blocks]
    peak: Counter[_Entry] = Counter()
    standing: Counter[_Entry] = Counter()
    came: Counter[_Entry] = Counter()
    supplied: Counter[_Entry] = Counter()
    for step in assembly.steps:
        change = {"place": 1, "remove": -1}.get(step.action, 0)
        if assembly.block(step.block).prop:
            standing[entry[step.block]] += change
            peak |= standing
        else:
            came[entry[step.block]] += change
            supplied |= came
    left = Counter(entry[id_] for id_ in assembly.not_built if own[assembly.index(id_)])
    came.update(left)
    first = assembly.at_first if assembly.steps else own
    pairs = zip(assembly.blocks, first, own, strict=True)
    built = Counter(entry[b.id] for b, *both in pairs if all(both)) + (supplied | came)
    if not assembly.steps:
        peak = Counter(entry[b.id] for b in assembly.blocks if b.prop)
    ordered = {step.place for step in assembly.steps}
    placed = Counter(
        entry[b.id]
        for b in assembly.finished.blocks
        if not b.prop and not b.support and (b.id in ordered or not assembly.steps)
    )
    one_of = {entry[b.id]: b for b in reversed(assembly.blocks)}
    letters: dict[_Entry, set[str]] = {}
    for block in assembly.blocks:
        letters.setdefault(entry[block.id], set()).add(shapes.shape(block).letter)
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    head = (
        "kind",
        "colour",
        "built_in",
        "props",
        "total",
        "length_m",
        "width_m",
        "height_m",
        "mass_kg",
        "placed",
        "not_placed",
        "shortest_edge_m",
        "cut_deg",
        "shape",
    )
    writer.writerow(head)
    for key in sorted(built | peak):
        shape, cut = shapes.shape(one_of[key]), _cut(one_of[key])
        size = sorted(shape.size[:2], reverse=True)
        sizes = (*size, float(shape.size[2])) if cut is None else cut[:3]
        row = [shape.kind, key[1], built[key], peak[key], built[key] + peak[key]]
        row += [f"{number:.6g}" for number in (*sizes, one_of[key].mass)]
        row += [placed[key], left[key]]
        row += ["", ""] if cut is None else [f"{cut.shortest:.6g}", _angles(cut)]
        row += [" ".join(sorted(letters[key], key=lambda word: (len(word), word)))]
        writer.writerow(row)
    return out.getvalue()


def glb(assembly: Assembly) -> bytes:
    """The finished structure as binary glTF, one named node a block, z up turned to y up."""
    import trimesh

    scene: Any = trimesh.Scene()
    for block, name in _finished_colours(assembly):
        triangles = np.concatenate(
            [fan_triangles(part.vertices, part.faces) for part in convex_parts(block)]
        )
        corners, faces = triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)
        colour = np.array([*rgb(name), 255], np.uint8)
        mesh = trimesh.Trimesh(corners, faces, face_colors=colour, process=False)
        scene.add_geometry(mesh, node_name=block.id, geom_name=block.id)
    # glTF has y up.
    scene.apply_transform(np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]]))
    data = scene.export(file_type="glb")
    assert isinstance(data, bytes)
    return data


def mjcf(assembly: Assembly) -> bytes:
    """The finished structure as a MuJoCo model: every block a free body.

    Where no block is a support, they stand on a plane at z = 0, else on the supports alone, as in
    the proof (``assembly/contacts.py``): only props that still stand have a plate below. Convex
    parts of a block are geoms of one body; supports do not move. Contact settings are those under
    which blocks stay within 0.1 mm of where they are (``docs/building.md``): contacts as stiff as
    the step of time lets them be, since soft ones sink by millimetres below many blocks, and
    friction that does not creep. Contacts act from a distance of 0.1 µm on: blocks that touch
    exactly would fall until they overlap, layer after layer, and be thrown back. Distances of hulls
    are found to 0.1 nm: as MuJoCo finds them by itself, two that touch are now and then taken to
    overlap by millimetres, and fly apart.
    """
    root = ElementTree.Element("mujoco", model=assembly.name or "assembly")
    ElementTree.SubElement(
        root,
        "option",
        timestep="0.001",
        cone="elliptic",
        impratio="100",
        iterations="100",
        tolerance="1e-12",
        ccd_iterations="200",
        ccd_tolerance="1e-10",
        gravity=f"0 0 {-GRAVITY}",
    )
    default = ElementTree.SubElement(root, "default")
    friction = f"{assembly.friction:g} 0.005 0.0001"
    ElementTree.SubElement(
        default,
        "geom",
        friction=friction,
        solref="0.002 1",
        solimp="0.99 0.999 0.0001",
        margin="1e-7",
    )
    asset = ElementTree.SubElement(root, "asset")
    world = ElementTree.SubElement(root, "worldbody")
    ElementTree.SubElement(world, "light", pos="0 0 3")
    for ground in _grounds(assembly.finished):
        ElementTree.SubElement(world, "geom", ground)
    for block, name in _finished_colours(assembly):
        centre = block.centroid
        body = ElementTree.SubElement(world, "body", name=block.id, pos=_numbers(centre))
        if not block.support:
            ElementTree.SubElement(body, "freejoint")
        colour = " ".join(f"{c / 255:.3f}" for c in rgb(name)) + " 1"
        for number, part in enumerate(convex_parts(block)):
            attributes = {"density": f"{block.density:g}", "rgba": colour}
            low, high = part.vertices.min(0), part.vertices.max(0)
            if is_box(part):
                attributes |= {
                    "type": "box",
                    "size": _numbers((high - low) / 2),
                    "pos": _numbers((low + high) / 2 - centre),
                }
            else:
                mesh = f"{block.id}/{number}"
                # MuJoCo centres a mesh on its own; inertia "exact" and pos keep it in place.
                points = _numbers((part.vertices - centre).ravel())
                ElementTree.SubElement(asset, "mesh", name=mesh, vertex=points)
                attributes |= {"type": "mesh", "mesh": mesh}
            ElementTree.SubElement(body, "geom", attributes)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)


def _grounds(finished: Assembly) -> Iterator[dict[str, str]]:
    """The table as a geom of MuJoCo; beside supports a plate below each prop that stands on it, as
    an endless plane may go through what stands lower."""
    if not any(block.support for block in finished.blocks):
        yield {"name": "table", "type": "plane", "size": "0 0 0.05"}
        return
    contacts = find_contacts(finished)
    for k in np.flatnonzero(contacts.a == GROUND).tolist():
        points = contacts.points[contacts.patch == k]
        low, high = points.min(0) - [0, 0, _PLATE], points.max(0)
        name = f"below {finished.blocks[int(contacts.b[k])].id}"
        place = {"size": _numbers((high - low) / 2), "pos": _numbers((low + high) / 2)}
        yield {"name": name, "type": "box", **place}


def _finished_colours(assembly: Assembly) -> list[tuple[Block, str]]:
    """What stands in the end, in the colours that kinds have in the whole assembly."""
    names = zip(assembly.blocks, kinds_and_colours(assembly), strict=True)
    colours = {block.id: colour for block, (_, colour) in names}
    return [(block, colours[block.id]) for block in assembly.finished.blocks]


def is_box(block: Block) -> bool:
    """Whether a convex block is a box with edges along x, y and z."""
    low, high = block.vertices.min(0), block.vertices.max(0)
    size = high - low
    near = np.minimum(block.vertices - low, high - block.vertices) <= 1e-9 * size.max()
    return bool(near.all()) and abs(size.prod() - block.volume) <= 1e-6 * size.prod()


def _writer(make: Callable[[Assembly], str | bytes], what: str) -> Callable[[Assembly, Path], None]:
    return lambda assembly, path: write_file(path, make(assembly), what)


write_mjcf: Callable[[Assembly, Path], None] = _writer(mjcf, "MJCF file")
FORMATS: Registry[tuple[str, Callable[[Assembly, Path], None]]] = Registry(
    "format",
    {
        "assembly": ("assembly.json", partial(write_assembly, overwrite=True)),
        "bill": ("bill.csv", _writer(bill_of_blocks, "bill of blocks")),
        "cards": ("cards.html", _writer(step_cards, "step cards")),
        "compas": ("compas.json", write_compas),
        "glb": ("structure.glb", _writer(glb, "GLB file")),
        "ldraw": ("model.ldr", _writer(to_ldraw, "LDraw file")),
        "mjcf": ("structure.xml", write_mjcf),
        "pdf": ("instructions.pdf", _writer(pdf, "PDF file")),
    },
)
"""Usual file name and writer of every format; :func:`export_assembly` looks at what is there."""


def export_assembly(
    assembly: Assembly | str | Path, format: str, path: str | Path, *, overwrite: bool = False
) -> Path:
    """Write an assembly in a format by name.

    Args:
        assembly: blocks where they stand, with steps where the format tells of them, such as
            ``plan.assembly``; or what :func:`learn2assemble.assembly.files.read_assembly` reads.
        format: a name of :data:`FORMATS`.
        path: a new file, or a folder that gets a file of the usual name.
        overwrite: also a file that is there, but none that is read.

    Returns:
        The file written.

    Raises:
        UnknownNameError: naming the nearest format.
        InputError: for a file that cannot be read, and one that is there already.
    """
    _, write = FORMATS[format]
    file = check_target(assembly, format, path, overwrite=overwrite)  # Before anything is read.
    if isinstance(assembly, str | Path):
        assembly = read_assembly(assembly)
    if not isinstance(assembly, Assembly):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise InputError("assembly", assembly, "an Assembly (of a plan its .assembly), or a file")
    write(assembly, file)
    return file


def check_target(
    assembly: object, format: str, path: str | Path, *, overwrite: bool = False
) -> Path:
    """The file to write; arguments and errors as of :func:`export_assembly`."""
    file = file_at(path, FORMATS[format][0])
    check_new(file, format, assembly, overwrite=overwrite)
    return file


def file_at(path: str | Path, name: str) -> Path:
    """The file ``path``, or the one called ``name`` in the folder ``path``."""
    file = as_path(path, "path")
    return file / name if file.is_dir() else file


_Entry = tuple[str, str, int]
"""What a block is in the bill: kind, colour, and the number of its shape, of a post of its cut."""


def _entries(assembly: Assembly, shapes: Shapes) -> dict[str, _Entry]:
    """The line of the bill of every block; posts of one cut have one.

    Args:
        shapes: of all blocks.
    """
    order = {shape.letter: number for number, shape in enumerate(shapes.found)}
    plain = shapes.but_for_colour()
    number_of = {letter: order[shape.letter] for letter, shape in plain.items()}
    cuts: list[Cut] = []
    found = dict[str, _Entry]()
    for block in assembly.blocks:
        cut, number = _cut(block), number_of[shapes.shape(block).letter]
        if cut is not None:
            number = next((k for k, other in enumerate(cuts) if cut.like(other)), len(cuts))
            cuts += [cut] if number == len(cuts) else []
        found[block.id] = (block.kind or "block", colour_words(block), number)
    return found


def _cut(block: Block) -> Cut | None:
    """How a post is cut; None of any other block."""
    return cut_of(block.vertices, block.faces) if block.prop and block.kind == POST else None


def _angles(cut: Cut) -> str:
    return " ".join(f"{angle:.4g}" for angle in cut.angles)


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{rounded(value, 12):.9g}" for value in values)
