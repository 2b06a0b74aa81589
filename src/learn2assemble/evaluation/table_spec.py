"""What a table is: rows of methods, columns of tasks, and where its published numbers stand."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable
from dataclasses import dataclass, field

from learn2assemble.presets import PRESETS
from learn2assemble.search.config import SearchConfig
from learn2assemble.search.named import SEARCHES
from learn2assemble.task import Task

AGENT, LOOK_AHEAD, UNTRAINED, RANDOM = "agent", "look-ahead", "untrained", "random"
"""What chooses actions: trained agents, the exact look-ahead, search without learning, chance."""
MODEL_LABELS, KNOWS = "model labels", "knows outcomes"
HELPS = {
    MODEL_LABELS: "trained with rewards the one-step model gives for placements that were not "
    "made (deviation D6); plays without any mask.",
    KNOWS: "no learning; the exact model tells it what every placement brings and which are valid.",
}
"""Help that the paper's agent does not have: the words in a row's name, and what they mean."""
METHOD, OWN, REFERENCE = "method", "own", "reference"
"""Kinds of rows: a published method, a method of this project, neither."""


@dataclass(frozen=True)
class Condition:
    """How episodes are played: chance of a random action, and the judge."""

    epsilon: float
    physics: str = "static"

    @property
    def label(self) -> str:
        rigid = "" if self.physics == "static" else f", {self.physics}"
        return f"ε = {self.epsilon:g}{rigid}"


PAPER_PROTOCOL = Condition(0.05)
"""Test exploration of the published numbers (protocol 12.1)."""
CONDITIONS = (PAPER_PROTOCOL, Condition(0.0))


@dataclass(frozen=True)
class Column:
    """One task of a table.

    Args:
        task: name of the preset.
        star: the agents were trained on it; what is not so is said in the notes.
        paper: fields of ``published.csv`` that pick the column.
        arm: builds in place of the task's own.
    """

    task: str
    star: bool = False
    paper: dict[str, str] = field(default_factory=dict)
    arm: str = ""

    @property
    def name(self) -> str:
        """The task, with the arm where it is another one."""
        return f"{self.task}@{self.arm}" if self.arm else self.task

    @property
    def preset(self) -> Task | None:
        task = PRESETS.get(self.task)
        if task is None or not self.arm:
            return task
        return task.replace(name=self.name, arm=self.arm)


@dataclass(frozen=True)
class Row:
    """One method of a table.

    Args:
        label: its name.
        agents: stem of its agents; ``dqn`` stands for ``dqn``, ``dqn-s0``, ``dqn-s1``, ...
        search: named search; empty plays the Q-policy.
        budget, rollout, distinct: of that search.
        paper: fields of ``published.csv`` that pick the row; empty where it was not published.
        help: what the paper's agent does not have, one of ``HELPS``; printed with the label.
        policy: what chooses the actions.
        kind: ``method``, ``own`` or ``reference``.
        columns: numbers of the columns it is played in; ``None``: all.
    """

    label: str
    agents: str = ""
    search: str = ""
    budget: int = 0
    rollout: int = 1
    distinct: bool = False
    paper: dict[str, str] = field(default_factory=dict)
    help: str = ""
    policy: str = AGENT
    kind: str = METHOD
    columns: tuple[int, ...] | None = None

    @property
    def name(self) -> str:
        """The label with any help."""
        return f"{self.label} ({self.help})" if self.help else self.label

    @property
    def known(self) -> bool:
        """Whether the search it names exists."""
        return not self.search or self.search in SEARCHES

    def search_config(self, epsilon: float) -> SearchConfig | None:
        """Its search at a chance ``epsilon`` of random choices."""
        if not self.search:
            return None
        return dataclasses.replace(
            SEARCHES[self.search], budget=self.budget, rollout=self.rollout,
            distinct=self.distinct, epsilon=epsilon,
        )  # fmt: skip

    def pick(self, names: Iterable[str]) -> list[str]:
        """Its agents among ``names``, in the order of their seeds."""
        matches = [re.fullmatch(rf"{re.escape(self.agents)}(?:-s(\d+))?", name) for name in names]
        found = {m.group(0): int(m.group(1) or 0) for m in matches if m and self.agents}
        return sorted(found, key=lambda name: (found[name], name))


@dataclass(frozen=True)
class Table:
    """A table of the paper, or one of ours.

    Args:
        name: as in ``l2a table NAME``.
        title: one line.
        columns, rows: what is played.
        paper: fields of ``published.csv`` that pick the table.
        conditions: how; those at epsilon 0 under static physics get the share of the upper bound.
        other_discount: a second gamma R is also given for.
        notes: sentences printed below.
        trainings: names of the recipes behind its agents (``learning.recipes``).
    """

    name: str
    title: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    paper: dict[str, str] = field(default_factory=dict)
    conditions: tuple[Condition, ...] = CONDITIONS
    other_discount: float | None = None
    notes: tuple[str, ...] = ()
    trainings: tuple[str, ...] = ()


def agent_seed(name: str) -> int:
    """Number of an agent of a row; its evaluation problems come from the seed of this number."""
    match = re.search(r"-s(\d+)$", name)
    return int(match.group(1)) if match else 0
