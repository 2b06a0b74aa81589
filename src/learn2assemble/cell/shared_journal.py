"""What is kept of a build by two arms: a file that is appended to after every attempt of either.

Every line is all that both know then, with what the one that has ended its attempt did. The other
one may be in the middle of its own: where the build is gone on with, that never happened. What it
had in its hand has been taken out of it, what a magazine had presented goes back there, and both
arms stand where they stood.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from learn2assemble.cell.building import Building
from learn2assemble.cell.journal import append_state, packed, read_states
from learn2assemble.cell.state import Done
from learn2assemble.cell.world import STOCK


class Turn(NamedTuple):
    """An attempt in the time line of a build by two arms."""

    arm: int
    done: Done
    begin: float
    """[s of the plant's clock]"""
    end: float
    """[s of the plant's clock]"""


class SharedJournal(NamedTuple):
    """The file of a build by two arms."""

    path: Path
    key: str
    """Of what is built."""

    def append(
        self, turn: Turn, begun: float, buildings: tuple[Building, ...], plant: Any, picks: Any
    ) -> None:
        """An attempt is over.

        Args:
            turn: the attempt.
            begun: when the build was [s of the plant's clock].
            buildings: of each arm.
            plant: the cell; a simulation is kept, too.
            picks: the piece that each arm is about to move.
        """
        state: dict[str, Any] = {
            "arm": turn.arm,
            "begin": turn.begin,
            "end": turn.end,
            "begun": begun,
            "picks": list(picks),
            "arms": [building.snapshot() for building in buildings],
        }
        recorder = buildings[turn.arm].recording.recorder
        if buildings[turn.arm].recorded and not turn.done.hand:
            state["record"] = packed(recorder.steps[-1])
        if hasattr(plant, "state"):
            state["plant"] = plant.state()
        append_state(self.path, state)

    def read(self, plant: Any) -> list[dict[str, Any]]:
        """What the file says, oldest first; a simulation is as it was then.

        Raises:
            InputError: for a file of another build, a damaged one, and one that cannot be written.
        """
        states = read_states(self.path, self.key)
        if states and "plant" in states[-1]:
            plant.restore(states[-1]["plant"])
        return states


def take_up(states: list[dict[str, Any]], buildings: tuple[Building, ...]) -> list[Turn]:
    """Each arm knows what it knew; the attempts that are over, by when they ended.

    Args:
        states: of :meth:`SharedJournal.read`, some.
        buildings: of each arm, which have just begun.
    """
    last, turns = states[-1], list[Turn]()
    for who, building in enumerate(buildings):
        mine = [state for state in states if state["arm"] == who]
        done = [state["arms"][who]["done"] for state in mine]
        records = [state["record"] for state in mine if "record" in state]
        building.take_up(last["arms"][who], done, records)
        ends = zip(building.known.done, mine, strict=True)
        turns += [Turn(who, one, state["begin"], state["end"]) for one, state in ends]
    for building, pick in zip(buildings, last["picks"], strict=True):
        if pick is not None and building.world.state[pick] == STOCK:
            building.hand_back(pick)
    return sorted(turns, key=lambda turn: turn.end)
