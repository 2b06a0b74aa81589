"""The paper's tables with a robot, as data (protocol 12.2)."""

from __future__ import annotations

from dataclasses import replace

from learn2assemble.evaluation.table_spec import (
    KNOWS,
    LOOK_AHEAD,
    MODEL_LABELS,
    OWN,
    REFERENCE,
    Column,
    Condition,
    Row,
    Table,
)

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


_LOOK_AHEAD = Row("exact look-ahead", help=KNOWS, policy=LOOK_AHEAD, kind=REFERENCE)


def _column(task: str, grid: str, blocks: str, star: bool = False) -> Column:
    return Column(f"robot-{task}-{grid}-{blocks}", star, {"grid": grid, "blocks": blocks})


def _rows(agents: str, own: str) -> tuple[Row, ...]:
    return (
        Row("DQN", agents, paper={"method": "DQN", "search_budget": "0"}),
        Row("DQN+MCTS, budget 10", agents, "dqn-mcts", 10,
            paper={"method": "DQN+MCTS", "search_budget": "10"}),
        Row("ours, no search", own, help=MODEL_LABELS, kind=OWN),
        Row("ours, budget 10", own, "dqn-mcts", 10, help=MODEL_LABELS, kind=OWN),
        _LOOK_AHEAD,
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
         _LOOK_AHEAD),
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
