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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

from learn2assemble.envs.suite import SUITE, SUITE_VERSION, Choose, Played, SuiteTask
from learn2assemble.errors import InputError, check_arguments, check_fields, is_whole, printable
from learn2assemble.files import check_new, read_json_lines, write_file
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
    run: int = 0
    """Which policy of the entry played: those of several seeds of training are runs of one."""


@dataclass(frozen=True)
class Submission:
    """An entry: the first problems of some tasks of the suite, played, by one policy or by several
    that differ in the seed of their training alone."""

    entry: str
    """Its name on the board."""
    knows: Literal["observation", "model"]
    """``observation``, or ``model`` for policies that were given the environment."""
    suite: int
    """Version of the suite."""
    played: tuple[PlayedProblem, ...]

    def __post_init__(self) -> None:
        entry: Any = self.entry  # As it is read from a file.
        plain = isinstance(entry, str) and re.fullmatch(r"[\w .,()+-]{1,60}", entry)
        check_fields(
            self,
            ("entry", bool(plain), "a name of 1 to 60 letters, digits and spaces"),
            ("knows", self.knows in ("observation", "model"), "'observation' or 'model'"),
        )

    def scores(self, task: str) -> np.ndarray:
        """float64[runs, n] of the problems of a task that were played."""
        mine = [one for one in self.played if one.task == task]
        return np.array([one.score for one in mine]).reshape(
            max(len({one.run for one in mine}), 1), -1
        )

    def write(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the file, ``NAME.jsonl.gz``.

        Args:
            path: a new file.
            overwrite: also one that is there.

        Raises:
            InputError: for another ending, a file that is there, or one that cannot be written.
        """
        check_path(path := Path(path))
        check_new(path, "path", overwrite=overwrite)
        lines = self._lines()
        head = {**self._head(), "sha256": _digest(lines)}
        text = "".join(f"{line}\n" for line in [_line(head), *lines[1:]])
        write_file(path, gzip.compress(text.encode(), 9, mtime=0), "path")

    def _head(self) -> dict[str, Any]:
        return {"entry": self.entry, "format": FORMAT, "knows": self.knows, "suite": self.suite}

    def _lines(self) -> list[str]:
        return [_line(self._head()), *(_line(_told(one)) for one in self.played)]


def check_path(path: Path) -> None:
    """Refuse the name of a file that is not ``NAME.jsonl.gz``.

    Raises:
        InputError: for another ending.
    """
    if not path.name.endswith(ENDING):
        raise InputError("path", printable(str(path)), f"a name that ends with {ENDING}")


def _told(one: PlayedProblem) -> dict[str, Any]:
    plain: dict[str, Any] = to_plain(one)
    return plain if one.run else {key: value for key, value in plain.items() if key != "run"}


def _line(value: dict[str, Any]) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"))


def _digest(lines: Sequence[str]) -> str:
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def enter(
    policy: Choose | Sequence[Choose],
    name: str,
    *,
    tasks: Sequence[str] = tuple(SUITE),
    problems: int | None = None,
    progress: Callable[[str], None] = lambda line: None,
) -> Submission:
    """Play the benchmark.

    Args:
        policy: see :data:`learn2assemble.envs.suite.Choose`; several are the runs of one entry.
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
    runs: list[Choose] = (
        list(cast("Sequence[Choose]", policy)) if isinstance(policy, Sequence) else [policy]
    )
    known = {_knows(one) for one in runs}
    if len(known) != 1:
        raise InputError("policies", len(runs), "one or more that know the same")
    knows: Any = known.pop()
    Submission(name, knows, SUITE_VERSION, ())  # Refused before anything is played.
    chosen = [SuiteTask(task) for task in sorted(set(tasks))]
    played: list[PlayedProblem] = []
    for task in chosen:
        env, count = task.make(), min(problems or SUITE[task.name], SUITE[task.name])
        # All runs play a problem before the next: some take longer to draw than to play.
        found = [
            [_record(task, k, n, task.play(env, n, one)) for k, one in enumerate(runs)]
            for n in range(count)
        ]
        for run, mine in enumerate(zip(*found, strict=True)):
            played += mine
            mean = np.mean([one.score for one in mine])
            which = f", run {run + 1} of {len(runs)}" if len(runs) > 1 else ""
            progress(f"{task.name}{which}: {count} problems, {mean:.3f} of the bound")
    return Submission(name, knows, SUITE_VERSION, tuple(played))


def _knows(policy: Choose) -> str:
    return getattr(policy, "knows", "model" if hasattr(policy, "begin") else "observation")


def _record(task: SuiteTask, run: int, problem: int, done: Played) -> PlayedProblem:
    return PlayedProblem(task.name, problem, tuple(done.actions), done.score, done.success, run)


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
    tasks = [one.task for one in found.played]
    if tasks != sorted(tasks):
        raise InputError(f"{source}: problem", tasks[:3], "all from 0 on, sorted by task and run")
    for task in sorted(set(tasks)):
        mine = [(one.run, one.problem) for one in found.played if one.task == task]
        runs = mine[-1][0] + 1
        count = len(mine) // max(runs, 1)
        SuiteTask(task).seed(count - 1)
        for at, whole in zip(mine, np.ndindex(runs, count), strict=False):
            if at != whole:
                raise InputError(f"{source}: {task} run, problem", at, str(whole))
        if len(mine) != runs * count:
            raise InputError(f"{source}: {task}", len(mine), f"{count} problems for each run")
    return found


class _Again:
    """Plays actions that are known."""

    def __init__(self, actions: Sequence[int]) -> None:
        self._left = iter(actions)

    def __call__(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> int:
        return next(self._left)


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
        mine = [one for one in found.played if one.task == name]
        for one in sorted(mine, key=lambda one: one.problem):  # As they were played.
            done = task.play(env, one.problem, _Again(one.actions))
            true = _record(task, one.run, one.problem, done)
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
            task: {
                "score": float(entry.scores(task).mean()),
                "problems": entry.scores(task).shape[1],
                "runs": entry.scores(task).shape[0],
            }
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
    those of goals together; of an entry with several runs the interval is that of their means, by
    Student's t. A task that was left out counts nothing. Where errors are hidden, the share of the
    problems that were completed is told, too.
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
        scores = [_together([entry.scores(t) for t in tasks]) for tasks in columns.values()]
        if not any(one.size for one in scores):
            continue
        cells = list(map(_cell, scores))
        if completes:
            done = [one.success for one in entry.played if _kind(one.task) == kind]
            cells.append(f"{sum(done)} of {len(done)}")
        total = sum(float(one.mean()) for one in scores if one.size)
        line = " | ".join([entry.entry, entry.knows, *cells])
        rows.append((-total, entry.entry, f"| {line} |"))
    if not rows:
        return ""
    names = ["entry", "knows", *(f"`{name}`" for name in columns), *["completed"] * completes]
    head, rule = f"| {' | '.join(names)} |", "|---" * len(names) + "|"
    return "\n".join([head, rule, *(row for *_, row in sorted(rows))]) + "\n"


def _together(scores: Sequence[np.ndarray]) -> np.ndarray:
    """float64[runs, n]: those of the tasks of a column that were played."""
    played = [one for one in scores if one.size]
    return np.concatenate(played, 1) if played else np.empty((0, 0))


def _cell(scores: np.ndarray) -> str:
    if not scores.size:
        return "–"
    runs, problems = scores.shape
    values = scores.mean(1) if runs > 1 else scores[0]
    law: Any = stats.t  # Its types are known in part.
    times = float(law.ppf(0.975, runs - 1)) if runs > 1 else 1.96
    many = len(values) > 1
    spread = times * values.std(ddof=1) / math.sqrt(len(values)) if many else 0.0
    around = f" ± {spread:.3f}" if many else ""
    played = f"{problems} x {runs}" if runs > 1 else f"{problems}"
    return f"{scores.mean():.3f}{around} ({played})"
