"""The video of a build by an arm: MP4 (H.264), drawn and encoded on the processor alone.

A frame shows the workcell from one place, and below it in words what happens.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from types import ModuleType

import matplotlib
import numpy as np
from matplotlib.font_manager import get_font

from learn2assemble.errors import InputError, extra
from learn2assemble.files import unwritable
from learn2assemble.geometry.rotations import quaternion_matrix, yaw_matrix
from learn2assemble.planning.plan import Plan
from learn2assemble.robot.motion.record import BuildRecord
from learn2assemble.robot.moves import Outcome
from learn2assemble.robot.shape import Mesh, box
from learn2assemble.viewer.arm import extent
from learn2assemble.viewer.page import cell_labels
from learn2assemble.viewer.picture import ACCENT, COLOURS, INK, LINE, PAPER, RIM, SOFT
from learn2assemble.viewer.playback import Playback, Segment, block_of_cell, split
from learn2assemble.viewer.renderer import (
    BLOCK,
    GROUND,
    LIT,
    Bodies,
    Buffers,
    Camera,
    Triangles,
    around,
    blend_sheet,
    box_edges,
    project,
    render,
    sunlight,
    view_axes,
)
from learn2assemble.viewer.words import clock_words, stage_words

# ---------------------------------------------------------------- words and bars


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


def rgb(colour: str) -> np.ndarray:
    """``"#0b7285"`` as float32[3], 0 to 255."""
    return np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)], np.float32)


# ---------------------------------------------------------------- frames


WIDTH, HEIGHT = 800, 544
_FOOT = 92
"""Height of the words under the picture [px]."""
SKY, TABLE, WAITING = rgb("#f1efea"), np.array([228, 223, 213], np.float32), rgb("#e9ddc7")
_BAD = rgb("#a3261c")
_GOOD = rgb("#17663c")
_FROM = np.array([0.5, -1.0, 0.6])
"""Direction from the structure to the camera, world frame."""
_SUN = np.array([-0.9, -1.9, 2.5])
_FIELD = 16.0
"""Angle of view, up and down [degrees]."""


OUTLINE, PLACES, GOAL, TOP, PARTS = range(5)
"""Bodies: the outlines and the waiting places, which stand still and are never shaded, the frame
that shows where a block goes, the table, the parts of the arm; then the cells."""


class Frames:
    """The frames of the video of one record; ``note`` stands behind the name of the arm.

    Raises:
        InputError: where the record does not fit the plan.
    """

    def __init__(
        self, plan: Plan, record: BuildRecord, width: int = WIDTH,
        height: int = HEIGHT, note: str = "",
    ) -> None:  # fmt: skip
        self.plan, self.playback = plan, Playback(record, plan)
        self.width, self.height, self.note = width, height, note
        if plan.assembly is None:
            raise InputError("plan", "no blocks", "assembly.json beside plan.json")
        self.targets = [np.array(target.outline) for target in plan.design.targets]
        self.labels = cell_labels(plan.assembly, block_of_cell(record, plan))
        self.cells = PARTS + len(self.playback.shape.parts)
        """Body of the first cell; they are the last ones."""
        self.count = self.cells + record.num_cells
        self.triangles = self._triangles()
        self.placed_by = {
            cell: step.number for step in record.steps if step.outcome == Outcome.REACHED
            for cell in step.cells
        }  # fmt: skip
        self.buffers = Buffers(self.triangles, width, height - _FOOT)
        self.camera = self._camera()
        self.light = sunlight(self._turned(_SUN), self._points(), 0.12)
        self.sheets = self._sheets()
        self.ribbons = self._ribbons()

    def frame(self, clock: float) -> np.ndarray:
        """uint8[height, width, 3] at a time of the replay [s]."""
        image = np.empty((self.height, self.width, 3), np.uint8)
        image[:-_FOOT] = self._picture(clock)
        image[-_FOOT:] = rgb(PAPER).astype(np.uint8)
        self._words(image, clock)
        return image

    def _picture(self, clock: float) -> np.ndarray:
        segment = self.playback.segment_at(clock)
        shown = np.ones(self.count, bool)
        release = segment.step.release
        done = release is not None and clock > release + segment.delay
        poses = self._poses(clock)
        # What waits in a magazine is below the table.
        shown[self.cells :] = poses[0][self.cells :, 2] > 0
        shown[GOAL] = 0 < clock < self.playback.duration and not done
        picture = render(
            self.triangles, self.buffers, self.camera, self.light,
            *poses, shown, self._colours(segment, clock),
            SKY, rgb(RIM),
        )  # fmt: skip
        for corners in self.sheets:
            blend_sheet(corners, rgb(ACCENT), 0.2, self.buffers.depth, picture)
        return picture

    def _triangles(self) -> Triangles:
        playback, labels, bodies = self.playback, self.labels, Bodies()
        edge, first = playback.record.block_edge, playback.record.steps[0].before
        for corners in self.targets:
            bodies.add_bars(OUTLINE, around(corners), edge / 22)
        square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        for cell, half in enumerate(playback.half):
            if not labels.fixed[cell] and first[cell, 2] > 0:
                at = np.column_stack([first[cell, :2] + half[:2] * square, np.full(4, edge / 90)])
                bodies.add_bars(PLACES, around(at), edge / 90)
        # The frame is a cube with edge 1, stretched to the block it is for.
        bodies.add_bars(GOAL, box_edges([-0.5] * 3, [0.5] * 3), 1 / 40)
        bodies.add(TOP, self._table(), GROUND)
        for k, part in enumerate(playback.shape.parts):
            bodies.add(PARTS + k, part.mesh, LIT)
        for cell, half in enumerate(playback.half):
            block = box(half)
            # What is left and right, below and above on each face: all but where it looks.
            marks = (block.vertices[np.abs(block.normals) < 0.5] > 0).reshape(-1, 2)
            bodies.add(self.cells + cell, block, BLOCK, marks)
        return bodies.triangles()

    def _table(self) -> Mesh:
        """The table top under all there is, its corners round."""
        record, edge = self.playback.record, self.playback.record.block_edge
        points = [record.steps[0].before[:, :2], self.playback.shape.chain.offset[:1, :2]]
        every = np.concatenate([*points, *(corners[:, :2] for corners in self.targets)])
        low, high = every.min(0) - 2.2 * edge, every.max(0) + 2.2 * edge
        quarter, ring = np.linspace(0, np.pi / 2, 9), []
        for k, (sx, sy) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
            centre = np.where(np.array([sx, sy]) > 0, high, low) - edge * np.array([sx, sy])
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
        where, turned = playback.shape.frames(*playback.arm_at(clock))
        for k, part in enumerate(playback.shape.parts):
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

        edge, found = self.playback.record.block_edge, []
        for target in self.plan.design.targets:
            x, y, _ = normal = np.array(target.outward)
            corners = np.array(target.outline)[::-1] - edge / 50 * normal
            flat = np.stack([corners @ [-y, x, 0.0], corners[:, 2]], 1)
            screen = project(corners, self.camera)
            found += [screen[ear] for ear in manifold3d.triangulate([flat])]
        return found

    def _ribbons(self) -> tuple[np.ndarray, np.ndarray]:
        """All attempts side by side, as they look when done and before: uint8[8, width, 3]."""
        paper = np.tile(rgb(PAPER).astype(np.uint8), (8, self.width, 1))
        done, ahead = paper.copy(), paper
        scale = (self.width - 48) / max(self.playback.duration, 1e-9)
        for s in self.playback.segments:
            good = s.step.outcome == Outcome.REACHED
            x0 = 24 + s.start * scale
            x1 = max(24 + s.end * scale - 1.5, x0 + 1)
            fill_box(done, x0, 0, x1, 8, rgb(ACCENT) if good else _BAD)
            fill_box(ahead, x0, 0, x1, 8, rgb(LINE) if good else 0.35 * _BAD + 0.65 * rgb(PAPER))
        return done, ahead

    def _colours(self, segment: Segment, clock: float) -> np.ndarray:
        colour = np.tile(WAITING, (self.count, 1))
        colour[OUTLINE], colour[TOP] = rgb(ACCENT), TABLE
        colour[PLACES] = 0.5 * (TABLE + rgb(SOFT))
        colour[GOAL] = rgb(COLOURS["current"])
        for k, part in enumerate(self.playback.shape.parts):
            colour[PARTS + k] = 255 * np.array(part.colour)
        for cell in range(self.playback.record.num_cells):
            name = self.labels.colours[cell]
            own = rgb(name if name.startswith("#") else COLOURS[name])
            if self.labels.fixed[cell] or self.placed_by.get(cell, np.inf) < segment.step.number:
                colour[self.cells + cell] = own
            if cell in segment.step.cells and 0 < clock < self.playback.duration:
                colour[self.cells + cell] = rgb(COLOURS["current"])
            elif cell in segment.step.cells and clock and cell in self.placed_by:
                colour[self.cells + cell] = own
        return colour

    def _words(self, image: np.ndarray, clock: float) -> None:
        playback, record = self.playback, self.playback.record
        segment, top = playback.segment_at(clock), self.height - _FOOT
        ink, soft = rgb(INK), rgb(SOFT)
        title = " ".join(self.plan.design.name.split())
        write(image, title, 24, 42, 24, ink, bold=True)
        write(image, f"arm {record.arm.name}{self.note}", 24, 66, 14, soft)
        now = 24 + round((self.width - 48) * clock / max(playback.duration, 1e-9))
        for strip, columns in zip(self.ribbons, (slice(0, now), slice(now, None)), strict=True):
            image[top + 12 : top + 20, columns] = strip[:, columns]
        good = segment.step.outcome == Outcome.REACHED
        write(image, self.doing(clock), 24, top + 50, 19, ink, bold=True)
        spent = f"{clock_words(clock)} / {clock_words(playback.duration)}"
        write(image, spent, self.width - 24, top + 50, 19, soft, align="right")
        if clock > 0:
            total = len(playback.segments)
            x = write(image, f"attempt {segment.step.number} of {total}: ", 24, top + 77, 15, soft)
            words = segment.step.outcome.label
            x = write(image, words, x + 7, top + 77, 15, _GOOD if good else _BAD, bold=True)
            if segment.step.detail:
                write(image, segment.step.detail, x + 10, top + 77, 15, soft)

    def doing(self, clock: float) -> str:
        """What the arm does at a time of the replay, as a sentence."""
        segment = self.playback.segment_at(clock)
        step = segment.step
        if clock <= 0:
            return "The arm waits."
        if clock >= self.playback.duration:
            return "The build is over."
        if not len(step.samples.time):
            return f"The arm cannot move: {step.outcome.label}."
        for stage in step.stages:
            if stage.start - 1e-6 <= clock - segment.delay <= stage.end + 1e-6:
                block, suction = self.labels.names[step.cells[0]], self.playback.record.arm.suction
                return f"The arm {stage_words(step, stage, block, suction)}."
        return "The arm stands still."

    def _points(self) -> np.ndarray:
        record = self.playback.record
        cells = [p[p[:, 2] > 0, :3] for p in (record.steps[0].before, record.steps[-1].after)]
        return np.concatenate([*cells, *self.targets, extent(self.playback)])

    def _camera(self) -> Camera:
        """As near as shows everything, as the page does."""
        points, width, height = self._points(), self.width, self.height - _FOOT
        pad = 0.75 * self.playback.record.block_edge
        corners = pad * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        cloud = (points[:, None] + corners).reshape(-1, 3)
        back = self._turned(_FROM)
        axes = view_axes(back)
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
        return Camera(eye, axes, float(focal), np.array([width / 2, height / 2]))

    def _turned(self, direction: np.ndarray) -> np.ndarray:
        """The unit vector of a direction that is meant for an arm on the left."""
        return yaw_matrix(self.playback.side) @ direction / np.linalg.norm(direction)


FRAMES_PER_SECOND = 25
SPEED, LONGEST = 4.0, 45.0
"""How many times faster than the arm the video plays at least, and how long it may be [s]."""
_HOLD = 1.5
"""How long the finished build is shown at the end [s]."""


def require_video() -> ModuleType:
    """The library that encodes.

    Raises:
        MissingExtraError: without the extra ``video``.
    """
    with extra("av", "video"):
        import av
    return av


def write_video(
    plan: Plan,
    record: BuildRecord,
    path: Path,
    *,
    speed: float | None = None,
    width: int = WIDTH,
    height: int = HEIGHT,
    progress: Callable[[float], object] = lambda share: None,
) -> None:
    """Write ``build.mp4``. The same record gives the same file.

    Args:
        plan: that the record fits.
        record: what the arm did.
        speed: how many times faster than the arm it plays; by default :data:`SPEED`, or as much as
            it takes for the video to last no longer than :data:`LONGEST`.
        width, height: of the picture [px], even.
        progress: told the share that is done.

    Raises:
        MissingExtraError: without the extra ``video``.
        InputError: where the record does not fit the plan, the speed is not positive, the size is
            not even or too small, or ``path`` cannot be written.
    """
    av = require_video()
    if speed is None:
        seconds = record.spans()[-1][1] if record.steps else 0.0
        speed = max(SPEED, math.ceil(seconds / LONGEST))
    if not 0 < speed < math.inf:
        raise InputError("speed", speed, "a positive number")
    if width % 2 or height % 2 or width < 320 or height < 240:
        raise InputError("size of the video", (width, height), "even numbers from 320 x 240")
    note = "" if speed == 1 else f", shown {speed:g} times as fast"
    frames = Frames(plan, record, width, height, note)
    clocks = moments(frames.playback.duration, speed)
    part = path.with_name(f".{path.name}.part")
    # One thread: how many there are would change the bytes.
    options = {"crf": "20", "preset": "veryfast", "threads": "1"}
    try:
        with av.open(
            str(part), "w", format="mp4", options={"movflags": "faststart", "fflags": "+bitexact"}
        ) as file:
            stream = file.add_stream("libx264", rate=FRAMES_PER_SECOND, options=options)
            stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
            for picture in _pictures(frames, clocks, progress):
                file.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            file.mux(stream.encode())
        os.replace(part, path)
    except OSError as error:
        raise unwritable("video", path, error) from None
    finally:
        part.unlink(missing_ok=True)


def moments(duration: float, speed: float) -> np.ndarray:
    """Times on the clock of the replay that are shown, one per frame [s]."""
    count = math.ceil(duration / speed * FRAMES_PER_SECOND)
    moving = np.minimum(np.arange(count) * (speed / FRAMES_PER_SECOND), duration)
    return np.concatenate([moving, np.full(round(_HOLD * FRAMES_PER_SECOND), duration)])


def _pictures(
    film: Frames, clocks: np.ndarray, progress: Callable[[float], object]
) -> Iterator[np.ndarray]:
    last, picture = -1.0, None
    for k, clock in enumerate(clocks.tolist()):
        if picture is None or clock != last:
            picture, last = film.frame(clock), clock
        yield picture
        progress((k + 1) / len(clocks))
