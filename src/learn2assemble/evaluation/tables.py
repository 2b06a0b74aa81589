"""The paper's tables without a robot, and the one of the README, as data (protocol 12.2).

Those with a robot are in :mod:`learn2assemble.evaluation.robot_tables`.
"""

from __future__ import annotations

import dataclasses

from learn2assemble.errors import UnknownNameError
from learn2assemble.evaluation.robot_tables import ROBOT_TABLES
from learn2assemble.evaluation.table_spec import (
    KNOWS,
    LOOK_AHEAD,
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
from learn2assemble.search.config import TO_THE_END

OWN_CUBES, OWN_BARS, OWN_OBJECTS = "relational-cubes", "relational-bars", "relational-objects"
"""Stems of our own agents."""


def _cubes(grid: str, blocks: str, star: bool = False) -> Column:
    return Column(f"two-sided-{grid}-{blocks}", star, {"grid": grid, "blocks": blocks})


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

_T1_COLUMNS = (_cubes("3x3", "20-24", True), _cubes("3x3", "30-34"), _cubes("4x4", "20-24"))
_T2_COLUMNS = (
    _cubes("3x3", "20-24", True), _cubes("3x3", "30-34"), _cubes("4x4", "30-34"),
    _cubes("5x5", "40-44"),
)  # fmt: skip
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
        (_T2_COLUMNS[0], _T2_COLUMNS[3]),
        (*(Row(label, f"ablation-{stem}", help=help_, kind=OWN) for label, stem, help_ in _PARTS),
         _learner("DQN", 0),
         Row("shipped agent, no search", OWN_CUBES, help=MODEL_LABELS, kind=OWN),
         *(Row(f"shipped agent, {name}, budget 10", OWN_CUBES, name, 10, distinct=True,
               help=MODEL_LABELS, kind=OWN) for name in ("dqn-mcts", "widening", "gumbel")),
         _LOOK_AHEAD),
        trainings=(*(f"ablation-{stem}" for _, stem, _ in _PARTS), "dqn", OWN_CUBES),
    ),
    Table(
        "shipped", "The shipped agent beside the published methods",
        (*(dataclasses.replace(column, star=False) for column in _T2_COLUMNS[:3]),
         dataclasses.replace(_T2_COLUMNS[3], star=True), _cubes("6x6", "50-54")),
        (Row("no search", OWN_CUBES, help=MODEL_LABELS, kind=OWN,
             paper={"method": "DQN", "search_budget": "0"}),
         Row("budget 10", OWN_CUBES, "dqn-mcts", 10, help=MODEL_LABELS, kind=OWN,
             paper={"method": "DQN+MCTS", "search_budget": "10"}),
         _LOOK_AHEAD),
        {"source_table": "main_T2"},
        (Condition(0.05), Condition(0.0), Condition(0.05, "rigid")),
        trainings=(OWN_CUBES,),
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
