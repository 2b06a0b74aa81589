"""Which motions in the program of one arm wait for which in that of the other one.

Two arms have built at the same time, on one clock that robots do not share. What has to be kept of
their order is a graph between their motions (an action dependency graph, Hönig et al. 2019): a
motion waits for those of the other arm that began before it, or before it went on without a stop,
where both would come nearer to each other than the arms keep, whatever each is doing of its way
when; and what touches the structure waits for all that the other arm had changed in it by then.
What is done by hand, for which one of the two programs asks, waits for all that the other arm began
before, and all that it began later waits for that: somebody is in the cell. Whatever else each does
when it may, so one that is late, or stopped, leaves the other one safe. Nothing waits for what
began after it went on, so one of them can always go on.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import NamedTuple, Protocol

import numpy as np

from learn2assemble.errors import InputError, Learn2AssembleError
from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.kinematics.capsules import Capsules, capsules_of, in_hand, solid_capsules
from learn2assemble.kinematics.chain import forward_many, get_chain
from learn2assemble.kinematics.sweeps import Sweep, clear, sweep
from learn2assemble.motion.knots import Knots
from learn2assemble.motion.program import Program, Wait, motions
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.bodies import Part
from learn2assemble.robot.moves import STAGES

APART = 0.012
"""So far arms keep from each other [m]: where both move at once they were planned to by more."""
EVERY = 5
"""Of the knots of a motion so many are taken together: the arm is within half a millimetre of the
straight line between two that are left."""
AT_THE_STRUCTURE = ("cross", "place")
"""Stages in which a block comes to what stands there."""
MOMENTS = 9
"""At which it is looked whether a motion was on what was left of another one."""
BY_HAND = 1.0
"""In a program, what is done by hand takes so long [s]: it ends after it begins, whatever waits."""
BEFORE = 0.02
"""What began so long before something is done by hand, or longer, comes before that [s]: records
are on one clock to half a sample."""
TAKING = ("pick", "lift")
"""Stages in which a block leaves what stands there, where it stood there."""


class Left(Protocol):
    """What is left of a motion."""

    def __call__(self, now: float, until: float = math.inf) -> Sweep:
        """At a time, of what it does until another one [s], on the clock that both had."""
        ...


class _Span(NamedTuple):
    """A motion from rest to rest, or what a tool does between two of them."""

    began: float
    """[s], on the clock that both had."""
    ended: float
    """[s], the same."""
    begin: float
    """[s], in its program."""
    end: float
    """[s], in its program: of a tool, when the arm moves on."""
    needs: bool
    """Whether it touches the structure."""
    changes: bool
    """Whether the structure is another one afterwards."""
    swept: Sweep | None = None
    """Of a motion, with what is held."""
    hand: str = ""
    """What is done by hand, in words."""
    left: Left | None = None
    """Of a motion, what is left of that."""


def with_waits(programs: tuple[Program, Program], arms: tuple[Arm, Arm]) -> tuple[Program, Program]:
    """Two programs of one build, with what each waits for.

    Args:
        programs: of two arms that have built together.
        arms: where they stood.

    Raises:
        InputError: where it is not told when something was done by hand.
    """
    first, second = (_with_halts(program) for program in programs)
    programs = first, second
    parts = tuple(list(_parts(*one)) for one in zip(programs, arms, strict=True))
    one, other = (tuple(arm.base_position.tolist()) for arm in arms)
    mine = tuple(_waits(parts[0], parts[1], before=one < other))
    others = tuple(_waits(parts[1], parts[0], before=one >= other))
    made = (
        replace(first, waits=mine, awaited=tuple(wait.other for wait in others)),
        replace(second, waits=others, awaited=tuple(wait.other for wait in mine)),
    )
    return _with_stands(made[0], second), _with_stands(made[1], first)


def _with_stands(program: Program, other: Program) -> Program:
    """A program that says of the other one's posts, and nothing of what that takes from places."""
    posts = tuple(one for one in other.stands if one.by_hand)
    come = {name for place in other.places for name in place.blocks} | {one.name for one in posts}
    stands = tuple(one for one in program.stands if one.by_hand or one.name not in come)
    return replace(program, stands=stands + posts)


def _with_halts(program: Program) -> Program:
    """A program with time for what is done by hand: before a step, one after the other."""
    if any(hand.time is None for hand in program.hands):
        expected = "times of all that is done by hand, which a new build tells"
        raise InputError("trajectory.hands", "steps by hand without times", expected)
    stands = np.array([_at_rest(program, time) for _, time in program.asks])
    if not len(stands):
        return program
    begins, counts = np.unique(stands, return_counts=True)
    clock = _Rests(begins, BY_HAND * counts)
    made = _rested(program, clock, clock)
    halts = [
        clock.before(time) + BY_HAND * int((stands[:k] == time).sum())
        for k, time in enumerate(stands.tolist())
    ]
    told = (made.states[0]._replace(time=0.0), *made.states[1:])
    return replace(made, states=told, halts=tuple(halts))


def _at_rest(program: Program, time: float) -> float:
    """When the arm stands, which may still be on its way at a time [s]."""
    clock = program.knots.time
    ends = (
        float(clock[b]) for a, b in motions(program) if clock[a] < time - 1e-9 < clock[b] - 2e-9
    )
    return next(ends, time)


def on_one_clock(programs: tuple[Program, Program]) -> tuple[Program, Program]:
    """Both programs as they go on together where each is as fast as planned: with rests where they
    wait, so that their times are those of one clock.

    Args:
        programs: of :func:`with_waits`.

    Raises:
        Learn2AssembleError: where each waits for what the other one does after it.
    """
    rests = [np.zeros(len(program.waits)) for program in programs]
    begins = [np.array([wait.time for wait in program.waits]) for program in programs]
    settled, rounds = False, 2 + 2 * sum(map(len, begins))
    while not settled:
        # Times settle along chains of waits, and no chain is longer than there are any.
        if rounds < 0:
            raise Learn2AssembleError(
                "the programs of both arms would wait for one another for ever"
            )
        settled, rounds = True, rounds - 1
        for who, program in enumerate(programs):
            for n, wait in enumerate(program.waits):
                other = begins[1 - who] < wait.other - 1e-9
                comes = wait.other + rests[1 - who][other].sum()
                rest = max(comes - wait.time - rests[who][:n].sum(), 0.0)
                settled = settled and rest == rests[who][n]
                rests[who][n] = rest
    clocks = [_Rests(*one) for one in zip(begins, rests, strict=True)]
    first, second = (
        _rested(program, clocks[who], clocks[1 - who]) for who, program in enumerate(programs)
    )
    return first, second


class _Rests(NamedTuple):
    """What time it is in a program that rests."""

    begins: np.ndarray
    """float64[w]: before what [s, of the program] ..."""
    rests: np.ndarray
    """float64[w]: ... it rests for so long [s]."""

    def before(self, time: float) -> float:
        """At the beginning of a rest before a time [s]."""
        return time + float(self.rests[self.begins < time - 1e-9].sum())

    def behind(self, time: float) -> float:
        """At the end of it [s]."""
        return time + float(self.rests[self.begins < time + 1e-9].sum())


def _rested(program: Program, clock: _Rests, other: _Rests) -> Program:
    """A program on one clock with the other one."""
    knots, begins = program.knots, clock.begins[clock.rests > 1e-9]
    stands = np.searchsorted(knots.time, begins - 1e-9)
    stands = np.unique(stands[np.abs(knots.time[stands] - begins) < 1e-9])
    # Each is a knot twice: where the arm comes to rest, and where it moves on.
    twice = np.sort(np.concatenate([np.arange(len(knots.time)), stands]))
    again = np.concatenate([[False], np.diff(twice) == 0])
    times = zip(knots.time[twice].tolist(), again.tolist(), strict=True)
    time = np.array([clock.behind(t) if moves_on else clock.before(t) for t, moves_on in times])
    piece = np.minimum(twice[:-1], len(program.stage) - 1)
    steps = tuple(
        step._replace(
            end=clock.before(step.end),
            checks=tuple(map(clock.behind, step.checks)),
            held=None if step.held is None else tuple(map(clock.behind, step.held)),
        )
        for step in program.steps
    )
    waits = tuple(
        wait._replace(time=clock.behind(wait.time), other=other.before(wait.other))
        for wait in program.waits
    )
    supply = tuple(one._replace(time=clock.before(one.time)) for one in program.blocks.supply)
    return replace(
        program,
        knots=Knots(time, *(part[twice] for part in knots[1:])),
        stage=program.stage[piece],
        step=program.step[piece],
        motion=np.where(again[1:], 0, program.motion[piece]),
        states=tuple(one._replace(time=clock.behind(one.time)) for one in program.states),
        steps=steps,
        blocks=program.blocks._replace(supply=supply),
        recorded=None if program.recorded is None else program.recorded[twice],
        halts=tuple(map(clock.behind, program.halts)),
        waits=waits,
        awaited=tuple(map(clock.before, program.awaited)),
    )


def _waits(mine: list[_Span], others: list[_Span], before: bool) -> Iterator[Wait]:
    """What the parts of one program wait for, each more than those before it.

    Args:
        before: of two parts that began at once, whether those of ``others`` count as later.
    """
    waited = number = 0
    for part in mine:
        began = [
            n
            for n, other in enumerate(others[waited:], waited)
            if _comes_first(other, part, before)
        ]
        found = waited
        for n in reversed(began):
            changed = part.needs and others[n].changes and others[n].ended <= part.began
            if changed or part.hand or others[n].hand or _meets(part, others[n]):
                found = n + 1
                break
        if found > waited:
            hands = tuple(other.hand for other in others[waited:found] if other.hand)
            waited, number = found, number + 1
            yield Wait(part.begin, others[found - 1].end, number, hands)


def _comes_first(other: _Span, part: _Span, before: bool) -> bool:
    """Whether a part of the other program counts as earlier; ``before`` as of :func:`_waits`."""
    if bool(other.hand) != bool(part.hand):
        hand, arm = (other, part) if other.hand else (part, other)
        return (arm.began <= hand.began - BEFORE) != bool(other.hand)
    follows = _follows(part, other)
    if follows != _follows(other, part):
        return follows
    if other.began != part.began:
        return other.began < part.began
    return not before or _is_tool(other) > _is_tool(part)


def _follows(one: _Span, other: _Span) -> bool:
    """Whether a motion that began sooner than another one, or at once, went on where that had been,
    without a stop: then it has never been on what was left of that, nor the other one ever where
    this one had been before."""
    began, ended = other.began, min(one.ended, other.ended)
    if one.left is None or other.left is None or not one.began <= began < ended:
        return False
    if not clear(one.left(one.began, began), other.left(began), APART):
        return False
    if clear(one.left(began), other.left(began), APART):
        return False
    times = np.linspace(began, ended, MOMENTS).tolist()
    return all(clear(one.left(time).begin, other.left(time), APART) for time in times)


def _is_tool(part: _Span) -> bool:
    return part.swept is None


def _meets(one: _Span, other: _Span) -> bool:
    if one.swept is None or other.swept is None:
        return False
    return not clear(one.swept, other.swept, APART)


def _parts(program: Program, arm: Arm) -> Iterator[_Span]:
    """The motions of a program and what its tool does, in order."""
    assert program.recorded is not None
    time, clock = program.knots.time, program.recorded
    made = list[_Span]()
    begins = list(motions(program))
    own = capsules_of(arm)
    held = {k: own.add(held_by(program, arm, k)) for k, s in enumerate(program.steps) if s.held}
    for a, b in begins:
        k = _step_at(program, (time[a] + time[b]) / 2)
        step, stage = program.steps[k], STAGES[int(program.stage[a])]
        holds = step.held is not None and step.held[0] < (time[a] + time[b]) / 2 < step.held[1]
        joints = program.knots.position[a : b + 1]
        times = np.append(clock[a:b:EVERY], clock[b])
        joints = np.ascontiguousarray(np.vstack([joints[:-1:EVERY], joints[-1:]]))
        capsules = held[k] if holds else own
        taken = step.pick is None and stage in TAKING
        made.append(
            _Span(
                float(clock[a]),
                float(clock[b]),
                float(time[a]),
                float(time[b]),
                taken or stage in AT_THE_STRUCTURE,
                (taken and holds) or stage == "place",
                sweep(arm, capsules, joints),
                left=partial(_left, arm, capsules, joints, times),
            )
        )
    for hand, halt in program.asks:
        assert hand.time is not None
        done = halt + BY_HAND
        made.append(
            _Span(hand.time, hand.time, halt, done, True, True, hand=hand.words)  # in the cell
        )
    ends = sorted([float(time[a]) for a, _ in begins] + [*program.halts, float(time[-1])])
    was_closed = False
    for state in program.states:
        closed = bool(state.force) or state.vacuum
        if closed != was_closed:
            step = program.steps[_step_at(program, state.time)]
            when = float(np.interp(state.time, time, clock))
            on = next(end for end in ends if end >= state.time - 1e-9)
            touches = not closed or step.pick is None
            made.append(_Span(when, when, state.time, on, touches, touches))
        was_closed = closed
    return iter(sorted(made, key=lambda part: part.begin))


def _left(
    arm: Arm,
    capsules: Capsules,
    joints: np.ndarray,
    times: np.ndarray,
    now: float,
    until: float = math.inf,
) -> Sweep:
    """What is left at a time [s] of a motion through joints float64[k, n] [rad] at times float64[k]
    [s], until another one."""
    first, last = (max(int(np.searchsorted(times, t, "right")) - 1, 0) for t in (now, until))
    return sweep(arm, capsules, joints[first : last + 1])


def _step_at(program: Program, time: float) -> int:
    """Index of the step to which a time belongs [s]."""
    ends = [step.end for step in program.steps]
    return min(int(np.searchsorted(ends, time - 1e-9)), len(ends) - 1)


def held_by(program: Program, arm: Arm, index: int) -> Capsules:
    """Capsules around what a step holds, as its hand has it."""
    step, blocks = program.steps[index], program.blocks
    assert step.held is not None
    assert step.before is not None
    q = np.ascontiguousarray(program.knots.at(np.array([step.held[0]]))[0])
    (point,), (turn,) = forward_many(get_chain(arm), q)
    found: Capsules | None = None
    for cell, pose in zip(step.cells, step.before, strict=True):
        hull = None if blocks.hull is None else blocks.hull[cell]
        x, y, z = blocks.halves[cell].tolist()
        part = Part((0.0, 0.0, 0.0), (x, y, z), hull)
        axes = turn.T @ quaternion_matrix(pose[3:])
        block = in_hand(arm, solid_capsules([part], turn.T @ (pose[:3] - point), axes))
        found = block if found is None else found.add(block)
    assert found is not None
    return found
