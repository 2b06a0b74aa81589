"""The video of a build by an arm: MP4 (H.264), drawn and encoded on the processor alone."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from learn2assemble.errors import InputError, MissingExtraError
from learn2assemble.robot.record import BuildRecord
from learn2assemble.viewer.film import HEIGHT, WIDTH, Film

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
    plan: Mapping[str, Any],
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
        plan: parsed ``plan.json``.
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
    film = Film(plan, record, width, height, note)
    clocks = moments(film.playback.duration, speed)
    try:
        path.write_bytes(b"")  # before the work, not after it
    except OSError as error:
        raise InputError("video", str(path), f"a writable file ({error.strerror})") from None
    # One thread: how many there are would change the bytes.
    options = {"crf": "20", "preset": "veryfast", "threads": "1"}
    with av.open(str(path), "w", format="mp4", options={"movflags": "faststart"}) as file:
        stream = file.add_stream("libx264", rate=FRAMES_PER_SECOND, options=options)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for picture in _pictures(film, clocks, progress):
            file.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        file.mux(stream.encode())


def moments(duration: float, speed: float) -> np.ndarray:
    """Times on the clock of the replay that are shown, one per frame [s]."""
    count = math.ceil(duration / speed * FRAMES_PER_SECOND)
    moving = np.minimum(np.arange(count) * (speed / FRAMES_PER_SECOND), duration)
    return np.concatenate([moving, np.full(round(_HOLD * FRAMES_PER_SECOND), duration)])


def _pictures(
    film: Film, clocks: np.ndarray, progress: Callable[[float], object]
) -> Iterator[np.ndarray]:
    last, picture = -1.0, None
    for k, clock in enumerate(clocks.tolist()):
        if picture is None or clock != last:
            picture, last = film.frame(clock), clock
        yield picture
        progress((k + 1) / len(clocks))
