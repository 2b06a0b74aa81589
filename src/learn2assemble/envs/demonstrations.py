"""Demonstrations as Minari data sets: tasks of placements played by an agent, designs built as the
exact planner builds them.

A data set is made in pieces of :data:`PIECE` episodes, each a file beside it until all are there:
one that was interrupted goes on, and the same seed gives the same episodes, whoever works on them.
Files have the layout of Minari's (HDF5, a group an episode), and are compressed, which whoever
reads them does not notice: candidates of a design are mostly padding, 28 MB an episode.
"""

from __future__ import annotations

import importlib
import math
import os
import shutil
import time
import warnings
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from learn2assemble.envs import NAMESPACE, env_id
from learn2assemble.envs.assembly import AssemblyVectorEnv
from learn2assemble.envs.designs import DesignEnv
from learn2assemble.errors import InputError, extra, is_whole, look_up
from learn2assemble.files import replacing
from learn2assemble.progress import Counting, Progress, silent
from learn2assemble.tasks.graph.features import node_offset
from learn2assemble.tasks.graph.placements import distinct_placements, locate
from learn2assemble.tasks.networks.agent import default_agent, load_agent, one_thread
from learn2assemble.tasks.task import DESIGN_TASKS, PRESETS
from learn2assemble.tasks.world_model import WorldModel
from learn2assemble.workers import run_all

PIECE, WORLDS = 250, 50
"""Most episodes of a piece; worlds of a task of placements that are stepped at once."""
PIECE_BYTES = 2.0**28
"""No piece has many more bytes of observations in memory, unless it is one episode."""
VERSION = 1
"""Of the data sets: raised when episodes of the same seed change."""
PLANNER = "planner"
ROOT = "MINARI_DATASETS_PATH"
"""The variable of the environment by which Minari finds its data sets."""
SEED_STREAM = 5
"""First word of every seed here; evaluations and trainings use others."""


class Demonstrated(NamedTuple):
    """A data set that was made."""

    dataset: str
    """Its name for ``minari.load_dataset``."""
    folder: Path
    """Where it lies."""
    episodes: int
    steps: int
    R: float
    """Mean return, not discounted."""
    success: float
    """Share of the episodes."""
    seconds: float
    """Wall clock; of the last call, where others went before it."""


class _Piece(NamedTuple):
    """Some episodes of a data set, and the file they go to."""

    task: str
    demonstrator: str
    seed: int
    number: int
    episodes: int
    file: Path


Episode = dict[str, list[Any]]
"""What an episode has of every step: ``actions``, ``rewards``, ``terminations``, ``truncations``
and, with one more, ``observations/NAME`` and ``infos/NAME``. Arrays may be shorter than the space
says; zeros follow."""
_GROUP = "episode_{}"
_CHUNK = 128
"""Candidates that are compressed together."""
_PACKED: dict[str, Any] = {"chunks": True, "compression": "gzip", "compression_opts": 1}


def demonstrate(
    task: str,
    out: str | Path | None = None,
    *,
    agent: str | Path | None = None,
    episodes: int = 10_000,
    seed: int = 0,
    workers: int = 1,
    progress: Progress = silent,
) -> Demonstrated:
    """Make a data set of demonstrations that Minari reads.

    Tasks of placements are played by an agent, greedy and without a search, with one action for
    every distinct placement. Random designs are built in the order of the solution that the exact
    planner found for them. ``infos`` hold ``action_masks`` and, of placements, ``coverage``.

    Args:
        task: of placements (``two-sided-3x3-20-24``), or of designs.
        out: folder of the data sets; that of Minari without it.
        agent: name or file; the shipped one for such tasks without it.
        episodes: how many.
        seed: of everything random.
        workers: processes.
        progress: is told how many episodes there are.

    Raises:
        MissingExtraError: without the extra ``demonstrations``.
        UnknownNameError: for a task that does not exist.
        InputError: for an agent of a task of designs, and for a data set that is there already.
    """
    with extra("minari", "demonstrations"):
        import minari  # pyright: ignore[reportMissingTypeStubs]
        from minari.storage import (  # pyright: ignore[reportMissingTypeStubs]
            get_dataset_path,
        )
    started = time.perf_counter()
    look_up("task", task, {**PRESETS, **DESIGN_TASKS})
    if task in DESIGN_TASKS and agent is not None:
        raise InputError("agent", agent, f"none: {task} is built as the exact planner builds it")
    if not is_whole(episodes, 1, 10**6):
        raise InputError("episodes", episodes, "a whole number from 1 to 1000000")
    if not is_whole(seed, 0):
        raise InputError("seed", seed, "a whole number of at least 0")
    demonstrator = PLANNER if task in DESIGN_TASKS else str(agent or default_agent(task))
    name = PLANNER if task in DESIGN_TASKS else load_agent(demonstrator).name
    dataset = f"{NAMESPACE}/{task}/{name}-v{VERSION}"
    with _datasets_in(out):
        try:
            folder = Path(get_dataset_path(dataset))  # It makes the folder of all data sets.
            parts = folder.with_name(f"{folder.name}.seed{seed}.parts")
            if folder.exists():
                raise InputError("data set", str(folder), "one that is not there yet")
            parts.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            reason = error.strerror or "unwritable"
            raise InputError(
                "folder of data sets", str(out), f"a writable folder ({reason})"
            ) from None
        most = _piece_size(task)
        sizes = [min(most, episodes - first) for first in range(0, episodes, most)]
        pieces = [
            _Piece(task, demonstrator, seed, number, size, parts / f"{number}.hdf5")
            for number, size in enumerate(sizes)
        ]
        done = sum(piece.episodes for piece in pieces if _whole(piece))
        left = [piece for piece in pieces if not _whole(piece)]
        count = Counting("episodes", episodes, progress, done)
        for piece, _ in run_all(_make, left, workers=workers):
            count.add(piece.episodes)
        progress(f"{count.done} of {episodes} episodes, putting them together")
        with _datasets_in(parts):
            steps, total, successes = _put_together(minari, task, name, dataset, pieces, parts)
        os.replace(parts / dataset, folder)
        shutil.rmtree(parts)
    seconds = time.perf_counter() - started
    return Demonstrated(
        dataset, folder, episodes, steps, total / episodes, successes / episodes, seconds
    )


def _hdf5() -> Any:
    """The module ``h5py``, which has no types."""
    with extra("h5py", "demonstrations"):
        return importlib.import_module("h5py")


@contextmanager
def _datasets_in(out: str | Path | None) -> Generator[None, None, None]:
    """Minari finds data sets in ``out``."""
    before = os.environ.get(ROOT)
    if out is not None:
        os.environ[ROOT] = str(Path(out).absolute())
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(ROOT, None)
        else:
            os.environ[ROOT] = before


def _whole(piece: _Piece) -> bool:
    """Whether the file of a piece has its episodes."""
    if not piece.file.is_file():
        return False
    with _hdf5().File(piece.file, "r") as found:
        return len(found) == piece.episodes


def _piece_size(task: str) -> int:
    """Episodes of a piece: as many as their observations allow."""
    env: Any = _environment(task).unwrapped
    steps = env.task.blocks[1] if isinstance(env, DesignEnv) else env.task.max_blocks
    spaces: Any = env.observation_space
    row = sum(math.prod(part.shape) * part.dtype.itemsize for part in spaces.values())
    return int(np.clip(PIECE_BYTES / (row * steps), 1, PIECE))


def _environment(task: str) -> Any:
    """The environment whose actions and observations a data set has."""
    how: dict[str, Any] = {} if task in DESIGN_TASKS else {"actions": "placements"}
    return gymnasium.make(env_id(task), **how)


def piece_seed(seed: int, number: int) -> int:
    """What the environments of a piece are reset with; world k of several with k more."""
    words = np.random.SeedSequence([SEED_STREAM, seed, number])
    return int(words.generate_state(1, np.uint32)[0])


def _make(piece: _Piece) -> int:
    """Play a piece and write its file."""
    seed = piece_seed(piece.seed, piece.number)
    play = _designs if piece.demonstrator == PLANNER else _placements
    spaces: Any = _environment(piece.task).observation_space
    shapes = {f"observations/{name}": part.shape for name, part in spaces.items()}
    with (
        one_thread(),
        replacing(piece.file, "piece of a data set") as part,
        _hdf5().File(part, "w", track_order=True) as file,
    ):
        for number, (episode, success) in enumerate(play(piece, seed)):
            group = file.create_group(_GROUP.format(number))
            for key, rows in episode.items():
                _store(group, key, rows, shapes.get(key))
            group.attrs.update(
                {"id": number, "total_steps": len(episode["actions"]), "success": success}
            )
    return piece.episodes


def _store(group: Any, key: str, rows: list[Any], shape: tuple[int, ...] | None) -> None:
    """Write what every step of an episode has.

    Args:
        shape: that of the space, where arrays may be shorter. Parts of a file that nothing is
            written to are zeros and take no room.
    """
    if shape is None or all(np.shape(row) == shape for row in rows):
        array = np.stack(rows)
        group.create_dataset(key, data=array, maxshape=(None, *array.shape[1:]), **_PACKED)
        return
    size, chunk = (len(rows), *shape), (1, min(shape[0], _CHUNK), *shape[1:])
    how = _PACKED | {"chunks": chunk, "dtype": rows[0].dtype, "maxshape": (None, *shape)}
    whole = group.create_dataset(key, size, **how)
    for number, row in enumerate(rows):
        whole[number, : len(row)] = row


class _Recorder:
    """Steps of worlds, episode by episode."""

    def __init__(self, worlds: int) -> None:
        self._open: list[list[dict[str, Any]]] = [[] for _ in range(worlds)]

    def seen(self, world: int, observation: Mapping[str, Any], info: Mapping[str, Any]) -> None:
        """What a world shows now: a row of the episode that goes on."""
        row: dict[str, Any] = {f"observations/{k}": v for k, v in observation.items()}
        row |= {f"infos/{k}": info[k] for k in ("action_masks", "coverage") if k in info}
        self._open[world].append(row)

    def acted(self, world: int, action: int, reward: float, ended: bool) -> None:
        """What was done with what was seen last."""
        row = {"actions": np.int64(action), "rewards": float(reward), "terminations": ended}
        self._open[world][-1] |= row | {"truncations": False}

    def end(self, world: int) -> Episode:
        """The episode that is over, its last row seen."""
        rows, self._open[world] = self._open[world], []
        return {key: [row[key] for row in rows if key in row] for key in rows[0]}

    def forget(self, world: int) -> None:
        """An episode that is not kept."""
        self._open[world] = []


def _placements(piece: _Piece, seed: int) -> Iterator[tuple[Episode, bool]]:
    """Episodes of a task of placements by an agent, each with its success. Of every world the first
    ones are taken: those that were longer count as much as short ones."""
    worlds = min(WORLDS, piece.episodes)
    each = [piece.episodes // worlds + (k < piece.episodes % worlds) for k in range(worlds)]
    env = AssemblyVectorEnv(
        piece.task, worlds, physics_mask=False, autoreset_mode="SameStep", actions="placements"
    )
    simulator = env.simulator
    model = WorldModel(simulator, load_agent(piece.demonstrator).network)
    found, done = _Recorder(worlds), [list[tuple[Episode, bool]]() for _ in range(worlds)]
    observations, infos = env.reset(seed=seed)
    while any(len(had) < wanted for had, wanted in zip(done, each, strict=True)):
        graph, spec = simulator.observe(env.state), simulator.action_spec
        chosen = model.best(env.state)[1] + node_offset(graph)
        actions = locate(distinct_placements(graph, spec), graph, chosen, spec)
        for k in range(worlds):
            found.seen(k, _row(observations, k), _row(infos, k))
        observations, rewards, ended, _, infos = env.step(actions)
        for k in range(worlds):
            found.acted(k, actions[k], rewards[k], bool(ended[k]))
            if ended[k]:
                last, told = infos["final_obs"][k], _row(infos["final_info"], k)
                found.seen(k, last, told)
                done[k].append((found.end(k), bool(told["success"])))
    for had, wanted in zip(done, each, strict=True):
        yield from had[:wanted]


def _row(batch: Mapping[str, Any], k: int) -> dict[str, Any]:
    """Of one world; what is ended, or said of others only, is left out."""
    return {key: value[k] for key, value in batch.items() if isinstance(value, np.ndarray)}


def _designs(piece: _Piece, seed: int) -> Iterator[tuple[Episode, bool]]:
    """Random designs, built in the order of the solution that the exact planner found."""
    env = DesignEnv(piece.task)
    found, kept = _Recorder(1), 0
    observation, info = env.reset(seed=seed)
    while kept < piece.episodes:
        assert env.solved is not None
        for candidate in env.solved.order:
            numbers = np.flatnonzero(env.offered == candidate)
            if not len(numbers):  # There are more than an action can name.
                break
            action = int(numbers[0])
            found.seen(0, _without_padding(observation), info)
            observation, reward, ended, _, info = env.step(action)
            found.acted(0, action, reward, ended)
        if info["success"]:
            found.seen(0, _without_padding(observation), info)
            kept += 1
            yield found.end(0), True
        found.forget(0)
        observation, info = env.reset()


def _without_padding(observation: dict[str, Any]) -> dict[str, Any]:
    """The candidates that are offered, without the zeros after the last."""
    offered = int(observation["mask"].sum())
    return observation | {"candidates": observation["candidates"][:offered].copy()}


def _put_together(
    minari: Any, task: str, name: str, dataset: str, pieces: list[_Piece], root: Path
) -> tuple[int, float, int]:
    """A whole data set of the pieces, in a folder of data sets of its own; number of steps, sum of
    rewards, episodes with success."""
    h5py = _hdf5()
    successes, total, steps, episodes = 0, 0.0, 0, 0
    whole = root / "whole.hdf5"
    first: dict[str, Any] = {}
    with h5py.File(whole, "w", track_order=True) as out:
        for piece in pieces:
            with h5py.File(piece.file, "r") as stored:
                for number in range(piece.episodes):
                    group = stored[_GROUP.format(number)]
                    first = first or _read(group)
                    # What is compressed is copied as it is.
                    stored.copy(group, out, _GROUP.format(episodes))
                    out[_GROUP.format(episodes)].attrs["id"] = episodes
                    episodes += 1
                    steps += int(group.attrs["total_steps"])
                    total += float(group["rewards"][()].sum())
                    successes += int(group.attrs["success"])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # That author and address are not told.
        made = minari.create_dataset_from_buffers(
            dataset,
            [minari.data_collector.EpisodeBuffer(id=0, **first)],
            env=_environment(task),
            algorithm_name=name,
            description=f"{task} as {name} plays it.",
            data_format="hdf5",
        )
    os.replace(whole, made.storage.data_path / "main_data.hdf5")
    size = made.storage.get_size()
    made.storage.update_metadata(
        {"total_episodes": episodes, "total_steps": steps, "dataset_size": size}
    )
    return steps, total, successes


def _read(group: Any) -> dict[str, Any]:
    """A group of HDF5 as nested dictionaries of arrays."""
    return {key: _read(part) if hasattr(part, "items") else part[()] for key, part in group.items()}
