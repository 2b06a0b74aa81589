"""The tables as data: rows of methods, columns of tasks, where the published numbers stand."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from learn2assemble.errors import UnknownNameError
from learn2assemble.search.config import SEARCHES, TO_THE_END, SearchConfig
from learn2assemble.tasks import PRESETS, Task

AGENT, LOOK_AHEAD, UNTRAINED, RANDOM = "agent", "look-ahead", "untrained", "random"
MENDED = "mended"
"""What chooses actions: trained agents, the exact look-ahead, search without learning, chance;
agents whose placements are mended by the look-ahead (:func:`.cells.mended_policy`)."""
MODEL_LABELS, KNOWS, HELPED = "model labels", "knows outcomes", "helped by look-ahead"
HELPS = {
    MODEL_LABELS: "trained with rewards the one-step model gives for placements that were not "
    "made (deviation D6); plays without any mask.",
    HELPED: "trained with model labels; where the placement it chose would bring nothing, which "
    "the exact model tells, the exact look-ahead chooses another.",
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

    @property
    def reference(self) -> int | None:
        """Number of the row all others are compared with: our agent with the paper's budget."""
        own = [n for n, row in enumerate(self.rows) if row.kind == OWN and row.budget == 10]
        return own[0] if own else None


FIDELITIES = (
    Condition(0.05, "published"), Condition(0.05, "kinematic"), Condition(0.05, "dynamic"),
    Condition(0.0, "dynamic"),
)  # fmt: skip
"""The authors' fast mode, and our two: a cell that looks at collisions of every link, and one that
simulates arm, grasp and blocks."""

_SEARCHES = (
    "Every search looks ahead in the kinematic cell, whatever judges the episode; the paper's "
    "looked ahead in the fast mode itself.",
)


_ROBOT_LOOK_AHEAD = Row("exact look-ahead", help=KNOWS, policy=LOOK_AHEAD, kind=REFERENCE)


def _column(task: str, grid: str, blocks: str, star: bool = False) -> Column:
    return Column(f"robot-{task}-{grid}-{blocks}", star, {"grid": grid, "blocks": blocks})


def _rows(agents: str, own: str) -> tuple[Row, ...]:
    return (
        Row("DQN", agents, paper={"method": "DQN", "search_budget": "0"}),
        Row("DQN+MCTS, budget 10", agents, "dqn-mcts", 10,
            paper={"method": "DQN+MCTS", "search_budget": "10"}),
        Row("ours, no search", own, help=MODEL_LABELS, kind=OWN),
        Row("ours, budget 10", own, "dqn-mcts", 10, help=MODEL_LABELS, kind=OWN),
        _ROBOT_LOOK_AHEAD,
    )  # fmt: skip


def _two_sided(layout: str, star: bool) -> tuple[Column, ...]:
    return (
        _column(f"{layout}two-sided", "3x3", "10-14", star),
        _column(f"{layout}two-sided", "3x3", "14-18"),
        _column(f"{layout}two-sided", "5x5", "14-18"),
    )  # fmt: skip


_OBJECTS = (
    _column("objects-two-sided", "5x5", "20-24", True),
    _column("objects-two-sided", "5x5", "30-34"), _column("objects-two-sided", "6x6", "30-34"),
)  # fmt: skip
_ONE_SIDED = (
    _column("one-sided", "5x5", "15-17", True), _column("one-sided", "6x6", "16-18"),
)  # fmt: skip
_ROBOT_OBJECTS = {"experiment": "multi_object_robot"}
_TWO, _FOUR, _MORE = "robot-two-sided", "robot-four-sided", "robot-objects"

_TRANSFER = "robot-two-sided-3x3-10-14"

ROBOT_TABLES = (
    Table(
        "T3", "Four sides with a robot (main Table 3)",
        (_column("four-sided", "3x3", "10-18", True), _column("four-sided", "3x3", "16-24")),
        _rows(_FOUR, "relational-four-sided"), {"source_table": "main_T3"}, FIDELITIES,
        notes=_SEARCHES, trainings=(_FOUR, "relational-four-sided"),
    ),
    Table(
        "T4", "Two sides with a robot, blocks waiting in rows (main Table 4)",
        _two_sided("", True), _rows(_TWO, "relational-two-sided"),
        {"source_table": "main_T4", "experiment": "robot_2_sided"}, FIDELITIES,
        notes=_SEARCHES, trainings=(_TWO, "relational-two-sided"),
    ),
    Table(
        "T4-random", "Two sides with a robot, blocks waiting anywhere (main Table 4)",
        _two_sided("random-", False), _rows(_TWO, "relational-two-sided"),
        {"source_table": "main_T4", "experiment": "robot_2_sided_random_layout"}, FIDELITIES,
        notes=(*_SEARCHES, "The agents were trained with blocks waiting in rows."),
        trainings=(_TWO, "relational-two-sided"),
    ),
    Table(
        "transfer", "Agents trained with the Panda, with another arm",
        tuple(Column(task, not arm and task == _TRANSFER, arm=arm)
              for task in (_TRANSFER, "robot-two-sided-5x5-14-18") for arm in ("", "ur5e")),
        tuple(replace(row, paper={}) for row in _rows(_TWO, "relational-two-sided")),
        conditions=FIDELITIES[1:],
        notes=(*_SEARCHES, "Nothing is trained for the UR5e; its cell knows its own reach and "
               "shape, which decide what is valid, and the agents do not."),
        trainings=(_TWO, "relational-two-sided"),
    ),
    Table(
        "A5", "Training with a robot or without (appendix Table 5; played with it)", _ONE_SIDED,
        (Row("DQN trained with robot", "robot-one-sided",
             paper={"method": "DQN trained with robot"}),
         Row("DQN trained without robot", "one-sided",
             paper={"method": "DQN trained without robot"}),
         _ROBOT_LOOK_AHEAD),
        {"source_table": "app_T5"}, FIDELITIES, trainings=("robot-one-sided", "one-sided"),
    ),
    Table(
        "T5-robot", "Several objects with a robot (main Table 5)", _OBJECTS,
        _rows(_MORE, "relational-robot-objects")[1:], {**_ROBOT_OBJECTS, "source_table": "main_T5"},
        FIDELITIES, other_discount=0.8, notes=_SEARCHES,
        trainings=(_MORE, "relational-robot-objects"),
    ),
    Table(
        "A6-robot", "Several objects with a robot (appendix Table 6)", _OBJECTS,
        _rows(_MORE, "relational-robot-objects"), {**_ROBOT_OBJECTS, "source_table": "app_T6"},
        FIDELITIES, other_discount=0.8, notes=_SEARCHES,
        trainings=(_MORE, "relational-robot-objects"),
    ),
)  # fmt: skip


OWN_CUBES, OWN_BARS, OWN_OBJECTS = "relational-cubes", "relational-bars", "relational-objects"
"""Stems of our own agents."""


def _cubes(grid: str, blocks: str, star: bool = False, shapes: str = "") -> Column:
    return Column(f"two-sided-{grid}-{blocks}{shapes}", star, {"grid": grid, "blocks": blocks})


def _objects(grid: str, blocks: str, star: bool = False) -> Column:
    return Column(f"objects-two-sided-{grid}-{blocks}", star, {"grid": grid, "blocks": blocks})


def _bars(grid: str, blocks: str, star: bool = False, *, other: bool = False) -> Column:
    kind = "different types (unspecified)" if other else "cube+horizontal2+vertical2"
    name = f"{'other-' if other else ''}bars-one-sided-{grid}-{blocks}"
    return Column(name, star, {"grid": grid, "blocks": blocks, "objects": kind})


_LEARNERS = {"DQN": ("dqn", "dqn-mcts"), "ε-MCTS": ("eps-mcts",) * 2, "Q-MCTS": ("q-mcts",) * 2}
"""Learner -> stem of its agents and its search."""


def _learner(learner: str, budget: int, rollout: int = 1) -> Row:
    agents, search = _LEARNERS[learner]
    published = learner.replace("ε", "eps") + ("+MCTS" if learner == "DQN" and budget else "")
    depth = "none" if not budget else "1" if rollout == 1 else "to_termination"
    label = f"{learner}+MCTS" if learner == "DQN" and budget else learner
    label += f", budget {budget}{'' if rollout == 1 else ', to the end'}" if budget else ""
    return Row(
        label, agents, search if budget else "", budget, rollout,
        paper={"method": published, "search_budget": str(budget), "rollout": depth},
    )  # fmt: skip


def _network(name: str, agents: str, graph: str, label: str | None = None) -> Row:
    return Row(label or name, agents, paper={"method": f"DQN[{name}]", "graph": graph})


def _own(agents: str) -> tuple[Row, ...]:
    """Our own agents; their searches expand distinct placements whatever ``distinct`` says."""
    return (
        Row("ours, no search", agents, help=MODEL_LABELS, kind=OWN),
        Row("ours, budget 10", agents, "dqn-mcts", 10, help=MODEL_LABELS, kind=OWN),
        Row("ours, budget 10, deeper", agents, "widening", 10, distinct=True,
            help=MODEL_LABELS, kind=OWN),
    )  # fmt: skip


_LOOK_AHEAD = Row(
    "exact look-ahead", help=KNOWS, policy=LOOK_AHEAD, kind=REFERENCE,
)  # fmt: skip
_UCT = Row(
    "UCT, budget 1000", "", "uct", 1000, TO_THE_END, policy=UNTRAINED, columns=(0,),
    paper={"method": "UCT (no prior)", "search_budget": "1000"},
)  # fmt: skip

_RANDOM = Row("uniformly random actions", policy=RANDOM, kind=REFERENCE, columns=(0,))
_CHANCE = (
    "The published UCT scores about what uniformly random actions score, so its final choice can "
    "hardly have depended on its values; ours is the same search with exact restores.",
)

_SMALL = (
    _cubes("3x3", "20-24", True), _cubes("3x3", "30-34"),
    _cubes("3x3", "30-34", shapes="-trained-shapes"),
)  # fmt: skip
"""The published column 3x3 30-34 in both readings."""
_T1_COLUMNS = (*_SMALL, _cubes("4x4", "20-24"))
_T2_COLUMNS = (*_SMALL, _cubes("4x4", "30-34"), _cubes("5x5", "40-44"))
_READINGS = (
    "3x3 30-34 stands here twice: with unseen shapes, as the paper's text says, and with the "
    "shapes of training, which the released code draws; with unseen shapes switched on, that code "
    "does not end on a 3x3 grid, so which of the two the paper played is open.",
)
_A3_COLUMNS = (
    _bars("5x5", "25-27", True), _bars("5x5", "35-37"), _bars("6x6", "35-37"),
    _bars("5x5", "25-27", other=True),
)  # fmt: skip
_A6_COLUMNS = (_objects("5x5", "20-24", True), _objects("5x5", "30-34"), _objects("6x6", "30-34"))

_MHA, _SHA, _S2V = (
    _network("MHA", "mha-full", "full", "MHA"), _network("SHA", "sha-full", "full", "SHA"),
    _network("S2V", "s2v-full", "full", "S2V"),
)  # fmt: skip


def _budget(budget: int, rollout: int = 1) -> tuple[Row, ...]:
    return tuple(_learner(name, budget, rollout) for name in _LEARNERS)


_PARTS = (
    ("all parts", "full", MODEL_LABELS),
    ("without dense labels", "no-dense-labels", ""),
    ("without double Q", "single-q", MODEL_LABELS),
    ("one round of pooling", "one-round", MODEL_LABELS),
    ("targets over three steps", "three-steps", MODEL_LABELS),
)
"""Rows of the ablation: label, stem of the agents, help."""

_TRAINED = (
    "Ours was trained on two-sided-5x5-40-44 alone, the published methods on the starred task.",
    *_READINGS,
)

_NO_ROBOT = {"source_table": "main_T5", "experiment": "multi_object_no_robot"}

_ALL = (
    Table(
        "T1", "Architectures (main Table 1; full graph)", _T1_COLUMNS,
        (_MHA, _S2V, *_own(OWN_CUBES), _LOOK_AHEAD), {"source_table": "main_T1"},
        notes=_TRAINED, trainings=("mha-full", "s2v-full", OWN_CUBES),
    ),
    Table(
        "A2", "Architectures (appendix Table 2; full graph)", _T1_COLUMNS,
        (_MHA, _SHA, _S2V, *_own(OWN_CUBES), _LOOK_AHEAD), {"source_table": "app_T2"},
        notes=_TRAINED, trainings=("mha-full", "sha-full", "s2v-full", OWN_CUBES),
    ),
    Table(
        "T2", "Learning algorithms (main Table 2; two sides, no robot)", _T2_COLUMNS,
        (*_budget(0), *_budget(10), _UCT, _RANDOM, *_own(OWN_CUBES), _LOOK_AHEAD),
        {"source_table": "main_T2"}, notes=(*_TRAINED, *_CHANCE),
        trainings=("dqn", "eps-mcts", "q-mcts", OWN_CUBES),
    ),
    Table(
        "A4", "Learning algorithms (appendix Table 4; two sides, no robot)", _T2_COLUMNS,
        (*_budget(0), *_budget(5), *_budget(5, TO_THE_END), *_budget(10), _UCT, _RANDOM,
         *_own(OWN_CUBES), _LOOK_AHEAD),
        {"source_table": "app_T4"}, notes=(*_TRAINED, *_CHANCE),
        trainings=("dqn", "eps-mcts", "q-mcts", OWN_CUBES),
    ),
    Table(
        "A3", "Connectivity (appendix Table 3; bars, one side)", _A3_COLUMNS,
        (_network("MHA", "bars-full", "full", "fully connected"),
         _network("MHA", "bars-partial", "partial", "partially connected"),
         *_own(OWN_BARS), _LOOK_AHEAD),
        {"source_table": "app_T3"}, other_discount=0.95,
        trainings=("bars-full", "bars-partial", OWN_BARS),
    ),
    Table(
        "T5", "Several objects (main Table 5, row without robot)", _A6_COLUMNS,
        (Row("DQN+MCTS, budget 10", "objects", "dqn-mcts", 10,
             paper={"method": "DQN+MCTS", "search_budget": "10"}),
         *_own(OWN_OBJECTS), _LOOK_AHEAD),
        _NO_ROBOT, other_discount=0.8, trainings=("objects", OWN_OBJECTS),
    ),
    Table(
        "A6", "Several objects (appendix Table 6, rows without robot)", _A6_COLUMNS,
        (Row("DQN", "objects", paper={"method": "DQN", "search_budget": "0"}),
         Row("DQN+MCTS, budget 10", "objects", "dqn-mcts", 10,
             paper={"method": "DQN+MCTS", "search_budget": "10"}),
         *_own(OWN_OBJECTS), _LOOK_AHEAD),
        {**_NO_ROBOT, "source_table": "app_T6"}, other_discount=0.8,
        trainings=("objects", OWN_OBJECTS),
    ),
    Table(
        "ablation", "What each part of our method brings (24,000 samples; searches: shipped agent)",
        (_T2_COLUMNS[0], _T2_COLUMNS[4]),
        (*(Row(label, f"ablation-{stem}", help=help_, kind=OWN) for label, stem, help_ in _PARTS),
         _learner("DQN", 0),
         Row("shipped agent, no search", OWN_CUBES, help=MODEL_LABELS, kind=OWN),
         *(Row(f"shipped agent, {name}, budget 10", OWN_CUBES, name, 10, distinct=True,
               help=MODEL_LABELS, kind=OWN) for name in ("dqn-mcts", "widening", "gumbel")),
         _LOOK_AHEAD),
        trainings=(*(f"ablation-{stem}" for _, stem, _ in _PARTS), "dqn", OWN_CUBES),
    ),
    Table(
        "scaling", "Targets larger than those of training (DQN: 3x3, ours: 5x5)",
        (_T2_COLUMNS[0], *(dataclasses.replace(column, star=False) for column in _T2_COLUMNS[3:]),
         _cubes("6x6", "50-54"), _cubes("8x8", "90-94"), _cubes("10x10", "140-144"),
         _cubes("12x12", "200-204")),
        (_learner("DQN", 0), *_own(OWN_CUBES),
         Row("ours, budget 10", OWN_CUBES, "dqn-mcts", 10, help=HELPED, policy=MENDED, kind=OWN),
         _LOOK_AHEAD),
        conditions=(Condition(0.0),), trainings=("dqn", OWN_CUBES),
        notes=("R is discounted, so the last blocks of a large target hardly show in it; the "
               "success is the share of targets that are finished.",),
    ),
    Table(
        "shipped", "The shipped agent beside the published methods",
        (*(dataclasses.replace(column, star=False) for column in _T2_COLUMNS[:4]),
         dataclasses.replace(_T2_COLUMNS[4], star=True), _cubes("6x6", "50-54")),
        (Row("no search", OWN_CUBES, help=MODEL_LABELS, kind=OWN,
             paper={"method": "DQN", "search_budget": "0"}),
         Row("budget 10", OWN_CUBES, "dqn-mcts", 10, help=MODEL_LABELS, kind=OWN,
             paper={"method": "DQN+MCTS", "search_budget": "10"}),
         _LOOK_AHEAD),
        {"source_table": "main_T2"},
        (Condition(0.05), Condition(0.0), Condition(0.05, "rigid")),
        notes=_READINGS, trainings=(OWN_CUBES,),
    ),
)  # fmt: skip

TABLES: dict[str, Table] = {table.name: table for table in (*_ALL, *ROBOT_TABLES)}


def get_table(name: str) -> Table:
    """The table called ``name``; letter case does not matter.

    Raises:
        UnknownNameError: naming the nearest one.
    """
    for table in TABLES.values():
        if table.name.lower() == name.lower():
            return table
    raise UnknownNameError("table", name, TABLES)
