"""What an arm may not do whatever it is told: leave a box, enter others, be fast, press hard.

The section ``safety`` of a layout file. :class:`Guarded` stands between whoever plans and a plant:
a motion that could break a rule anywhere between its samples is not passed on, one that is too fast
is slowed down on its path, and every motion stops at the largest force.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.kinematics.chain import Chain, forward_many, get_chain
from learn2assemble.plants.plant import (
    Commands,
    Guard,
    Guards,
    Motion,
    Plant,
    Report,
    Stop,
    ToolCommand,
    WrappedPlant,
    between,
)
from learn2assemble.plants.settings import SLOWEST_SHARE
from learn2assemble.robot.arm import Arm, arm_spec
from learn2assemble.values import check_keys, mapping, number, rounded, sequence

SECTION = "safety"
"""Key of the rules in a layout file."""
RULES = "the layout's safety."
"""What a reason calls a rule by, before its key."""
KEYS = ("box", "speed", "force", "keep_out")
FAST, STRONG, FAR = 10.0, 1000.0, 100.0
"""Largest limits that make sense [m/s], [N]; no corner is farther from the origin [m]."""
CRAWL = 0.001
"""Smallest limit of the speed that makes sense [m/s]: slower motions have samples without end."""
SHORTEST = 5e-4
"""A rule that cannot be shown to hold over so short a time counts as broken [s]."""
GRID = 2e-3
"""Between two instants at which the speed is computed [s]."""
SEEN = 0.5
"""Distances from boxes are computed up to this [m]."""


class Box(NamedTuple):
    """A box along the axes of the world."""

    low: tuple[float, float, float]
    """[m]"""
    high: tuple[float, float, float]
    """[m]"""


class Safety(NamedTuple):
    """The rules; what is None has no limit of its own."""

    box: Box | None = None
    """The tool point does not leave it."""
    speed: float | None = None
    """Of the tool point [m/s]."""
    force: float | None = None
    """On the tool and what it holds [N]."""
    keep_out: tuple[Box, ...] = ()
    """No part of arm and tool enters them."""


def parse_safety(value: Any, where: str) -> Safety:
    """The rules a section holds.

    Args:
        value: of the key ``safety``, from JSON.
        where: what messages call it.

    Raises:
        InputError: naming the key that is wrong.
    """
    given = mapping(value, where)
    check_keys(given, where, "", KEYS, ())
    boxes: list[Box] = []
    if "keep_out" in given:
        listed = sequence(given["keep_out"], f"{where}.keep_out", "a list of boxes")
        boxes = [_box(one, f"{where}.keep_out[{k}]") for k, one in enumerate(listed)]
    return Safety(
        _box(given["box"], f"{where}.box") if "box" in given else None,
        _limit(given, "speed", CRAWL, FAST, where),
        _limit(given, "force", 0.0, STRONG, where),
        tuple(boxes),
    )


def check_share(speed: float) -> None:
    """Refuse what is no share of the planned speed that a motion can be slowed down to."""
    if not SLOWEST_SHARE <= number(speed, "speed") <= 1:
        raise InputError("speed", speed, f"a share, {SLOWEST_SHARE:g} to 1")


def _limit(given: Any, key: str, least: float, most: float, where: str) -> float | None:
    if key not in given:
        return None
    found = number(given[key], f"{where}.{key}")
    if not 0 < found <= most or found < least:
        expected = f"{least:g} to {most:g}" if least else f"above 0, up to {most:g}"
        raise InputError(f"{where}.{key}", found, expected)
    return found


def _box(value: Any, where: str) -> Box:
    expected = "[[x, y, z], [x, y, z]] in metres: its lowest corner, and its highest"
    corners: list[tuple[float, float, float]] = []
    for corner in sequence(value, where, expected):
        x, y, z = [number(v, where) for v in sequence(corner, where, expected)] + [FAR] * (
            3 - len(corner)
        )
        corners.append((x, y, z))
    if len(corners) != 2 or not all(
        -FAR < a < b < FAR for a, b in zip(corners[0], corners[-1], strict=True)
    ):
        raise InputError(where, value, expected)
    return Box(corners[0], corners[1])


class SafetyRules:
    """Whether the motions of an arm keep the rules.

    Args:
        arm: with its tool, where it stands.
        safety: the rules.
    """

    def __init__(self, arm: Arm, safety: Safety) -> None:
        self.arm = arm
        self.safety = safety
        self.chain: Chain = get_chain(arm)
        ways = np.linalg.norm(self.chain.offset, axis=1)
        after = np.cumsum(ways[::-1])[::-1] - ways
        self._tool_reach = after + float(np.linalg.norm(self.chain.tool_offset))
        """float64[n]: the tool point is no farther from the axis of a joint [m]."""
        spec = arm_spec(arm)
        for k, (low, high) in enumerate(safety.keep_out):
            middle, half = (np.add(high, low) / 2), (np.subtract(high, low) / 2)
            spec.worldbody.add_geom(
                name=f"keep out {k}", type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=middle
            )
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        model = self._model
        self._joint = [int(model.joint(name).qposadr[0]) for name in arm.joints]
        self._boxes = [model.geom(f"keep out {k}").id for k in range(len(safety.keep_out))]
        first = {int(model.joint(name).bodyid[0]) for name in arm.joints}
        moving = [k for k in range(model.nbody) if _moves(model, k, first)]
        self._geoms = [
            g
            for g in range(model.ngeom)
            if model.geom_bodyid[g] in moving
            and (model.geom_contype[g] or model.geom_conaffinity[g])
        ]
        size = max(
            (float(model.geom_rbound[g] + np.linalg.norm(model.geom_pos[g])) for g in self._geoms),
            default=0.0,
        )
        inner = max((float(np.linalg.norm(model.body_pos[k])) for k in moving), default=0.0)
        # Fingers and tools hang below the last joint, one body in another.
        self._arm_reach = self._tool_reach + size + inner

    def breach(self, motion: Motion) -> str:
        """What a motion could break, in words; empty where it is shown that it breaks nothing but,
        perhaps, the largest speed."""
        if not len(motion.time):
            return ""
        if self.safety.box is None and not self.safety.keep_out:
            return ""
        if len(motion.time) == 1 or not motion.seconds:
            return self._at(motion.joints[:1])[0]
        begin, end = motion.time[:-1], motion.time[1:]
        _, _, a0 = between(motion, begin)
        _, _, a1 = between(motion, end - 1e-9)
        fastest = np.maximum(np.abs(a0), np.abs(a1)) * 1.001 + 1e-6
        while len(begin):
            half = (end - begin) / 2
            q, v, _ = between(motion, begin + half)
            most = (np.abs(v) + fastest * half[:, None]) * half[:, None]
            open_: list[int] = []
            words, spare, near = self._margins(q)
            tool, arm = most @ self._tool_reach, most @ self._arm_reach
            for k in range(len(begin)):
                if words[k]:
                    return f"{words[k]} at {begin[k] + half[k]:.2f} s"
                if spare[k] < tool[k] or near[k] < arm[k]:
                    if half[k] < SHORTEST:
                        what = f"the tool may leave {RULES}box"
                        if spare[k] >= tool[k]:
                            what = f"the arm may enter a box of {RULES}keep_out"
                        return f"{what} at {begin[k] + half[k]:.2f} s"
                    open_.append(k)
            a, b, m, f = begin[open_], end[open_], (begin + half)[open_], fastest[open_]
            begin, end = np.concatenate([a, m]), np.concatenate([m, b])
            fastest = np.concatenate([f, f])
        return ""

    def _at(self, q: np.ndarray) -> list[str]:
        return self._margins(q)[0]

    def _margins(self, q: np.ndarray) -> tuple[list[str], np.ndarray, np.ndarray]:
        """At joints float64[m, n]: what is broken, in words; how far the tool point is within its
        box, float64[m]; and the arm from the boxes that are kept out, float64[m] [m]."""
        words, spare = [""] * len(q), np.full(len(q), np.inf)
        near = np.full(len(q), np.inf)
        if self.safety.box is not None:
            position = forward_many(self.chain, np.ascontiguousarray(q))[0]
            low, high = np.array(self.safety.box)
            spare = np.minimum(position - low, high - position).min(1)
            for k in np.flatnonzero(spare < 0).tolist():
                place = ", ".join(f"{rounded(x, 3):.3f}" for x in position[k])
                words[k] = f"the tool would be at {place}, outside {RULES}box"
        if self._boxes:
            for k in range(len(q)):
                near[k], box = self._distance(q[k])
                if near[k] <= 0:
                    words[k] = words[k] or f"the arm would be in {RULES}keep_out[{box}]"
        return words, spare, near

    def _distance(self, q: np.ndarray) -> tuple[float, int]:
        """From the nearest box that is kept out [m], and which."""
        model, data = self._model, self._data
        data.qpos[self._joint] = q
        mujoco.mj_kinematics(model, data)
        found, line = (SEEN, 0), np.empty(6)
        for k, box in enumerate(self._boxes):
            for geom in self._geoms:
                middle = np.linalg.norm(data.geom_xpos[geom] - data.geom_xpos[box])
                if middle - model.geom_rbound[geom] - model.geom_rbound[box] >= found[0]:
                    continue
                far = mujoco.mj_geomDistance(model, data, geom, box, found[0], line)
                found = min(found, (float(far), k))
        return found

    def peak_speed(self, motion: Motion) -> float:
        """No smaller than the largest speed of the tool point [m/s], hardly larger."""
        if len(motion.time) < 2 or not motion.seconds:
            return 0.0
        count = max(int(np.ceil(motion.seconds / GRID)), 1)
        at = (np.arange(count) + 0.5) * motion.seconds / count
        q, v, a = between(motion, at)
        step = 1e-4
        ahead, _ = forward_many(self.chain, np.ascontiguousarray(q + step * v))
        behind, _ = forward_many(self.chain, np.ascontiguousarray(q - step * v))
        speed = np.linalg.norm(ahead - behind, axis=1) / (2 * step)
        reach = self._tool_reach
        change = np.abs(a) @ reach + (np.abs(v) @ reach) * np.abs(v).sum(1)
        return float((speed + change * motion.seconds / count).max())


def _moves(model: mujoco.MjModel, body: int, first: set[int]) -> bool:
    while body:
        if body in first:
            return True
        body = int(model.body_parentid[body])
    return False


def guarded(plant: Plant, arm: Arm, safety: Safety) -> Plant:
    """A plant that is told nothing that breaks the rules; the plant itself where there are none.

    Args:
        plant, arm, safety: as of :class:`Guarded`.
    """
    return plant if safety == Safety() else Guarded(plant, arm, safety)


def check_home(arm: Arm, safety: Safety) -> None:
    """Refuse rules that an arm breaks where it waits, before anything moves.

    Args:
        arm, safety: as of :class:`Guarded`.

    Raises:
        InputError: saying where it would be.
    """
    still = Motion("home", np.zeros(1), arm.home[None], np.zeros_like(arm.home[None]))
    why = "" if safety == Safety() else SafetyRules(arm, safety).breach(still)
    if why:
        got = f"{why}, where {arm.name} waits"
        raise InputError("layout", got, "rules of safety that the arm keeps where it waits")


def by_rule(reason: str) -> bool:
    """Whether a motion was refused for this reason because it would have broken a rule, as it will
    be again."""
    return RULES in reason


class Guarded(WrappedPlant):
    """A plant that is told nothing that breaks the rules.

    Args:
        plant: the one behind it.
        arm: with its tool, where it stands.
        safety: the rules.
        speed: share of the planned speed that is used, 0.001 to 1.

    Raises:
        InputError: for another speed.
    """

    def __init__(self, plant: Plant, arm: Arm, safety: Safety, speed: float = 1.0) -> None:
        check_share(speed)
        super().__init__(plant)
        self.rules: SafetyRules = SafetyRules(arm, safety)
        self.safety = safety
        self.speed = speed

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`; a motion that breaks a rule is refused
        and not passed on."""
        why = self.rules.breach(motion)
        if why:
            return Report(Stop.REFUSED, 0.0, motion.joints[0].copy(), 0.0, why)
        factor = 1 / self.speed
        if self.safety.speed is not None:
            factor = max(factor, self.rules.peak_speed(motion) / self.safety.speed)
        if factor > 1:
            motion, commands, guards = _slower(motion, commands, guards, factor)
        return self.plant.execute(motion, commands, self._pressed(guards))

    def _pressed(self, guards: Guards) -> Guards:
        """The guards, with the largest force."""
        most = self.safety.force
        if most is None:
            return guards
        first = [] if guards and guards[0].begin <= 0 else [Guard()]

        def least(value: float | None) -> float:
            return most if value is None else min(value, most)

        return [
            one._replace(
                force=least(one.force),
                held=least(one.held),
                taken=least(one.taken),
                contact=None if one.contact is None else min(one.contact, most),
            )
            for one in (*first, *guards)
        ]


def _slower(
    motion: Motion, commands: Commands, guards: Guards, factor: float
) -> tuple[Motion, list[ToolCommand], list[Guard]]:
    """A motion on the same path in ``factor`` times its time, with what happens during it."""
    return (
        Motion(motion.stage, motion.time * factor, motion.joints, motion.velocity / factor),
        [one._replace(at=one.at * factor) for one in commands],
        [one._replace(begin=one.begin * factor) for one in guards],
    )
