"""Answers of a plant that make no sense reach nobody: the arm stops, and the reason is said."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from typing import Any, cast

import numpy as np

from learn2assemble.plants.plant import (
    STATES,
    BlockReading,
    Commands,
    Guards,
    Motion,
    Plant,
    PlantError,
    Readings,
    Report,
    Request,
    Stop,
    ToolReading,
    WrappedPlant,
)

CLOCK_SLACK = 1e-6
"""By so much readings may lie in the future, and the clock go back [s]."""
SYMMETRY = 1e-9
"""Covariances are symmetric, and their eigenvalues not negative, but for this share."""


class Checked(WrappedPlant):
    """A plant whose answers are looked at before anyone sees them: names, shapes, finite numbers,
    unit quaternions, covariances that are some, a clock that does not go back, readings that are
    not older than ``oldest``. What makes no sense stops the arm and raises.

    Args:
        plant: the one behind it.
        arm: name of the arm it has to be.
        joints: how many joints that has.
        names: of blocks there are; asked at every reading, as replacements come.
        oldest: age of the oldest reading that is used [s]; older ones are left out.

    Raises:
        PlantError: from all its methods but ``stop`` and ``close``.
    """

    def __init__(
        self,
        plant: Plant,
        arm: str,
        joints: int,
        names: Collection[str],
        oldest: float = math.inf,
    ) -> None:
        super().__init__(plant)
        self.arm = arm
        self.count = joints
        self.names = names
        self.oldest = oldest
        self.clock: float = -math.inf

    def sense(self) -> Readings:
        """See :class:`Plant`; readings that came too late are left out."""
        found = self._asked(self.plant.sense)
        why = self._odd_readings(found)
        if why:
            self._refuse(why)
        self.clock = found.time
        kept = tuple(one for one in found.blocks if found.time - one.time <= self.oldest)
        return found._replace(blocks=kept)

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        """See :class:`Plant`."""
        return self._reported(self._asked(self.plant.execute, motion, commands, guards))

    def request(self, request: Request) -> Report:
        """See :class:`Plant`."""
        return self._reported(self._asked(self.plant.request, request))

    def _asked(self, method: Callable[..., Any], *given: object) -> Any:
        """Its answer, whatever the plant is; errors of the connection as ours."""
        try:
            return method(*given)
        except PlantError as error:
            self._halt()
            raise error from None
        except TimeoutError as error:
            self._halt()
            raise PlantError(Stop.LATE, _line(error)) from error
        except (OSError, EOFError) as error:
            self._halt()
            raise PlantError(Stop.LOST, _line(error)) from error

    def _reported(self, report: Report) -> Report:
        why = self._odd_report(report)
        if why:
            self._refuse(why)
        if report.stop in (Stop.LOST, Stop.LATE, Stop.REFUSED, Stop.PROTECTIVE):
            self._halt()
            raise PlantError(report.stop, report.detail or "the plant says so")
        return report

    def _refuse(self, why: str) -> None:
        self._halt()
        raise PlantError(Stop.REFUSED, why)

    def _halt(self) -> None:
        try:
            self.plant.stop()
        except (OSError, EOFError, PlantError):
            return  # Nobody hears it; the plant stops by itself when its connection ends.

    def _odd_readings(self, found: object) -> str:
        """What makes no sense in readings, in words; empty where nothing does."""
        if not isinstance(found, Readings):
            return f"an answer of type {type(found).__name__} instead of readings"
        if not _finite(found.time):
            return "readings without a time"
        if found.time < self.clock - CLOCK_SLACK:
            return f"the clock went back by {self.clock - found.time:.3f} s"
        if found.arm != self.arm:
            return f"an arm {found.arm!r}, not {self.arm!r}"
        if found.state not in STATES:
            return f"a state {found.state!r}"
        for name, array in (("joints", found.joints), ("velocity", found.velocity)):
            if not _numbers(array, (self.count,)):
                return f"{name} that are not {self.count} finite numbers"
        seen: set[str] = set()
        for one in found.blocks:
            why = self._odd_block(one, found.time, seen)
            if why:
                return why
        return _odd_tool(found.tool)

    def _odd_block(self, one: object, now: float, seen: set[str]) -> str:
        if not isinstance(one, BlockReading):
            return f"a reading of type {type(one).__name__}"
        known = isinstance(one.block, str)  # pyright: ignore[reportUnnecessaryIsInstance]
        if not known or one.block not in self.names:
            return f"a reading of a block {one.block!r} that does not exist"
        if one.block in seen:
            return f"two readings of {one.block}"
        seen.add(one.block)
        if not _finite(one.time) or one.time > now + CLOCK_SLACK:
            return f"a reading of {one.block} from the future"
        if not _numbers(one.pose, (7,)) or abs(float(np.linalg.norm(one.pose[3:])) - 1) > 1e-6:
            return f"a pose of {one.block} that is none"
        if not covariance_is_sound(one.covariance):
            return f"a covariance of {one.block} that is none"
        return ""

    def _odd_report(self, report: object) -> str:
        if not isinstance(report, Report):
            return f"an answer of type {type(report).__name__} instead of a report"
        if not isinstance(report.stop, Stop):  # pyright: ignore[reportUnnecessaryIsInstance]
            return f"an end {report.stop!r}"
        if not (_finite(report.done) and 0 <= report.done <= 1):
            return f"a share {report.done!r} of a motion"
        if not (_finite(report.seconds) and report.seconds >= 0):
            return f"a motion of {report.seconds!r} s"
        if not _numbers(report.joints, (self.count,)):
            return f"joints that are not {self.count} finite numbers"
        return _odd_tool(report.tool)


def covariance_is_sound(matrix: object) -> bool:
    """Whether it is a float64[6, 6] of finite numbers, symmetric, with no negative eigenvalue."""
    if not _numbers(matrix, (6, 6)):
        return False
    matrix = cast("np.ndarray", matrix)
    size = float(np.abs(matrix).max())
    if size == 0:
        return True
    if float(np.abs(matrix - matrix.T).max()) > SYMMETRY * size:
        return False
    return float(np.linalg.eigvalsh(matrix)[0]) >= -SYMMETRY * size


def _odd_tool(tool: object) -> str:
    if not isinstance(tool, ToolReading):
        return f"a tool of type {type(tool).__name__}"
    if tool.vacuum not in (None, True, False):
        return f"a vacuum {tool.vacuum!r}"
    for name, value in (("width", tool.width), ("grip", tool.grip)):
        if value is not None and not _finite(value):
            return f"a {name} {value!r} of the fingers"
    three = isinstance(tool.force, tuple)  # pyright: ignore[reportUnnecessaryIsInstance]
    if not (three and len(tool.force) == 3 and all(map(_finite, tool.force))):
        return "a force that is not three finite numbers"
    return ""


def _finite(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _numbers(value: object, shape: tuple[int, ...]) -> bool:
    if not isinstance(value, np.ndarray):
        return False
    array = cast("np.ndarray", value)
    return array.shape == shape and array.dtype == np.float64 and bool(np.isfinite(array).all())


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
