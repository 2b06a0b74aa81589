"""After a failure: the arm leaves, and what it holds goes back to where it came from."""

from __future__ import annotations

import numpy as np

from learn2assemble.robot.execution import BLIND, LOAD_TIME, REST_TIME, Execution
from learn2assemble.robot.mjcf import TIMESTEP
from learn2assemble.robot.motion import OPENING
from learn2assemble.robot.outcome import Outcome
from learn2assemble.robot.prepare import Failure, rest_pose
from learn2assemble.robot.transit import Surroundings, Touch, straight_or_tree
from learn2assemble.world.blocks import EDGE

BACK_STRIDE = 25
"""Samples between the corners of a way back."""
HOLDS = 0.5
"""Both fingers press what is in the hand with this much at least [N]: half a block's weight."""


def abandon(run: Execution, failure: Failure, recover: bool) -> Failure:
    """End an attempt that failed; every object comes to rest.

    Args:
        run: the attempt; its arm has stopped.
        failure: why.
        recover: put what is held back and bring the arm home; else it stays where it is.

    Returns:
        the failure, with a word on what became of what was held.
    """
    sim = run.sim
    sim.let_go()
    _settle(run)
    words = ""
    if recover and failure.stage != "rest":
        words = "the arm is home"
        try:
            if run.holding:
                sim.hold()
                _put_back(run)
                words = "put back"
            _leave(run)
        except Failure as second:
            words = f"then {second.stage}: {second.detail}"
            sim.let_go()
        _settle(run)
    words = "still in the hand" if run.holding else words
    detail = f"{failure.detail}; {words}" if words else failure.detail
    return Failure(failure.outcome, failure.stage, detail)


def _settle(run: Execution) -> None:
    """Wait until everything rests but what both fingers hold, whatever was meant."""
    sim = run.sim

    def in_hand() -> bool:
        return sim.width < EDGE and run.grip() >= HOLDS

    watch = BLIND._replace(until=lambda: sim.asleep(besides=in_hand()))
    sim.wait(round(REST_TIME / TIMESTEP), sim.stage, watch)
    run.holding = in_hand()
    if not run.holding:
        sim.load(0.0, round(LOAD_TIME / TIMESTEP), sim.stage, BLIND)


def _put_back(run: Execution) -> None:
    """The way here backwards, and down where the object came from."""
    pick, across = run.course.plan.pick, run.course.across
    if run.inside is not pick:
        run.rise("place", BLIND)
        run.carry(np.vstack([run.sim.joints, across[: run.legs + 1][-2::-1]]), BLIND)
    run.lower(pick, "place", BLIND, BLIND)
    run.release("release", BLIND)


def _leave(run: Execution) -> None:
    """Up, and home if there is a free way."""
    sim = run.sim
    run.rise("retreat", BLIND)
    around = Surroundings(sim.arm, sim.world, sim.poses.copy(), run.order.names)
    around.empty(OPENING)
    if around.touch(sim.joints) is not None:
        _back_off(run, around)
    way = straight_or_tree(around, sim.joints, rest_pose(sim.arm, around))
    if isinstance(way, Touch):
        raise Failure(Outcome.UNREACHABLE, "home", f"no free way: {way.words}")
    run.travel(way, "home", BLIND)


def _back_off(run: Execution, around: Surroundings) -> None:
    """Back the way the arm has come, to where it last touched nothing, if it ever did."""
    past = run.sim.recorder.joints[::-1]
    free = next((k for k, joints in enumerate(past) if around.touch(joints) is None), None)
    if free is None:
        return
    way = past[: free + 1]
    corners = np.unique(np.r_[0:free:BACK_STRIDE, free])
    run.travel(np.vstack([run.sim.joints, way[corners][1:]]), "retreat", BLIND)
