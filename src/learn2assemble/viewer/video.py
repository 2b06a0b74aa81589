"""The video of a build by an arm: MP4 (H.264), drawn and encoded on the processor alone.

A frame shows the workcell from one place, and below it in words what happens.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import shapely
from PIL import Image, ImageDraw

from learn2assemble.assembly.instructions.appearance import rgb
from learn2assemble.errors import InputError, extra
from learn2assemble.files import replacing
from learn2assemble.fonts import font_of
from learn2assemble.geometry.rotations import quaternion_matrix, yaw_matrix
from learn2assemble.kinematics.shape import LinkPart, Mesh, box
from learn2assemble.motion.record import BuildRecord
from learn2assemble.planning.plan import Plan
from learn2assemble.progress import Progress, counted, silent
from learn2assemble.robot.moves import Outcome
from learn2assemble.viewer import renderer
from learn2assemble.viewer.arm import Labels, arms_words, extent, object_name
from learn2assemble.viewer.picture import ACCENT, INK, LINE, PAPER, RIM, SOFT
from learn2assemble.viewer.playback import Playback, ReplaySegment, split
from learn2assemble.viewer.scene import (
    SEEN_FROM_BEHIND,
    cell_labels,
    drawn_from_front,
    first_view,
    is_behind,
)
from learn2assemble.viewer.words import clock_words, stage_words

if TYPE_CHECKING:
    from learn2assemble.viewer.renderer import Buffers, Camera, Light, Triangles


WIDTH, HEIGHT = 800, 544
FRAMES_PER_SECOND = 25
SPEED, LONGEST = 4.0, 45.0
"""How many times faster than the arm the video plays at least, and how long it may be [s]."""
_HOLD = 1.5
"""How long the finished build is shown at the end [s]."""
_FOOT = 92
"""Height of the words under the picture [px]."""
SKY, TABLE, WAITING = rgb("#f1efea"), np.array([228, 223, 213], np.float32), rgb("#e9ddc7")
_BAD, _GOOD, _UNDONE = "#a3261c", "#17663c", "#ddb0ac"
"""Of words and of attempts; the last one of what failed, before it is done."""
_FROM = np.array([[0.5, -1.0, 0.6], [1.0, -0.55, 0.6]])
"""Directions from the structure to the camera, with the arm on the left: from its side, and ..."""
_WIDER = 1.25
"""... from opposite, where the structure shows so many times the area from there."""
_SUN = np.array([[-0.9, -1.9, 2.5], [1.6, -1.4, 2.5]])
"""Directions to the sun, one for each of these."""
_FIELD = 16.0
"""Angle of view, up and down [degrees]."""


OUTLINE, PLACES, GOAL, TOP, PARTS = range(5)
"""Bodies: the outlines and the waiting places, which stand still and are never shaded, the frame
that shows where a block goes, the table, the parts of arms; then the cells."""


class Frames:
    """The frames of the video of a build.

    Raises:
        InputError: where the record does not fit the plan.
    """

    def __init__(self, plan: Plan, records: Sequence[BuildRecord]) -> None:
        self.plan = plan
        self.playback: Playback = Playback(records, plan)
        record = self.playback.record
        self.speed: float = max(SPEED, math.ceil(record.spans()[-1][1] / LONGEST))
        """How many times faster than the arm the video plays."""
        if plan.assembly is None:
            raise InputError("plan", "no blocks", "assembly.json beside plan.json")
        self.targets: list[np.ndarray] = [
            np.array(target.outline) for target in plan.design.targets
        ]
        self.labels: Labels = cell_labels(plan.assembly, self.playback.blocks)
        self.parts: list[tuple[int, LinkPart]] = [
            (number, part)
            for number, arm in enumerate(self.playback.arms)
            for part in arm.shape.parts
        ]
        """Of all arms, with the numbers of these."""
        self.cells: int = PARTS + len(self.parts)
        """Body of the first cell; they are the last ones."""
        self.count: int = self.cells + record.num_cells
        self.triangles: Triangles = self._triangles()
        self.placed_by: dict[int, int] = {
            cell: step.number
            for step in record.steps
            if step.outcome == Outcome.REACHED
            for cell in step.cells
        }
        self.buffers: Buffers = renderer.Buffers(self.triangles, WIDTH, HEIGHT - _FOOT)
        back, sun = self._view(plan)
        self.behind: bool = drawn_from_front(plan.design.drawn) and bool(back[1] > 1e-6)
        """Whether one looks at the back of what was drawn from the front, which is said then."""
        self.camera: Camera = self._camera(back)
        self.light: Light = renderer.sunlight(sun, self._points(), 0.12)
        self.sheets: list[np.ndarray] = self._sheets()
        self.ribbons: tuple[Image.Image, Image.Image] = self._ribbons()

    def frame(self, clock: float) -> np.ndarray:
        """uint8[HEIGHT, WIDTH, 3] at a time of the replay [s]."""
        image = Image.new("RGB", (WIDTH, HEIGHT), PAPER)
        image.paste(Image.fromarray(self.picture(clock)))
        self._words(image, clock)
        return np.array(image)

    def picture(self, clock: float) -> np.ndarray:
        """uint8[H, W, 3]: the cell, without words, at a time of the replay [s]."""
        segment = self.playback.segment_at(clock)
        shown = np.ones(self.count, bool)
        release = segment.step.release
        done = release is not None and clock > release + segment.delay
        poses = self._poses(clock)
        # What waits in a magazine is below the table.
        shown[self.cells :] = poses[0][self.cells :, 2] > 0
        shown[GOAL] = 0 < clock < self.playback.duration and not done
        picture = renderer.render(
            self.triangles,
            self.buffers,
            self.camera,
            self.light,
            renderer.BodyStates(*poses, shown, self._colours(segment, clock)),
            SKY,
            rgb(RIM),
        )
        for corners in self.sheets:
            renderer.blend_sheet(corners, rgb(ACCENT), 0.2, self.buffers.depth, picture)
        return picture

    def _triangles(self) -> renderer.Triangles:
        playback, labels, bodies = self.playback, self.labels, renderer.Bodies()
        edge, first = playback.record.block_edge, playback.record.steps[0].before
        for corners in self.targets:
            bodies.add_bars(OUTLINE, renderer.around(corners), edge / 22)
        square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        for cell, half in enumerate(playback.half):
            if not labels.fixed[cell] and first[cell, 2] > 0:
                at = np.column_stack([first[cell, :2] + half[:2] * square, np.full(4, edge / 90)])
                bodies.add_bars(PLACES, renderer.around(at), edge / 90)
        # The frame is a cube with edge 1, stretched to the block it is for.
        bodies.add_bars(GOAL, renderer.box_edges([-0.5] * 3, [0.5] * 3), 1 / 40)
        bodies.add(TOP, self._table(), renderer.GROUND)
        for k, (_, part) in enumerate(self.parts):
            bodies.add(PARTS + k, part.mesh, renderer.LIT)
        hulls = playback.record.hull or [None] * len(playback.half)
        for cell, (half, hull) in enumerate(zip(playback.half, hulls, strict=True)):
            if hull is not None:
                bodies.add(self.cells + cell, _flat(hull.triangles()), renderer.LIT)
                continue
            block = box(half)
            # What is left and right, below and above on each face: all but where it looks.
            marks = (block.vertices[np.abs(block.normals) < 0.5] > 0).reshape(-1, 2)
            bodies.add(self.cells + cell, block, renderer.BLOCK, marks)
        return bodies.triangles()

    def _table(self) -> Mesh:
        """The table top under all there is, its corners round."""
        record, edge = self.playback.record, self.playback.record.block_edge
        bases = [arm.shape.chain.offset[:1, :2] for arm in self.playback.arms]
        points = [record.steps[0].before[:, :2], *bases]
        every = np.concatenate([*points, *(corners[:, :2] for corners in self.targets)])
        low, high = every.min(0) - 2.2 * edge, every.max(0) + 2.2 * edge
        quarter, ring = np.linspace(0, np.pi / 2, 9), list[np.ndarray]()
        for k, (sx, sy) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
            corner = cast("np.ndarray", np.where(np.array([sx, sy]) > 0, high, low))
            centre = corner - edge * np.array([sx, sy])
            turn = quarter + k * np.pi / 2
            ring.append(centre + edge * np.column_stack([np.cos(turn), np.sin(turn)]))
        rim = np.concatenate(ring)
        flat = np.vstack([rim.mean(0), rim])
        n = len(rim)
        faces = np.column_stack([np.zeros(n), 1 + np.arange(n), 1 + (np.arange(n) + 1) % n])
        vertices = np.column_stack([flat, np.full(len(flat), -0.0004)])
        return Mesh(vertices, np.tile([0.0, 0.0, 1.0], (len(flat), 1)), faces.astype(np.int32))

    def _poses(self, clock: float) -> tuple[np.ndarray, np.ndarray]:
        """Where all bodies are at a time of the replay: float64[b, 3] [m], float64[b, 3, 3]."""
        playback = self.playback
        position, rotation = np.zeros((self.count, 3)), np.tile(np.eye(3), (self.count, 1, 1))
        shown = enumerate(playback.arms)
        frames = [arm.shape.frames(*playback.arm_at(clock, number)) for number, arm in shown]
        for k, (number, part) in enumerate(self.parts):
            where, turned = frames[number]
            if part.frame >= 0:
                position[PARTS + k], rotation[PARTS + k] = where[part.frame], turned[part.frame]
        position[self.cells :], quaternions = playback.cells_at(clock)
        rotation[self.cells :] = quaternion_matrix(quaternions)
        step = playback.segment_at(clock).step
        position[GOAL], quaternion = split(step.target)
        size = np.diag(2 * playback.half[step.cells[0]])
        rotation[GOAL] = quaternion_matrix(quaternion) @ size
        return position, rotation

    def _sheets(self) -> list[np.ndarray]:
        """The targets as triangles in the picture, a hair behind the faces of the blocks."""
        import manifold3d

        edge, found = self.playback.record.block_edge, list[np.ndarray]()
        library = cast("Any", manifold3d)
        for target in self.plan.design.targets:
            x, y, _ = normal = np.array(target.outward)
            corners = np.array(target.outline)[::-1] - edge / 50 * normal
            flat = np.stack([corners @ [-y, x, 0.0], corners[:, 2]], 1)
            screen = renderer.project(corners, self.camera)
            found += [screen[ear] for ear in library.triangulate([flat])]
        return found

    def _ribbons(self) -> tuple[Image.Image, Image.Image]:
        """All attempts side by side, a lane an arm, as they look when done and before."""
        done, ahead = (Image.new("RGB", (WIDTH, 8), PAPER) for _ in range(2))
        scale = (WIDTH - 48) / max(self.playback.duration, 1e-9)
        for s in self.playback.segments:
            good = s.step.outcome == Outcome.REACHED
            x0, x1 = 24 + round(s.start * scale), 24 + round(s.end * scale)
            lanes = len(self.playback.arms)
            y0, y1 = 8 * s.arm // lanes, 8 * (s.arm + 1) // lanes
            place = (x0, y0, max(x1 - 3, x0), y1 - (s.arm + 1 < lanes) * 2)
            ImageDraw.Draw(done).rectangle(place, ACCENT if good else _BAD)
            ImageDraw.Draw(ahead).rectangle(place, LINE if good else _UNDONE)
        return done, ahead

    def _colours(self, segment: ReplaySegment, clock: float) -> np.ndarray:
        colour = np.tile(WAITING, (self.count, 1))
        colour[OUTLINE], colour[TOP] = rgb(ACCENT), TABLE
        colour[PLACES] = 0.5 * (TABLE + rgb(SOFT))
        colour[GOAL] = rgb("current")
        for k, (_, part) in enumerate(self.parts):
            colour[PARTS + k] = 255 * np.array(part.colour)
        moved = {cell for one in self.playback.active_at(clock) for cell in one.step.cells}
        for cell in range(self.playback.record.num_cells):
            name = self.labels.colours[cell]
            own = rgb(name)
            # A prop stands without a last place of its own: it has its colour all the time.
            if (
                self.labels.fixed[cell]
                or name == "prop"
                or self.placed_by.get(cell, np.inf) < segment.step.number
            ):
                colour[self.cells + cell] = own
            if cell in moved and 0 < clock < self.playback.duration:
                colour[self.cells + cell] = rgb("current")
            elif cell in segment.step.cells and clock and cell in self.placed_by:
                colour[self.cells + cell] = own
        return colour

    def _words(self, image: Image.Image, clock: float) -> None:
        playback, draw = self.playback, ImageDraw.Draw(image)
        segment, top = playback.segment_at(clock), HEIGHT - _FOOT

        def write(
            text: str,
            x: float,
            y: float,
            size: int,
            colour: str,
            bold: bool = False,
            anchor: str = "ls",
        ) -> float:
            """A line of text with its base line at row ``y``; where it ends [px]."""
            draw.text((x, y), text, colour, font_of(size, bold), anchor)
            return x + draw.textlength(text, font_of(size, bold))

        write(" ".join(self.plan.design.name.split()), 24, 42, 24, INK, bold=True)
        write(
            f"{arms_words(playback).lower()}, shown {self.speed:g} times as fast", 24, 66, 14, SOFT
        )
        if self.behind:
            write(SEEN_FROM_BEHIND, WIDTH - 24, 66, 14, SOFT, anchor="rs")
        now = 24 + round((WIDTH - 48) * clock / max(playback.duration, 1e-9))
        done, ahead = self.ribbons
        image.paste(ahead, (0, top + 12))
        image.paste(done.crop((0, 0, now, 8)), (0, top + 12))
        write(self.doing(clock), 24, top + 50, 19, INK, bold=True)
        spent = f"{clock_words(clock)} / {clock_words(playback.duration)}"
        write(spent, WIDTH - 24, top + 50, 19, SOFT, anchor="rs")
        if clock > 0:
            number, total = segment.step.number, len(playback.segments)
            x = write(f"attempt {number} of {total}: ", 24, top + 77, 15, SOFT)
            colour = _GOOD if segment.step.outcome == Outcome.REACHED else _BAD
            x = write(segment.step.outcome.label, x, top + 77, 15, colour, bold=True)
            write(segment.step.detail, x + 10, top + 77, 15, SOFT)

    def doing(self, clock: float) -> str:
        """What arms do at a time of the replay, as a sentence."""
        arms, told = self.playback.arms, dict[int, str]()
        if clock <= 0:
            return "The arms wait." if arms[1:] else "The arm waits."
        if clock >= self.playback.duration:
            return "The build is over."
        for segment in self.playback.active_at(clock):
            told.setdefault(segment.arm, self._does(segment, clock))
        if not arms[1:]:
            return f"The arm {told[0]}."
        return "; ".join(f"{arm.name} {told.get(k, 'waits')}" for k, arm in enumerate(arms)) + "."

    def _does(self, segment: ReplaySegment, clock: float) -> str:
        """What an arm does, as the rest of a sentence."""
        step = segment.step
        if not len(step.samples.time):
            return f"cannot move: {step.outcome.label}"
        block = object_name(step, self.labels.names)
        for stage in step.stages:
            if stage.start - 1e-6 <= clock - segment.delay <= stage.end + 1e-6:
                suction = self.playback.arms[segment.arm].suction
                return stage_words(step, stage, block, suction)
        return "stands still"

    def _points(self) -> np.ndarray:
        record = self.playback.record
        cells = [p[p[:, 2] > 0, :3] for p in (record.steps[0].before, record.steps[-1].after)]
        return np.concatenate([*cells, *self.targets, extent(self.playback.arms)])

    def _camera(self, back: np.ndarray) -> renderer.Camera:
        """As near as shows everything from a direction, as the page does."""
        points, width, height = self._points(), WIDTH, HEIGHT - _FOOT
        pad = 0.75 * self.playback.record.block_edge
        corners = pad * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        cloud = (points[:, None] + corners).reshape(-1, 3)
        axes = renderer.view_axes(back)
        focal = height / 2 / np.tan(np.radians(_FIELD / 2))
        centre, distance = cloud.mean(0), 6 * float(np.ptp(cloud, axis=0).max())
        for _ in range(16):
            seen = (cloud - centre - distance * back) @ axes.T
            xy = focal * seen[:, :2] / seen[:, 2:]
            low, high = xy.min(0), xy.max(0)
            centre = centre + (low + high) / 2 * distance / focal @ axes[:2]
            fit = (high - low) / (0.94 * width, 0.92 * height)
            distance *= min(max(float(fit.max()), 0.5), 2.0)
        eye = centre + distance * back
        return renderer.Camera(eye, axes, float(focal), np.array([width / 2, height / 2]))

    def _view(self, plan: Plan) -> tuple[np.ndarray, np.ndarray]:
        """Unit vectors to the camera and to the sun: from where the finished structure shows most,
        but from before what was drawn from the front, unless an arm hides it from there."""
        most = self._shows_most()
        back, sun = self._turned(_FROM[most]), self._turned(_SUN[most])
        if drawn_from_front(plan.design.drawn) and back[1] > 1e-6 and plan.assembly is not None:
            bases = [arm.shape.chain.offset[0, :2] for arm in self.playback.arms]
            view = first_view(plan.assembly.finished.blocks, bases, True)
            if not is_behind(view):
                turn, aside = view
                back = yaw_matrix(turn) @ [aside, -1.0, 0.6]
                # Over the shoulder on the other side of the arm, as the page does.
                sun = yaw_matrix(turn) @ [-0.9 if aside > 0 else 0.9, -1.9, 2.5]
        return back / np.linalg.norm(back), sun / np.linalg.norm(sun)

    def _shows_most(self) -> int:
        """The number of the direction from which the finished structure shows most."""
        built = self.playback.record.steps[-1].after[:, :3]
        library = cast("Any", shapely)  # Its stubs have arguments without a type.
        first, second = (
            library.area(
                shapely.convex_hull(
                    shapely.multipoints(built @ renderer.view_axes(self._turned(back))[:2].T)
                )
            )
            for back in _FROM
        )
        return int(second > _WIDER * first)

    def _turned(self, direction: np.ndarray) -> np.ndarray:
        """The unit vector of a direction that is meant for an arm on the left."""
        return yaw_matrix(self.playback.side) @ direction / np.linalg.norm(direction)


def require_video() -> ModuleType:
    """The library that encodes.

    Raises:
        MissingExtraError: without the extra ``video``.
    """
    with extra("av", "video"):
        import av
    return av


def write_video(
    plan: Plan, records: Sequence[BuildRecord], path: Path, progress: Progress = silent
) -> None:
    """Write ``build.mp4``. The same records give the same pictures.

    Args:
        plan: that the records fit.
        records: what each arm did.
        progress: told how many frames are drawn.

    Raises:
        MissingExtraError: without the extra ``video``.
        InputError: where the record does not fit the plan, or ``path`` cannot be written.
    """
    progress("drawing the video")
    av, film = require_video(), Frames(plan, records)
    options = {"crf": "20", "preset": "veryfast", "threads": "1"}
    with (
        replacing(path, "video") as part,
        av.open(
            str(part), "w", format="mp4", options={"movflags": "faststart", "fflags": "+bitexact"}
        ) as file,
    ):
        stream = file.add_stream("libx264", rate=FRAMES_PER_SECOND, options=options)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        last, picture = -1.0, None
        shown = moments(film.playback.duration, film.speed).tolist()
        for clock in counted(shown, "drawing the video", progress):
            if picture is None or clock != last:
                picture, last = film.frame(clock), clock
            file.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        file.mux(stream.encode())


def moments(duration: float, speed: float) -> np.ndarray:
    """Times on the clock of the replay that are shown, one per frame [s]."""
    count = math.ceil(duration / speed * FRAMES_PER_SECOND)
    moving = np.minimum(np.arange(count) * (speed / FRAMES_PER_SECOND), duration)
    return np.concatenate([moving, np.full(round(_HOLD * FRAMES_PER_SECOND), duration)])


def _flat(triangles: np.ndarray) -> Mesh:
    """Triangles float64[t, 3, 3], each with its own normal [m]."""
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-15)
    faces = np.arange(3 * len(triangles), dtype=np.int32).reshape(-1, 3)
    return Mesh(triangles.reshape(-1, 3), np.repeat(across, 3, axis=0), faces)
