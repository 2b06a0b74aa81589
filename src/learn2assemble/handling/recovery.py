"""After an attempt that failed: all comes to rest, the arm leaves, and what it holds goes back."""

from __future__ import annotations

import numpy as np

from learn2assemble.handling.execution import BLIND, Execution
from learn2assemble.handling.prepare import rest_pose
from learn2assemble.handling.ways import WorldChecker, free_way
from learn2assemble.motion.program import LOAD_TIME
from learn2assemble.plants.plant import Guard, ToolCommand
from learn2assemble.robot.moves import STAGES, Failure
from learn2assemble.simulation.model import TIMESTEP

BACK_STRIDE = 25
"""Samples between the corners of a way back."""


def abandon(run: Execution, failure: Failure, recover: bool) -> Failure:
    """End an attempt that failed; every object comes to rest.

    Args:
        run: the attempt; its arm has stopped.
        failure: why.
        recover: put what is held back and bring the arm home; else it stays where it is.

    Returns:
        the failure, with a word on what became of what was held.
    """
    _settle(run, failure.stage)
    words = ""
    if recover and failure.stage != "rest":
        words = "the arm is home"
        try:
            if run.holding:
                _put_back(run)
                words = "put back"
            _leave(run)
        except Failure as second:
            words = f"then {second.stage}: {second.detail}"
        _settle(run, "home")
    words = "still in the hand" if run.holding else words
    detail = f"{failure.detail}; {words}" if words else failure.detail
    return Failure(failure.outcome, failure.stage, detail)


HOLDS = 0.5
"""Both fingers press what is in the hand with this much at least [N]: half a block's weight."""


def _settle(run: Execution, stage: str) -> None:
    """Wait until everything rests but what is in the hand, whatever was meant."""
    run.rig.senses.settle(stage if stage in STAGES else "home")
    felt, held = run.rig.plant.sense().tool, run.holding
    if felt.vacuum is not None:
        run.holding = felt.vacuum
    else:
        run.holding = run.closed and (felt.grip or 0.0) >= HOLDS
    if held and not run.holding:
        run.rig.senses.lost()
    suction = run.rig.arm.suction
    if suction is not None and run.closed and not run.holding:
        # A cup that has come off takes hold again only after its vacuum was turned off.
        run.closed = False
        seconds = max(LOAD_TIME, suction.release_time + TIMESTEP)
        run.wait(seconds, "release", BLIND, (ToolCommand(load=0.0), ToolCommand(vacuum=False)))
    elif held and not run.holding:
        run.wait(LOAD_TIME, "release", BLIND, (ToolCommand(load=0.0),))


def _put_back(run: Execution) -> None:
    """The way here backwards, and down where the object came from."""
    pick, across = run.course.plan.pick, run.course.across
    kept = Guard(hold="kept")
    if run.unmoved:
        # It is where it was taken, and lies on what it lay on.
        run.release("release", BLIND)
        return
    if run.inside is not pick:
        run.rise("place", kept)
        run.carry(np.vstack([run.joints, across[: run.segments_done + 1][-2::-1]]), kept)
    run.lower(pick, "place", kept, kept)
    run.release("release", BLIND)


def _leave(run: Execution) -> None:
    """Up, and home if there is a free way."""
    rig = run.rig
    run.rise("retreat", BLIND)
    if rig.world is None:
        run.travel(np.array([run.joints, rig.arm.home]), "home", BLIND)
        return
    checker = WorldChecker(rig.arm, rig.world, rig.senses.look(), run.order.names)
    checker.empty(run.order.opening)
    if checker.check(run.joints) is not None:
        _back_off(run, checker)
    run.travel(free_way(checker, run.joints, rest_pose(rig.arm, checker), "home"), "home", BLIND)


def _back_off(run: Execution, checker: WorldChecker) -> None:
    """Back the way the arm has come, to where it last touched nothing, if it ever did."""
    past = np.vstack([run.joints[None], *(played.joints for _, played in run.log)])[::-1]
    free = next((k for k, joints in enumerate(past) if checker.check(joints) is None), None)
    if free is None:
        return
    way = past[: free + 1]
    corners = np.unique(np.r_[0:free:BACK_STRIDE, free])
    run.travel(np.vstack([run.joints, way[corners][1:]]), "retreat", BLIND)
