"""The tables as data: their rows and columns, and which agents play them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from l2a_lab.table import (
    ANYWHERE,
    DESIGNS,
    FARTHER,
    HELPED,
    KNOWS,
    LOOK_AHEAD,
    MENDED,
    METHOD,
    MODEL_LABELS,
    OWN,
    RANDOM,
    REFERENCE,
    UNTRAINED,
    Column,
    Condition,
    Row,
    Table,
)
from learn2assemble.errors import UnknownNameError
from learn2assemble.tasks.search.config import TO_THE_END

# ---------------------------------------------------------------- rows

OWN_CUBES, OWN_BARS, OWN_OBJECTS = "relational-cubes", "relational-bars", "relational-objects"
OWN_SMALL = "relational-small"
"""Ours, trained on what the published methods were trained on."""
SHIPPED = f"{OWN_CUBES}-s0"
BUILDER = "builder"
"""Stems of our own agents, the one that is shipped, and the stem of the builder of designs."""
_LEARNERS = {"DQN": ("dqn", "dqn-mcts"), "ε-MCTS": ("eps-mcts",) * 2, "Q-MCTS": ("q-mcts",) * 2}
"""Learner -> stem of its agents and its search."""
OUR_SCHEDULE, PAPER_SCHEDULE = "our schedule", "paper's schedule"
IN_FAST_MODE = "trained in the fast mode"
_SCHEDULES = (
    "Our schedule: the published networks and learners with double Q, mirrored replay, scaled "
    "positions, twenty times the rate and a fifth to half of the samples (deviation D8); paper's "
    "schedule: as published.",
)


def _budget(budget: int, rollout: int = 1, learners: Iterable[str] = _LEARNERS) -> tuple[Row, ...]:
    """The published learners with one budget of search."""
    rows: list[Row] = []
    depth = "none" if not budget else "1" if rollout == 1 else "to_termination"
    for learner in learners:
        agents, search = _LEARNERS[learner]
        name = f"{learner}+MCTS" if learner == "DQN" and budget else learner
        more = f", budget {budget}{'' if rollout == 1 else ', to the end'}" if budget else ""
        paper = {"method": name.replace("ε", "eps"), "search_budget": str(budget), "rollout": depth}
        label = f"{name}{more}, {OUR_SCHEDULE}"
        rows.append(Row(label, agents, search if budget else "", budget, rollout, paper=paper))
    return tuple(rows)


def _played(agents: str, schedule: str) -> tuple[Row, ...]:
    """Published agents without search and with.

    Args:
        schedule: on which they were trained.
    """
    return (
        Row(f"DQN, {schedule}", agents, paper={"method": "DQN", "search_budget": "0"}),
        Row(
            f"DQN+MCTS, budget 10, {schedule}",
            agents,
            "dqn-mcts",
            10,
            paper={"method": "DQN+MCTS", "search_budget": "10"},
        ),
    )


def _network(name: str, agents: str, graph: str, label: str) -> Row:
    return Row(label, agents, paper={"method": f"DQN[{name}]", "graph": graph})


def _ours(label: str, agents: str, search: str = "", **more: Any) -> Row:
    more = {"help": MODEL_LABELS, **more}
    return Row(label, agents, search, 10 if search else 0, kind=OWN, **more)


def _own(agents: str) -> tuple[Row, ...]:
    """Our own agents; their searches expand distinct placements whatever ``distinct`` says."""
    return (
        _ours("ours, no search", agents),
        _ours("ours, budget 10", agents, "dqn-mcts"),
        _ours("ours, budget 10, deeper", agents, "widening", distinct=True),
    )


_SMALL_ROWS = (
    _ours("ours, trained on 3x3, no search", OWN_SMALL),
    _ours("ours, trained on 3x3, budget 10", OWN_SMALL, "dqn-mcts"),
)
_BUILDER = _ours("builder, budget 10", BUILDER, "dqn-mcts", help=DESIGNS)
_LOOK_AHEAD = Row("exact look-ahead", help=KNOWS, policy=LOOK_AHEAD, kind=REFERENCE)
_UCT = Row(
    "UCT, budget 1000",
    "",
    "uct",
    1000,
    TO_THE_END,
    policy=UNTRAINED,
    columns=(0,),
    paper={"method": "UCT (no prior)", "search_budget": "1000"},
)
_RANDOM = Row("uniformly random actions", policy=RANDOM, kind=REFERENCE, columns=(0,))
_MHA, _SHA, _S2V = (
    _network(name, f"{name.lower()}-full", "full", name) for name in ("MHA", "SHA", "S2V")
)


def _robot_rows(agents: str, own: str, paper: str = "") -> tuple[Row, ...]:
    """With a robot.

    Args:
        agents: published ones on our schedule.
        own: ours.
        paper: published ones on the paper's schedule, where there are some; these then stand for
            the published numbers.
    """
    slow = _played(paper, PAPER_SCHEDULE) if paper else ()
    fast = _beside(slow, _played(agents, OUR_SCHEDULE))
    return (*slow, *fast, *_own(own)[:2], _LOOK_AHEAD)


def _beside(slow: Iterable[Row], fast: Iterable[Row]) -> tuple[Row, ...]:
    """Rows on our schedule, without the published numbers where rows on the paper's have them."""

    def number(row: Row) -> tuple[str | None, ...]:
        return tuple(row.paper.get(key) for key in ("method", "search_budget"))

    taken = {number(row) for row in slow}
    return tuple(replace(row, paper={}) if number(row) in taken else row for row in fast)


_SLOW_CUBES = _played("dqn-paper", PAPER_SCHEDULE)

# ---------------------------------------------------------------- columns


def _columns(
    kind: str, *sizes: str, star: bool = True, suffix: str = "", objects: str = ""
) -> tuple[Column, ...]:
    """Tasks of a kind by grid and blocks; the agents were trained on the first of them, or not."""
    found: list[Column] = []
    for size in sizes:
        grid, _, blocks = size.partition("-")
        paper = {"grid": grid, "blocks": blocks, **({"objects": objects} if objects else {})}
        found.append(Column(f"{kind}-{size}{suffix}", star and not found, paper))
    return tuple(found)


_SMALL = (
    *_columns("two-sided", "3x3-20-24", "3x3-30-34"),
    *_columns("two-sided", "3x3-30-34", star=False, suffix="-trained-shapes"),
)
"""The published column 3x3 30-34 in both readings."""
_T1_COLUMNS = (*_SMALL, *_columns("two-sided", "4x4-20-24", star=False))
_T2_COLUMNS = (*_SMALL, *_columns("two-sided", "4x4-30-34", "5x5-40-44", star=False))
_SIZES = _columns(
    "two-sided", "6x6-50-54", "8x8-90-94", "10x10-140-144", "12x12-200-204", star=False
)
_A3_COLUMNS = (
    *_columns(
        "bars-one-sided",
        "5x5-25-27",
        "5x5-35-37",
        "6x6-35-37",
        objects="cube+horizontal2+vertical2",
    ),
    *_columns(
        "other-bars-one-sided", "5x5-25-27", star=False, objects="different types (unspecified)"
    ),
)
_OBJECT_SIZES = ("5x5-20-24", "5x5-30-34", "6x6-30-34")
_TWO_SIZES = ("3x3-10-14", "3x3-14-18", "5x5-14-18")


# ---------------------------------------------------------------- tables

_CHANCE = (
    "The published UCT scores about what uniformly random actions score, so its final choice can "
    "hardly have depended on its values; ours is the same search with exact restores.",
)
_READINGS = (
    "3x3 30-34 stands here twice: with unseen shapes, as the paper's text says, and with the "
    "shapes of training, which the released code draws; with unseen shapes switched on, that code "
    "does not end on a 3x3 grid, so which of the two the paper played is open.",
)
_TRAINED = (
    "Ours was trained on two-sided-5x5-40-44 alone where a row does not say 3x3; the published "
    "methods, and ours of such rows, on the starred task.",
    *_READINGS,
)
_SEARCHES = (
    "Every search looks ahead in the kinematic cell, whatever judges the episode; the paper's "
    "looked ahead in the fast mode itself.",
)
FIDELITIES = (
    Condition(0.05, "published"),
    Condition(0.05, "kinematic"),
    Condition(0.05, "dynamic"),
    Condition(0.0, "kinematic"),
    Condition(0.0, "dynamic"),
)
"""The authors' fast mode, and our two: a cell that looks at collisions of every link, and one that
simulates arm, grasp and blocks."""
_NO_ROBOT = {"source_table": "main_T5", "experiment": "multi_object_no_robot"}
_ROBOT_OBJECTS = {"source_table": "main_T5", "experiment": "multi_object_robot"}
_TWO_OWN = "relational-two-sided"
_ANYWHERE_ROWS = tuple(
    _ours(label, "relational-anywhere", search, help=ANYWHERE)
    for label, search in (("ours, no search", ""), ("ours, budget 10", "dqn-mcts"))
)
_TWO_ROWS = (
    *_robot_rows("robot-two-sided", _TWO_OWN, "robot-two-sided-paper"),
    *_ANYWHERE_ROWS,
)


def _object_rows() -> tuple[Row, ...]:
    """Those of several objects: agents that ended their training in the authors' fast mode stand
    for the published numbers; as the paper's, their search looks ahead in it."""
    end = _played("robot-objects-fast-mode", IN_FAST_MODE)
    end = tuple(replace(row, look_ahead="published" if row.search else "") for row in end)
    others = _robot_rows("robot-objects", "relational-robot-objects")
    return (*end, *(replace(row, paper={}) for row in others))


_OBJECT_NOTES = (
    "Searches look ahead in the kinematic cell, whatever judges the episode; those of agents "
    "trained in the fast mode look ahead in it where it judges, as the paper's did.",
    "Trained in the fast mode: the paper's network, learner and rate; half of its samples in the "
    "kinematic cell, then 60,000 in the fast mode with two gradient steps for each of the paper's.",
)
_OBJECT_ROWS = _object_rows()
_TRANSFER = "robot-two-sided-3x3-10-14"

_ALL = (
    Table(
        "T1",
        "Architectures (main Table 1; full graph)",
        _T1_COLUMNS,
        (_MHA, _S2V, *_own(OWN_CUBES), *_SMALL_ROWS, _LOOK_AHEAD),
        {"source_table": "main_T1"},
        notes=(*_TRAINED, *_SCHEDULES),
    ),
    Table(
        "A2",
        "Architectures (appendix Table 2; full graph)",
        _T1_COLUMNS,
        (_MHA, _SHA, _S2V, *_own(OWN_CUBES), *_SMALL_ROWS, _LOOK_AHEAD),
        {"source_table": "app_T2"},
        notes=(*_TRAINED, *_SCHEDULES),
    ),
    Table(
        "T2",
        "Learning algorithms (main Table 2; two sides, no robot)",
        _T2_COLUMNS,
        (
            *_SLOW_CUBES,
            *_beside(_SLOW_CUBES, (*_budget(0), *_budget(10))),
            _UCT,
            _RANDOM,
            *_own(OWN_CUBES),
            *_SMALL_ROWS,
            _LOOK_AHEAD,
        ),
        {"source_table": "main_T2"},
        notes=(*_TRAINED, *_CHANCE, *_SCHEDULES),
    ),
    Table(
        "A4",
        "Learning algorithms (appendix Table 4; two sides, no robot)",
        _T2_COLUMNS,
        (
            *_budget(0),
            *_budget(5),
            *_budget(5, TO_THE_END),
            *_budget(10),
            _UCT,
            _RANDOM,
            *_own(OWN_CUBES),
            *_SMALL_ROWS,
            _LOOK_AHEAD,
        ),
        {"source_table": "app_T4"},
        notes=(*_TRAINED, *_CHANCE, *_SCHEDULES),
    ),
    Table(
        "A3",
        "Connectivity (appendix Table 3; bars, one side)",
        _A3_COLUMNS,
        (
            _network("MHA", "bars-full", "full", "fully connected"),
            _network("MHA", "bars-partial", "partial", "partially connected"),
            *_own(OWN_BARS),
            _BUILDER,
            _LOOK_AHEAD,
        ),
        {"source_table": "app_T3"},
        other_discount=0.95,
    ),
    Table(
        "T5",
        "Several objects (main Table 5, row without robot)",
        _columns("objects-two-sided", *_OBJECT_SIZES),
        (_played("objects", OUR_SCHEDULE)[1], *_own(OWN_OBJECTS), _LOOK_AHEAD),
        _NO_ROBOT,
        other_discount=0.8,
    ),
    Table(
        "A6",
        "Several objects (appendix Table 6, rows without robot)",
        _columns("objects-two-sided", *_OBJECT_SIZES),
        (*_played("objects", OUR_SCHEDULE), *_own(OWN_OBJECTS), _BUILDER, _LOOK_AHEAD),
        {**_NO_ROBOT, "source_table": "app_T6"},
        other_discount=0.8,
    ),
    Table(
        "scaling",
        "Targets larger than those of training (DQN: 3x3, ours: 5x5)",
        (_T2_COLUMNS[0], *_T2_COLUMNS[3:], *_SIZES),
        (
            *_budget(0, learners=("DQN",)),
            *_own(OWN_CUBES),
            _ours("shipped agent, budget 10, gumbel", SHIPPED, "gumbel", distinct=True),
            _ours(
                "shipped agent, budget 10, farther",
                SHIPPED,
                "gumbel",
                distinct=True,
                policy=FARTHER,
                columns=(4, 5),
            ),
            _ours("shipped agent, budget 10", SHIPPED, "dqn-mcts", help=HELPED, policy=MENDED),
            _LOOK_AHEAD,
        ),
        conditions=(Condition(0.0),),
        notes=(
            "R is discounted, so the last blocks of a large target hardly show in it; the "
            "success is the share of targets that are finished.",
            "farther: the search is gumbel with nine simulations; where the placement it chose "
            "brings no reward, the agent values all placements again, seeing blocks up to four "
            "or five cells away in turn instead of three, and takes the best one if the tenth "
            "simulation shows that it is valid.",
        ),
    ),
    Table(
        "shipped",
        "The shipped agent beside the published methods",
        (
            *(replace(column, star=False) for column in _T2_COLUMNS[:4]),
            replace(_T2_COLUMNS[4], star=True),
            _SIZES[0],
        ),
        (
            _ours("no search", SHIPPED, paper={"method": "DQN", "search_budget": "0"}),
            _ours(
                "budget 10",
                SHIPPED,
                "dqn-mcts",
                paper={"method": "DQN+MCTS", "search_budget": "10"},
            ),
            _BUILDER,
            _LOOK_AHEAD,
        ),
        {"source_table": "main_T2"},
        (Condition(0.05), Condition(0.0), Condition(0.05, "rigid")),
        notes=(*_READINGS, *_SCHEDULES),
    ),
    Table(
        "T3",
        "Four sides with a robot (main Table 3)",
        _columns("robot-four-sided", "3x3-10-18", "3x3-16-24"),
        _robot_rows("robot-four-sided", "relational-four-sided", "robot-four-sided-paper"),
        {"source_table": "main_T3"},
        FIDELITIES,
        notes=(*_SEARCHES, *_SCHEDULES),
    ),
    Table(
        "T4",
        "Two sides with a robot, blocks waiting in rows (main Table 4)",
        _columns("robot-two-sided", *_TWO_SIZES),
        _TWO_ROWS,
        {"source_table": "main_T4", "experiment": "robot_2_sided"},
        FIDELITIES,
        notes=(*_SEARCHES, *_SCHEDULES),
    ),
    Table(
        "T4-random",
        "Two sides with a robot, blocks waiting anywhere (main Table 4)",
        _columns("robot-random-two-sided", *_TWO_SIZES, star=False),
        _TWO_ROWS,
        {"source_table": "main_T4", "experiment": "robot_2_sided_random_layout"},
        FIDELITIES,
        notes=(
            *_SEARCHES,
            *_SCHEDULES,
            "The agents were trained with blocks waiting in rows, but where the row says anywhere.",
        ),
    ),
    Table(
        "transfer",
        "Agents trained with the Panda, with another arm",
        tuple(
            Column(task, not arm and task == _TRANSFER, arm=arm)
            for task in (_TRANSFER, "robot-two-sided-5x5-14-18")
            for arm in ("", "ur5e")
        ),
        tuple(replace(row, paper={}) for row in _robot_rows("robot-two-sided", f"{_TWO_OWN}-s0")),
        conditions=FIDELITIES[1:],
        notes=(
            *_SEARCHES,
            "Nothing is trained for the UR5e; its cell knows its own reach and "
            "shape, which decide what is valid, and the agents do not.",
        ),
    ),
    Table(
        "A5",
        "Training with a robot or without (appendix Table 5; played with it)",
        _columns("robot-one-sided", "5x5-15-17", "6x6-16-18"),
        (
            Row(
                f"DQN trained with robot, {PAPER_SCHEDULE}",
                "robot-one-sided-paper",
                paper={"method": "DQN trained with robot"},
            ),
            Row(f"DQN trained with robot, {OUR_SCHEDULE}", "robot-one-sided"),
            Row(
                f"DQN trained without robot, {OUR_SCHEDULE}",
                "one-sided",
                paper={"method": "DQN trained without robot"},
            ),
            *_own("relational-one-sided")[:2],
            _LOOK_AHEAD,
        ),
        {"source_table": "app_T5"},
        FIDELITIES,
        notes=_SCHEDULES,
    ),
    Table(
        "T5-robot",
        "Several objects with a robot (main Table 5)",
        _columns("robot-objects-two-sided", *_OBJECT_SIZES),
        tuple(row for row in _OBJECT_ROWS if row.search or row.kind != METHOD),
        _ROBOT_OBJECTS,
        FIDELITIES,
        other_discount=0.8,
        notes=(*_OBJECT_NOTES, *_SCHEDULES),
    ),
    Table(
        "A6-robot",
        "Several objects with a robot (appendix Table 6)",
        _columns("robot-objects-two-sided", *_OBJECT_SIZES),
        _OBJECT_ROWS,
        {**_ROBOT_OBJECTS, "source_table": "app_T6"},
        FIDELITIES,
        other_discount=0.8,
        notes=(*_OBJECT_NOTES, *_SCHEDULES),
    ),
)

TABLES: dict[str, Table] = {table.name: table for table in _ALL}


def get_table(name: str) -> Table:
    """The table called ``name``; letter case does not matter.

    Raises:
        UnknownNameError: naming the nearest one.
    """
    for table in TABLES.values():
        if table.name.lower() == name.lower():
            return table
    raise UnknownNameError("table", name, TABLES)
