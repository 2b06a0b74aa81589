"""The video of a build by an arm: MP4 (H.264), drawn and encoded on the processor alone.

A frame shows the workcell from one place, and below it in words what happens.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import numpy as np

from learn2assemble.errors import InputError, MissingExtraError
from learn2assemble.files import unwritable
from learn2assemble.geometry.rotations import yaw_matrix
from learn2assemble.planning.plan import Plan
from learn2assemble.robot.motion.record import BuildRecord
from learn2assemble.robot.moves import Outcome
from learn2assemble.viewer.arm import extent
from learn2assemble.viewer.page import cell_labels
from learn2assemble.viewer.picture import ACCENT, COLOURS, INK, LINE, PAPER, RIM, SOFT
from learn2assemble.viewer.playback import Playback, Segment, block_of_cell
from learn2assemble.viewer.renderer import (
    Buffers,
    Camera,
    blend_sheet,
    project,
    render,
    sunlight,
    view_axes,
)
from learn2assemble.viewer.words import clock_words, stage_words
from learn2assemble.viewer.workcell import body_poses, fill_box, rgb, workcell, write

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
        self.model = workcell(self.playback, self.targets, self.labels)
        self.placed_by = {
            cell: step.number for step in record.steps if step.outcome == Outcome.REACHED
            for cell in step.cells
        }  # fmt: skip
        self.buffers = Buffers(self.model.triangles, width, height - _FOOT)
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
        model, segment = self.model, self.playback.segment_at(clock)
        shown = np.ones(model.count, bool)
        release = segment.step.release
        done = release is not None and clock > release + segment.delay
        poses = body_poses(model, self.playback, clock)
        # What waits in a magazine is below the table.
        cells = slice(model.cells, model.cells + self.playback.record.num_cells)
        shown[cells] = poses[0][cells, 2] > 0
        shown[model.goal] = 0 < clock < self.playback.duration and not done
        picture = render(
            model.triangles, self.buffers, self.camera, self.light,
            *poses, shown, self._colours(segment, clock),
            SKY, rgb(RIM),
        )  # fmt: skip
        for corners in self.sheets:
            blend_sheet(corners, rgb(ACCENT), 0.2, self.buffers.depth, picture)
        return picture

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
        model = self.model
        colour = np.tile(WAITING, (model.count, 1))
        colour[model.outline], colour[model.table] = rgb(ACCENT), TABLE
        colour[model.places] = 0.5 * (TABLE + rgb(SOFT))
        colour[model.goal] = rgb(COLOURS["current"])
        for k, part in enumerate(self.playback.shape.parts):
            colour[model.arm + k] = 255 * np.array(part.colour)
        for cell in range(self.playback.record.num_cells):
            name = self.labels.colours[cell]
            own = rgb(name if name.startswith("#") else COLOURS[name])
            if self.labels.fixed[cell] or self.placed_by.get(cell, np.inf) < segment.step.number:
                colour[model.cells + cell] = own
            if cell in segment.step.cells and 0 < clock < self.playback.duration:
                colour[model.cells + cell] = rgb(COLOURS["current"])
            elif cell in segment.step.cells and clock and cell in self.placed_by:
                colour[model.cells + cell] = own
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
    try:
        import av
    except ImportError as error:
        raise MissingExtraError("av", "video") from error
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
