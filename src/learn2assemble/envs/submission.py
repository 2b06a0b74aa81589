"""Entries of the benchmark as files: written by playing, checked by playing again, and the board.

A file is lines of JSON with sorted keys, compressed: a head, then a line for every problem with
the actions taken. The same entry is the same bytes.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from learn2assemble.envs.suite import SUITE, SUITE_VERSION, Choose, Played, SuiteTask
from learn2assemble.errors import InputError, check_arguments, check_fields, is_whole
from learn2assemble.files import printable, read_json_lines, write_file
from learn2assemble.tasks.task import DESIGN_TASKS, GOAL_TASKS, HIDDEN_TASKS
from learn2assemble.values import from_plain, to_plain

FORMAT = "learn2assemble-benchmark"
ENDING = ".jsonl.gz"
TOLERANCE = 1e-9
"""How far a score may be from that of the actions played again."""


@dataclass(frozen=True)
class PlayedProblem:
    """A line of a file."""

    task: str
    problem: int
    actions: tuple[int, ...]
    score: float
    success: bool


@dataclass(frozen=True)
class Submission:
    """An entry: the first problems of some tasks of the suite, played."""

    entry: str
    """Its name on the board."""
    knows: Literal["observation", "model"]
    """``observation``, or ``model`` for policies that were given the environment."""
    suite: int
    """Version of the suite."""
    played: tuple[PlayedProblem, ...]

    def __post_init__(self) -> None:
        plain = isinstance(self.entry, str) and re.fullmatch(r"[\w .,()+-]{1,60}", self.entry)
        check_fields(
            self,
            ("entry", bool(plain), "a name of 1 to 60 letters, digits and spaces"),
            ("knows", self.knows in ("observation", "model"), "'observation' or 'model'"),
        )

    def scores(self, task: str) -> np.ndarray:
        """float64[n] of the problems of a task that were played."""
        return np.array([one.score for one in self.played if one.task == task])

    def write(self, path: str | Path) -> None:
        """Write the file, ``NAME.jsonl.gz``.

        Raises:
            InputError: for another ending, or a file that cannot be written.
        """
        check_path(path := Path(path))
        lines = self._lines()
        head = {**self._head(), "sha256": _digest(lines)}
        text = "".join(f"{line}\n" for line in [_line(head), *lines[1:]])
        write_file(path, gzip.compress(text.encode(), 9, mtime=0), "path")

    def _head(self) -> dict[str, Any]:
        return {"entry": self.entry, "format": FORMAT, "knows": self.knows, "suite": self.suite}

    def _lines(self) -> list[str]:
        return [_line(self._head()), *(_line(to_plain(one)) for one in self.played)]


def check_path(path: Path) -> None:
    """Refuse the name of a file that is not ``NAME.jsonl.gz``.

    Raises:
        InputError: for another ending.
    """
    if not path.name.endswith(ENDING):
        raise InputError("path", printable(str(path)), f"a name that ends with {ENDING}")


def _line(value: dict[str, Any]) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"))


def _digest(lines: Sequence[str]) -> str:
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def enter(
    policy: Choose,
    name: str,
    *,
    tasks: Sequence[str] = tuple(SUITE),
    problems: int | None = None,
    progress: Callable[[str], None] = lambda line: None,
) -> Submission:
    """Play the benchmark.

    Args:
        policy: see :data:`learn2assemble.envs.suite.Choose`.
        name: of the entry.
        tasks: of the suite; all by default.
        problems: the first so many of every task; all by default.
        progress: told what has been played.

    Raises:
        InputError: for tasks that are not in the suite and names that are no plain text.
    """
    check_arguments(
        {"problems": problems},
        ("problems", problems is None or is_whole(problems, 1), "a whole number of at least 1"),
    )
    knows: Any = getattr(policy, "knows", "model" if hasattr(policy, "begin") else "observation")
    Submission(name, knows, SUITE_VERSION, ())  # Refused before anything is played.
    chosen = [SuiteTask(task) for task in sorted(set(tasks))]
    played: list[PlayedProblem] = []
    for task in chosen:
        env, count = task.make(), min(problems or SUITE[task.name], SUITE[task.name])
        for problem in range(count):
            done = task.play(env, problem, policy)
            played.append(_record(task, problem, done))
        mean = np.mean([one.score for one in played[-count:]])
        progress(f"{task.name}: {count} problems, {mean:.3f} of the bound")
    return Submission(name, knows, SUITE_VERSION, tuple(played))


def _record(task: SuiteTask, problem: int, done: Played) -> PlayedProblem:
    return PlayedProblem(task.name, problem, tuple(done.actions), done.score, done.success)


def read_submission(path: str | Path) -> Submission:
    """Read a file; what it holds is whole, but not yet known to be true.

    Raises:
        InputError: for a file that is damaged, changed, of another suite, or leaves problems out.
    """
    path = Path(path)
    source = printable(path.name)
    head, *rest = [dict(line) for line in read_json_lines(path, "benchmark entry")] or [{}]
    if head.get("format") != FORMAT:
        raise InputError(f"{source}: format", head.get("format"), repr(FORMAT))
    if head.get("suite") != SUITE_VERSION:
        raise InputError(f"{source}: suite", head.get("suite"), f"version {SUITE_VERSION}")
    told = head.pop("sha256", None)
    del head["format"]
    found = from_plain(Submission, {**head, "played": rest}, source)
    if told != _digest(found._lines()):
        raise InputError(f"{source}: sha256", told, "that of its lines; the file was changed")
    numbers: dict[str, int] = {}
    for one in found.played:
        SuiteTask(one.task).seed(one.problem)
        if one.problem != numbers.get(one.task, 0) or one.task < max(numbers, default=""):
            raise InputError(f"{source}: problem", one.problem, "all from 0 on, sorted by task")
        numbers[one.task] = one.problem + 1
    return found


def check(path: str | Path, *, progress: Callable[[str], None] = lambda line: None) -> Submission:
    """Read a file and play its actions again.

    Raises:
        InputError: as :func:`read_submission`; and for a problem whose actions do not lead to what
            is said of it.
    """
    found, source = read_submission(path), printable(Path(path).name)
    for name in sorted({one.task for one in found.played}):
        task = SuiteTask(name)
        env = task.make()
        for one in (one for one in found.played if one.task == name):
            actions = iter(one.actions)
            done = task.play(env, one.problem, lambda *_, rest=actions: next(rest))
            true = _record(task, one.problem, done)
            same = (true.actions, true.success) == (one.actions, one.success)
            if not same or not math.isclose(true.score, one.score, abs_tol=TOLERANCE):
                said = f"score {one.score:.6g}, success {one.success}, {len(one.actions)} actions"
                real = f"{true.score:.6g}, {true.success}, {len(true.actions)} by its own actions"
                raise InputError(f"{source}: {name} problem {one.problem}", said, real)
        progress(f"{name}: as said")
    return found


def summary(entry: Submission) -> dict[str, Any]:
    """What an entry came to, as plain data: the mean score and the problems of every task."""
    tasks = sorted({one.task for one in entry.played})
    return {
        "entry": entry.entry,
        "knows": entry.knows,
        "tasks": {
            task: {"score": float(entry.scores(task).mean()), "problems": len(entry.scores(task))}
            for task in tasks
        },
    }


def _kind(task: str) -> str:
    kinds = {"designs": DESIGN_TASKS, "hidden errors": HIDDEN_TASKS, "goals": GOAL_TASKS}
    return next((kind for kind, tasks in kinds.items() if task in tasks), "placements")


def board(entries: Sequence[Submission]) -> str:
    """The entries as Markdown, a table for every kind of task that was played, the best mean over
    its tasks first.

    A cell is the mean share of the bound with half its 95 % interval and the number of problems,
    those of goals together; a task that was left out counts nothing. Where errors are hidden, the
    share of the problems that were completed is told, too.
    """
    kinds: dict[str, dict[str, list[str]]] = {}
    for task in SUITE:
        column = "goals-*" if task in GOAL_TASKS else task
        kinds.setdefault(_kind(task), {}).setdefault(column, []).append(task)
    found = ((kind, _table(entries, kind, columns)) for kind, columns in kinds.items())
    return "\n".join(f"**{kind.capitalize()}**\n\n{table}" for kind, table in found if table)


def _table(entries: Sequence[Submission], kind: str, columns: dict[str, list[str]]) -> str:
    """The entries that played tasks of a kind; empty where none did."""
    completes = kind == "hidden errors"
    rows: list[tuple[float, str, str]] = []
    for entry in entries:
        scores = [np.concatenate([entry.scores(t) for t in tasks]) for tasks in columns.values()]
        if not any(map(len, scores)):
            continue
        cells = list(map(_cell, scores))
        if completes:
            done = [one.success for one in entry.played if _kind(one.task) == kind]
            cells.append(f"{sum(done)} of {len(done)}")
        total = sum(float(one.mean()) for one in scores if len(one))
        line = " | ".join([entry.entry, entry.knows, *cells])
        rows.append((-total, entry.entry, f"| {line} |"))
    if not rows:
        return ""
    names = ["entry", "knows", *(f"`{name}`" for name in columns), *["completed"] * completes]
    head, rule = f"| {' | '.join(names)} |", "|---" * len(names) + "|"
    return "\n".join([head, rule, *(row for *_, row in sorted(rows))]) + "\n"


def _cell(scores: np.ndarray) -> str:
    if not len(scores):
        return "–"
    spread = 1.96 * scores.std(ddof=1) / math.sqrt(len(scores)) if len(scores) > 1 else 0.0
    around = f" ± {spread:.3f}" if len(scores) > 1 else ""
    return f"{scores.mean():.3f}{around} ({len(scores)})"
