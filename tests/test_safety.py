"""What an arm may not do: no motion that breaks a rule is passed on, whoever planned it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import learn2assemble as l2a
from learn2assemble.cell.site import Site, read_site
from learn2assemble.errors import InputError
from learn2assemble.kinematics.chain import forward_many, get_chain
from learn2assemble.plants.plant import (
    Commands,
    Guard,
    Guards,
    Motion,
    Readings,
    Report,
    Request,
    Stop,
    ToolCommand,
    ToolReading,
    between,
)
from learn2assemble.plants.safety import Box, Guarded, Safety, SafetyRules, parse_safety
from learn2assemble.robot.arm import get_arm

ARM = get_arm("ur5e", "suction")


class Told:
    """A plant that remembers what it was told."""

    def __init__(self) -> None:
        self.motions: list[tuple[Motion, list[ToolCommand], list[Guard]]] = []

    def sense(self) -> Readings:
        return Readings(0.0, ARM.home, ARM.home * 0, (), ToolReading(), "ur5e")

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        self.motions.append((motion, list(commands), list(guards)))
        return Report(Stop.END, 1.0, ARM.home, motion.seconds)

    def request(self, request: Request) -> Report:
        return Report(Stop.END, 1.0, ARM.home, 0.0)

    def stop(self) -> None: ...

    def close(self) -> None: ...


def motion(seed: int, count: int, way: float) -> Motion:
    """Through random joints around home, with random velocities between rest and rest."""
    rng = np.random.default_rng(seed)
    joints = np.clip(ARM.home + rng.uniform(-way, way, (count, 6)), ARM.lower, ARM.upper)
    velocity = rng.uniform(-1.0, 1.0, (count, 6))
    velocity[[0, -1]] = 0
    return Motion(
        "cross", np.concatenate([[0], rng.uniform(0.3, 1.0, count - 1).cumsum()]), joints, velocity
    )


def tool(found: Motion, count: int = 4001) -> np.ndarray:
    """Where the tool point is all along a motion, float64[count, 3] [m]."""
    q = between(found, np.linspace(0, found.seconds, count))[0]
    return forward_many(get_chain(ARM), np.ascontiguousarray(q))[0]


HOME = tool(Motion("", np.array([0.0, 1.0]), np.stack([ARM.home] * 2), np.zeros((2, 6))), 1)[0]


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    count=st.integers(2, 5),
    way=st.floats(0.01, 0.6),
    low=st.tuples(*[st.floats(0.02, 0.4)] * 3),
    high=st.tuples(*[st.floats(0.02, 0.4)] * 3),
    speed=st.floats(0.05, 1.0),
    share=st.floats(0.1, 1.0),
)
def test_nothing_that_leaves_the_box_or_is_too_fast_is_passed_on(
    seed: int, count: int, way: float, low: Any, high: Any, speed: float, share: float
) -> None:
    plant, asked = Told(), motion(seed, count, way)
    box = Box(tuple((HOME - low).tolist()), tuple((HOME + high).tolist()))
    guarded = Guarded(plant, ARM, Safety(box=box, speed=speed), share)
    report = guarded.execute(asked, [ToolCommand(0.1, vacuum=True)], [Guard(0.2, hold="kept")])
    path = tool(asked)
    out = np.maximum(np.array(box.low) - path, path - np.array(box.high)).max()
    if report.stop is Stop.REFUSED:
        # Nothing is refused that is well within.
        assert not plant.motions
        assert out > -2e-3
        assert "box" in report.detail
        return
    assert out <= 0
    ((told, commands, guards),) = plant.motions
    factor = told.seconds / asked.seconds
    assert factor >= 1 / share - 1e-9
    assert commands[0].at == pytest.approx(0.1 * factor)
    assert guards[-1].begin == pytest.approx(0.2 * factor)
    way_ = tool(told)
    assert np.abs(way_ - path).max() <= 1e-9
    steps = np.linalg.norm(np.diff(way_, axis=0), axis=1)
    fastest = steps.max() / (told.seconds / (len(way_) - 1))
    assert fastest <= speed * (1 + 1e-6)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    way=st.floats(0.05, 0.8),
    away=st.tuples(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(-0.4, 0.3)),
    size=st.floats(0.02, 0.15),
)
def test_no_part_of_the_arm_enters_what_is_kept_out(
    seed: int, way: float, away: Any, size: float
) -> None:
    middle = HOME + away
    box = Box(tuple((middle - size).tolist()), tuple((middle + size).tolist()))
    plant, asked = Told(), motion(seed, 3, way)
    report = Guarded(plant, ARM, Safety(keep_out=(box,))).execute(asked)
    path = tool(asked)
    inside = ((path > box.low) & (path < box.high)).all(1).any()
    # Judged by another program: collisions, not distances.
    touched = inside or collides(asked, box)
    if report.stop is Stop.REFUSED:
        assert not plant.motions
        assert "keep" in report.detail or "kept" in report.detail
    else:
        assert not touched


def collides(asked: Motion, box: Box) -> bool:
    """Whether MuJoCo finds a contact of the arm with the box anywhere on the way."""
    import mujoco

    from learn2assemble.robot.arm import arm_spec

    spec = arm_spec(ARM)
    middle, half = np.add(box.low, box.high) / 2, np.subtract(box.high, box.low) / 2
    geom = spec.worldbody.add_geom(
        name="box", type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=middle
    )
    geom.contype = geom.conaffinity = 7
    model = spec.compile()
    data = mujoco.MjData(model)
    rows = [int(model.joint(name).qposadr[0]) for name in ARM.joints]
    moving = {model.geom(g).id for g in range(model.ngeom) if model.geom_bodyid[g]}
    for q in between(asked, np.linspace(0, asked.seconds, 60))[0]:
        data.qpos[rows] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        for pair, far in zip(data.contact.geom, data.contact.dist, strict=True):
            named = {model.geom(int(g)).name for g in pair}
            fixed = model.geom_bodyid[pair].min() == 0 and set(pair.tolist()) & moving
            if "box" in named and fixed and far < 0:
                return True
    return False


def test_a_keep_out_box_at_the_tool_is_found_and_one_far_away_is_not() -> None:
    still = Motion("home", np.array([0.0]), ARM.home[None], np.zeros((1, 6)))
    near = Box(tuple((HOME - 0.02).tolist()), tuple((HOME + 0.02).tolist()))
    far = Box((3.0, 3.0, 3.0), (3.1, 3.1, 3.1))
    assert "keep_out[1]" in SafetyRules(ARM, Safety(keep_out=(far, near))).breach(still)
    assert not SafetyRules(ARM, Safety(keep_out=(far,))).breach(motion(1, 4, 0.5))
    assert collides(motion(1, 2, 0.3), near)
    assert not collides(motion(1, 2, 0.3), far)


def test_every_motion_stops_at_the_largest_force() -> None:
    plant = Told()
    guarded = Guarded(plant, ARM, Safety(force=30.0))
    guarded.execute(motion(1, 3, 0.1))
    guarded.execute(motion(1, 3, 0.1), (), [Guard(0.5, contact=50.0, force=5.0, hold="kept")])
    assert [guard.force for guard in plant.motions[0][2]] == [30.0]
    first, second = plant.motions[1][2]
    assert (first.begin, first.force, first.held) == (0.0, 30.0, 30.0)
    assert (second.contact, second.force, second.hold) == (30.0, 5.0, "kept")


def test_without_rules_motions_pass_as_they_are() -> None:
    plant, asked = Told(), motion(2, 3, 0.1)
    guarded = Guarded(plant, ARM, Safety())
    guarded.execute(asked)
    empty = Motion("pick", *[np.zeros(0)] * 2, np.zeros((0, 6)))
    guarded.execute(empty, [ToolCommand(vacuum=True)])
    assert plant.motions[0][0] is asked
    assert plant.motions[1][0] is empty


@pytest.mark.parametrize("arms", [("panda",), ("panda", "ur5e")])
def test_rules_that_an_arm_breaks_where_it_waits_are_refused_before_it_moves(
    arms: tuple[str, ...],
) -> None:
    flat = Site(safety=Safety(box=Box((-2.0, -2.0, 0.0), (2.0, 2.0, 0.2))))
    told: list[str] = []
    with pytest.raises(InputError, match=r"outside the layout's safety\.box, where \w+ waits"):
        l2a.build(np.ones((4, 1, 1), bool), arm=arms, layout=flat, progress=told.append)
    assert not any(line.startswith("starting") for line in told)


@pytest.mark.parametrize("speed", [0.0, 1.01, -1.0, 1e-9, float("nan")])
def test_a_speed_that_is_no_share_is_refused(speed: float) -> None:
    with pytest.raises(InputError, match="speed"):
        Guarded(Told(), ARM, Safety(), speed)


def test_rules_are_read() -> None:
    found = parse_safety(
        {
            "box": [[-1, -1, 0], [1, 1, 1.2]],
            "speed": 0.5,
            "force": 40,
            "keep_out": [[[0.5, 0.5, 0], [0.6, 0.6, 2]]],
        },
        "layout: safety",
    )
    assert found.box == ((-1, -1, 0), (1, 1, 1.2))
    assert (found.speed, found.force) == (0.5, 40)
    assert found.keep_out == (((0.5, 0.5, 0), (0.6, 0.6, 2)),)
    assert parse_safety({}, "") == Safety()


@pytest.mark.parametrize(
    "value",
    [
        {"boxes": []},
        {"box": [[0, 0, 0]]},
        {"box": [[0, 0, 0], [1, 1]]},
        {"box": [[0, 0, 0], [1, 1, 0]]},
        {"box": [[0, 0, 0], [1, 1, 1], [2, 2, 2]]},
        {"box": "large"},
        {"box": [[0, 0, 0], [1, 1, float("inf")]]},
        {"speed": 0},
        {"speed": 1e-7},
        {"speed": "fast"},
        {"force": 1e9},
        {"keep_out": {}},
        {"keep_out": [[1, 2]]},
        [],
    ],
)
def test_rules_that_are_wrong_are_refused_in_one_line(value: Any) -> None:
    with pytest.raises(InputError, match="layout: safety") as error:
        parse_safety(value, "layout: safety")
    assert "\n" not in str(error.value)


def test_a_layout_says_them(tmp_path: Path) -> None:
    file = tmp_path / "layout.json"
    rules = {"speed": 0.3, "keep_out": [[[-1, -2, 1], [1, 2, 3]]]}
    head = {"format": "learn2assemble-layout", "version": 2}
    file.write_text(json.dumps({**head, "safety": rules}))
    site = read_site(file)
    assert site.safety == parse_safety(rules, "")
    (kept,) = site.kept_out
    assert (kept.middle, kept.size) == ((0, 0, 2), (2, 4, 2))
    file.write_text(json.dumps({**head, "safety": {"speed": -1}}))
    with pytest.raises(InputError, match=r"safety\.speed"):
        read_site(file)
