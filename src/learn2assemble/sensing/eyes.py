"""A plant that is seen through cameras: what they show becomes readings of blocks.

It stands on the side that decides. It knows where the layout has the cameras, the shapes of blocks,
what was asked of magazines, and what the arm did since; of the cell itself it gets pictures and
what the plant behind it senses. A block that no camera shows yields no reading.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix
from learn2assemble.kinematics.chain import Chain, forward, get_chain
from learn2assemble.plants.plant import (
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
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.bodies import Shape, body_of
from learn2assemble.sensing.camera import DepthCamera, DepthPicture, rotation
from learn2assemble.sensing.pictures import ArmPicture, without_arm
from learn2assemble.sensing.registration import Believed, Look, Seen, register
from learn2assemble.sensing.residuals import PreparedPicture, views_of
from learn2assemble.sensing.resting import alone
from learn2assemble.sensing.search import find

IN_HAND = (0.004, 0.05)
"""How far what the arm carried may be from where it should be: standard deviations [m], [rad]."""
AT_REST = (0.004, 0.05)
"""The same of what lies where it was seen last, or where a magazine presents it."""
NEAR_TOOL = 0.06
"""What the tool has taken hold of is the block whose surface is nearest, within this [m]."""


class Sort(NamedTuple):
    """What a block looks like."""

    shape: Shape
    turns: tuple[np.ndarray, ...] = (np.eye(3),)
    """Rotations float64[3, 3] that leave the shape as it is, the one that does nothing first."""


class SeeingPlant(WrappedPlant):
    """A plant whose blocks are seen by cameras.

    Args:
        plant: behind it; what it says of blocks is not used.
        arm: of it.
        cameras: where they are taken to be.
        pictures: takes one picture with each.
        sorts: by the names that blocks have in the plan.
        waiting: float64[7] by name: blocks on the table from the beginning, and where.
        fixed: shapes of what always stands there, and poses float64[7].
    """

    def __init__(
        self,
        plant: Plant,
        arm: Arm,
        cameras: Sequence[DepthCamera],
        pictures: Callable[[], Sequence[DepthPicture]],
        sorts: Mapping[str, Sort],
        waiting: Mapping[str, np.ndarray],
        fixed: Sequence[tuple[Shape, np.ndarray]] = (),
    ) -> None:
        super().__init__(plant)
        self.cameras: tuple[DepthCamera, ...] = tuple(cameras)
        self.pictures = pictures
        self.arm = arm
        self.chain: Chain = get_chain(arm)
        self.sorts = sorts
        self.fixed: tuple[tuple[Shape, np.ndarray], ...] = tuple(fixed)
        self.kind: dict[str, str] = {name: name for name in waiting}
        """Names in the plan of the blocks that there are."""
        self.expected: dict[str, np.ndarray | None] = {n: p.copy() for n, p in waiting.items()}
        """float64[7]: where each should be; None: that is not known."""
        self.held: tuple[str, np.ndarray, np.ndarray] | None = None
        """The block in the hand, its position and rotation in the tool frame."""
        self.joined: dict[str, str] = {}
        """Blocks that follow another one while that is in the hand."""
        self.period: float = max((1 / camera.rate for camera in self.cameras), default=0.0)
        self.last: tuple[float, tuple[BlockReading, ...]] | None = None
        self.looks: int = 0
        self.handled: bool = False
        self.moment: float = -1.0
        """Whether the tool has just taken hold or let go; and when it did last [s]."""

    # ------------------------------------------------------------ as a plant

    def sense(self) -> Readings:
        """See :class:`~learn2assemble.plants.plant.Plant`; two looks within the time of a picture
        show the same one, and none is taken at the moment at which the tool takes hold or lets
        go."""
        readings = self.plant.sense()
        if self.handled:
            self.handled, self.moment = False, readings.time
        since = self.period if self.last is None else readings.time - self.last[0]
        if readings.time > self.moment and since >= self.period - 1e-9:
            self.last = readings.time, self._look(readings)
        elif self.last is None:
            return readings._replace(blocks=())
        return readings._replace(blocks=self.last[1])

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        report = self.plant.execute(motion, commands, guards)
        self._follow(report)
        return report

    def request(self, request: Request) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        report = self.plant.request(request)
        if report.stop == Stop.END:
            if request.what == "join":
                self.joined[request.block] = request.kind
            elif request.what in ("present", "place"):
                self.kind[request.block] = request.kind
                self.expected[request.block] = np.array(request.pose, float)
            else:
                self.kind.pop(request.block, None)
                self.expected.pop(request.block, None)
            if self.last is not None:  # No picture shows yet what was done.
                kept = tuple(one for one in self.last[1] if one.block != request.block)
                self.last = self.last[0], kept
        return report

    def state(self) -> dict[str, Any]:
        """What the file of a build keeps, from which another one goes on; what is in the hand then
        is taken out of it."""
        expected = {n: None if p is None else p.tolist() for n, p in self.expected.items()}
        if self.held is not None:
            expected[self.held[0]] = None
        behind = getattr(self.plant, "state", None)
        return {"kind": self.kind, "expected": expected, "plant": behind and behind()}

    def restore(self, state: dict[str, Any]) -> None:
        """As :meth:`state` said."""
        self.kind, self.held, self.last = dict(state["kind"]), None, None
        found = state["expected"].items()
        self.expected = {name: None if p is None else np.array(p) for name, p in found}
        if state["plant"] is not None:
            self.plant.restore(state["plant"])  # pyright: ignore[reportAttributeAccessIssue, reportUnknownMemberType]

    # ------------------------------------------------------------ looking

    def _look(self, readings: Readings) -> tuple[BlockReading, ...]:
        """What the cameras show now.

        Raises:
            PlantError: where none of them shows anything.
        """
        self.looks += 1
        pictures = self.pictures()
        if self.cameras and all(one.blind for one in pictures):
            self.plant.stop()
            names = ", ".join(camera.name for camera in self.cameras)
            raise PlantError(Stop.LOST, f"nothing is seen by the cameras of the layout: {names}")
        views = views_of(pictures, self.cameras)
        if self.held is not None:
            # Fingers beside a block look like more of it.
            views = self._without_arm(views, readings)
        seen: dict[str, Seen] = {}
        stands = self._alone()
        for name, pose in self.expected.items():
            if pose is not None and views:
                seen[name] = register(views, self._believed(name, pose, name in stands))
        for name, one in seen.items():
            if one.look == Look.ABSENT and not (self.held and self.held[0] == name):
                self.expected[name] = None
        lost = [self._believed(n, None) for n, pose in self.expected.items() if pose is None]
        if lost and views:
            known, hidden = list(self.fixed), list[tuple[Shape, np.ndarray]]()
            for name, pose in self.expected.items():
                if pose is not None:
                    one = seen[name]
                    sure = known if one.look == Look.SEEN else hidden
                    sure.append((self._sort(name).shape, one.pose))
            if self.held is None:
                views = self._without_arm(views, readings)
            for one in find(views, lost, known, hidden):
                seen[one.block] = one
        found = list[BlockReading]()
        for name, one in seen.items():
            if one.look == Look.SEEN:
                self._keep(name, one, readings)
                reading = BlockReading(name, one.pose, one.covariance, readings.time)
                found.append(reading)
        return tuple(found)

    def _without_arm(
        self, views: Sequence[PreparedPicture], readings: Readings
    ) -> list[PreparedPicture]:
        return without_arm(views, self._picture_of_arm.at(readings.joints, readings.tool.width))

    @cached_property
    def _picture_of_arm(self) -> ArmPicture:
        return ArmPicture(self.arm)

    def _sort(self, name: str) -> Sort:
        return self.sorts[self.kind[name]]

    def _believed(self, name: str, pose: np.ndarray | None, stands: bool = False) -> Believed:
        sort = self._sort(name)
        return Believed(name, sort.shape, pose, sort.turns, AT_REST, stands)

    def _alone(self) -> set[str]:
        """Blocks that stand on the table with nothing beside them; none where it is not known of
        every block where it is: any one may lean on that."""
        there = {name: pose for name, pose in self.expected.items() if pose is not None}
        if len(there) < len(self.expected):
            return set()
        bodies = [(self._sort(name).shape, pose) for name, pose in there.items()]
        found = alone([*bodies, *self.fixed])
        held = self.held and self.held[0]
        return {name for name, one in zip(there, found, strict=False) if one and name != held}

    def _keep(self, name: str, seen: Seen, readings: Readings) -> None:
        """A block was seen: it is expected there next, but for what the pictures do not say."""
        before, there = self.expected[name], seen.pose
        if before is not None:
            expected = np.diag(np.repeat(AT_REST, 3) ** 2)
            turn = quaternion_matrix(there[3:]) @ quaternion_matrix(before[3:]).T
            spin = matrix_quaternion(turn)
            vector = 2 * spin[1:] * (1.0 if spin[0] >= 0 else -1.0)
            step = np.concatenate([there[:3] - before[:3], vector])
            step = expected @ np.linalg.solve(expected + seen.covariance, step)
            turned = rotation(step[3:]) @ quaternion_matrix(before[3:])
            there = np.array([*(before[:3] + step[:3]), *matrix_quaternion(turned)])
        self.expected[name] = there
        if self.held is not None and self.held[0] == name:
            self.held = name, *self._in_tool(there, readings.joints)

    def _in_tool(self, pose: np.ndarray, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        place, turn = forward(self.chain, joints)
        return turn.T @ (pose[:3] - place), turn.T @ quaternion_matrix(pose[3:])

    # ------------------------------------------------------------ what the arm did

    def _follow(self, report: Report) -> None:
        """What is in the hand moved with it."""
        holds = holding(report.tool)
        self.handled |= holds != (self.held is not None)
        if self.held is not None:
            name, where, way = self.held
            place, turn = forward(self.chain, report.joints)
            pose = np.array([*(place + turn @ where), *matrix_quaternion(turn @ way)])
            together = {name, *(one for one, lead in self.joined.items() if lead == name)}
            before = self.expected[name]
            for one in together:
                self.expected[one] = _along(self.expected[one], before, pose)
            self.expected[name] = pose
            if report.stop in (Stop.VACUUM, Stop.WIDTH):
                self.expected.update(dict.fromkeys(together))
            if not holds:
                self.held = None
                self.joined.clear()
        elif holds:
            name = self._nearest(report.joints)
            if name is not None:
                pose = self.expected[name]
                assert pose is not None
                self.held = name, *self._in_tool(pose, report.joints)

    def _nearest(self, joints: np.ndarray) -> str | None:
        """The block that is nearest to the tool."""
        point = forward(self.chain, joints)[0]
        best, found = NEAR_TOOL, None
        for name, pose in self.expected.items():
            if pose is not None:
                hull = body_of(self._sort(name).shape).hull
                local = quaternion_matrix(pose[3:]).T @ (point - pose[:3])
                away = float((hull.normals @ local - hull.offsets).max())
                if away < best:
                    best, found = away, name
        return found


def _along(
    pose: np.ndarray | None, before: np.ndarray | None, after: np.ndarray
) -> np.ndarray | None:
    """float64[7]: where a pose is when another one that it moves with was and is there."""
    if pose is None or before is None:
        return None
    change = quaternion_matrix(after[3:]) @ quaternion_matrix(before[3:]).T
    place = after[:3] + change @ (pose[:3] - before[:3])
    return np.array([*place, *matrix_quaternion(change @ quaternion_matrix(pose[3:]))])


def holding(tool: ToolReading) -> bool:
    """Whether a tool says that it has taken hold of something."""
    return bool(tool.vacuum) or (tool.grip or 0.0) > 1.0
