"""What a table is: rows of methods, columns of tasks, where the published numbers stand."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from learn2assemble.tasks.search.config import SEARCHES, SearchConfig
from learn2assemble.tasks.task import Task, get_task

AGENT, LOOK_AHEAD, UNTRAINED, RANDOM = "agent", "look-ahead", "untrained", "random"


MENDED, FARTHER = "mended", "farther"
"""What chooses actions: trained agents, the exact look-ahead, search without learning, chance;
agents whose idle placements are mended by the look-ahead, or by themselves with a wider view
(:func:`.cells.mended_policy`)."""


MODEL_LABELS, KNOWS, HELPED = "model labels", "knows outcomes", "helped by look-ahead"


DESIGNS = "knows outcomes, trained on designs"


ANYWHERE = f"{MODEL_LABELS}, trained with blocks anywhere"


HELPS = {
    MODEL_LABELS: "trained with rewards the one-step model gives for placements that were not "
    "made (deviation D6); plays without any mask.",
    ANYWHERE: "trained as ours, with blocks that wait anywhere in place of rows.",
    HELPED: "trained with model labels; where the placement it chose would bring nothing, which "
    "the exact model tells, the exact look-ahead chooses another.",
    DESIGNS: "the exact model tells it what every placement pays and which are valid; among "
    "those that pay the same it chooses by a network trained on designs alone, with solutions of "
    "the exact planner, never on these tasks. Chance, too, picks among what it offers only, so its "
    "figures at ε = 0.05 cannot be compared with those of agents that may pick anything.",
    KNOWS: "no learning; the exact model tells it what every placement brings and which are valid.",
}
"""Help that the paper's agent does not have: the words in a row's name, and what they mean."""


METHOD, OWN, REFERENCE = "method", "own", "reference"
"""Kinds of rows: a published method, a method of this project, neither."""


@dataclass(frozen=True)
class Condition:
    """How episodes are played: chance of a random action, and the placement checker."""

    epsilon: float
    physics: str = "static"

    @property
    def label(self) -> str:
        rigid = "" if self.physics == "static" else f", {self.physics}"
        return f"ε = {self.epsilon:g}{rigid}"


PAPER_PROTOCOL = Condition(0.05)
"""Test exploration of the published numbers."""


CONDITIONS = (PAPER_PROTOCOL, Condition(0.0))


SEARCHED = Condition(0.0, "dynamic")
"""What agents play with a search alone: an episode takes seconds, and what is left of the failures
without chance is asked of the best that an agent can do; without a search the kinematic cell says
it."""


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
    paper: dict[str, str] = field(default_factory=dict[str, str])
    arm: str = ""

    @property
    def name(self) -> str:
        """The task, with the arm where it is another one."""
        return f"{self.task}@{self.arm}" if self.arm else self.task

    @property
    def preset(self) -> Task:
        task = get_task(self.task)
        return task.replace(name=self.name, arm=self.arm) if self.arm else task


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
        look_ahead: checks the placements its search tries where it is also what judges the
            episode; else, and where empty, the task's own does.
    """

    label: str
    agents: str = ""
    search: str = ""
    budget: int = 0
    rollout: int = 1
    distinct: bool = False
    paper: dict[str, str] = field(default_factory=dict[str, str])
    help: str = ""
    policy: str = AGENT
    kind: str = METHOD
    columns: tuple[int, ...] | None = None
    look_ahead: str = ""

    @property
    def name(self) -> str:
        """The label with any help."""
        return f"{self.label} ({self.help})" if self.help else self.label

    def played_in(self, column: int) -> bool:
        """Whether it is played in the column with this number."""
        return self.columns is None or column in self.columns

    def played_at(self, condition: Condition) -> bool:
        """Whether it is played under a condition."""
        return condition != SEARCHED or bool(self.search) or not self.agents

    def search_config(self, epsilon: float) -> SearchConfig | None:
        """Its search at a chance ``epsilon`` of random choices."""
        if not self.search:
            return None
        return replace(
            SEARCHES[self.search],
            budget=self.budget,
            rollout=self.rollout,
            distinct=self.distinct,
            epsilon=epsilon,
        )

    def pick(self, names: Iterable[str]) -> list[str]:
        """Its agents among ``names``, in the order of their seeds."""
        pattern = re.compile(rf"{re.escape(self.agents)}(-s\d+)?")
        found = [name for name in names if self.agents and pattern.fullmatch(name)]
        return sorted(found, key=lambda name: (self.seed(name), name))

    def seed(self, name: str) -> int:
        """Of the training of one of its agents, as its name says."""
        return int(name[len(self.agents) + 2 :] or 0)


@dataclass(frozen=True)
class Table:
    """A table of the paper, or one of ours.

    Args:
        name: as in ``l2a-lab table NAME``.
        title: one line.
        columns, rows: what is played.
        paper: fields of ``published.csv`` that pick the table.
        conditions: how; those at epsilon 0 under static physics get the share of the upper bound.
        other_discount: a second gamma R is also given for.
        notes: sentences printed below.
    """

    name: str
    title: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    paper: dict[str, str] = field(default_factory=dict[str, str])
    conditions: tuple[Condition, ...] = CONDITIONS
    other_discount: float | None = None
    notes: tuple[str, ...] = ()

    @property
    def stems(self) -> list[str]:
        """Stems of its agents, in the order of its rows."""
        names = [re.sub(r"-s\d+$", "", row.agents) for row in self.rows if row.agents]
        return list(dict.fromkeys(names))

    @property
    def reference(self) -> int | None:
        """Number of the row all others are compared with: our agent with the paper's budget."""
        own = [n for n, row in enumerate(self.rows) if row.kind == OWN and row.budget == 10]
        return own[0] if own else None
