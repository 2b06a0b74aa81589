"""Demonstrations: what Minari reads is what the environments do with the recorded actions."""

from __future__ import annotations

import os
import runpy
import sys
from pathlib import Path
from typing import Any

import gymnasium
import minari
import numpy as np
import pytest

from learn2assemble.envs import demonstrations
from learn2assemble.envs.demonstrations import ROOT, Demonstrated, demonstrate
from learn2assemble.errors import InputError, UnknownNameError

TASK, DESIGNS = "two-sided-3x3-20-24", "designs-cubes-60"


def loaded(made: Demonstrated, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setenv(ROOT, str(folder))
    return minari.load_dataset(made.dataset)


@pytest.mark.parametrize(
    ("task", "episodes", "name"),
    [(TASK, 7, "relational-cubes-s0"), (DESIGNS, 3, "planner")],
)
def test_a_data_set_is_read_back(
    task: str, episodes: int, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its episodes are whole, its figures are those of its episodes, its spaces those of the
    environment that it names."""
    made = demonstrate(task, tmp_path, episodes=episodes, seed=3)
    assert made.dataset == f"learn2assemble/{task}/{name}-v1"
    assert made.folder == tmp_path / made.dataset
    assert [p.name for p in made.folder.parent.iterdir() if p.is_dir()] == [f"{name}-v1"]
    data = loaded(made, tmp_path, monkeypatch)
    env = data.recover_environment()
    assert (data.total_episodes, data.total_steps) == (episodes, made.steps)
    total, lengths = 0.0, set[int]()
    for episode in data.iterate_episodes():
        count = len(episode.actions)
        lengths.add(count)
        assert episode.terminations.tolist() == [False] * (count - 1) + [True]
        assert not episode.truncations.any()
        total += float(episode.rewards.sum())
        for k in range(count + 1):
            seen = {key: value[k] for key, value in episode.observations.items()}
            seen = {key: np.asarray(v, env.observation_space[key].dtype) for key, v in seen.items()}
            assert env.observation_space.contains(seen)
            if k < count:
                assert env.action_space.contains(episode.actions[k])
                assert episode.infos["action_masks"][k, episode.actions[k]] == 1
    assert total / episodes == pytest.approx(made.R)
    assert len(lengths) > 1, "problems differ"
    if task == DESIGNS:
        assert (made.R, made.success) == (pytest.approx(2.0), 1.0)


def test_the_recorded_actions_give_the_recorded_rewards(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Played in the environment from the same problem, to the last observation."""
    made = demonstrate(TASK, tmp_path, episodes=2, seed=1)
    (first, *_) = loaded(made, tmp_path, monkeypatch).iterate_episodes()
    env = gymnasium.make(f"learn2assemble/{TASK}-v0", actions="placements").unwrapped
    seed = demonstrations.piece_seed(1, 0)
    observation, _ = env.reset(seed=seed)
    for k, action in enumerate(first.actions):
        for key, value in observation.items():
            np.testing.assert_array_equal(value, first.observations[key][k])
        observation, reward, ended, _, _ = env.step(action)
        assert (reward, ended) == (first.rewards[k], first.terminations[k])
    for key, value in observation.items():
        np.testing.assert_array_equal(value, first.observations[key][-1])


def test_designs_are_replayed_and_take_little_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where a solution needs a candidate that no action names: such a design is left out, and
    nothing of it gets into the next episode. Files are compressed (28 MB an episode else)."""
    task, seed = "designs-lintels-60", 5
    made = demonstrate(task, tmp_path, episodes=4, seed=seed)
    assert made.success == 1.0
    size = sum(file.stat().st_size for file in made.folder.rglob("*.hdf5"))
    env: Any = gymnasium.make(f"learn2assemble/{task}-v0").unwrapped
    observation, info = env.reset(seed=demonstrations.piece_seed(seed, 0))
    count = left_out = 0
    for episode in loaded(made, tmp_path, monkeypatch).iterate_episodes():
        while not np.array_equal(observation["candidates"], episode.observations["candidates"][0]):
            observation, info = env.reset()
            left_out += 1
        for k, action in enumerate(episode.actions):
            np.testing.assert_array_equal(
                observation["candidates"], episode.observations["candidates"][k]
            )
            observation, reward, _, _, info = env.step(action)
            assert reward == episode.rewards[k]
            count += 1
        assert info["success"]
        observation, info = env.reset()
    assert left_out == 1
    assert size < 0.05 * count * observation["candidates"].nbytes


def test_workers_and_interruptions_change_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demonstrations, "PIECE", 3)
    whole = demonstrate(TASK, tmp_path / "a", episodes=8)
    made: list[Path] = []
    play = demonstrations._make

    def stop_after_two(piece: Any) -> int:
        if len(made) == 2:
            raise KeyboardInterrupt
        made.append(piece.file)
        return play(piece)

    with monkeypatch.context() as patch:
        patch.setattr(demonstrations, "_make", stop_after_two)
        with pytest.raises(KeyboardInterrupt):
            demonstrate(TASK, tmp_path / "b", episodes=8)
    before = {file: file.read_bytes() for file in made}
    told, left = list[str](), list[Any]()
    with monkeypatch.context() as patch:
        patch.setattr(demonstrations, "_make", lambda piece: left.append(piece) or play(piece))
        again = demonstrate(TASK, tmp_path / "b", episodes=8, progress=told.append)
    assert len(left) == 1, "two pieces of three were there"
    assert told == ["8 of 8 episodes, putting them together"]
    assert not any(file.exists() for file in before)
    a, b = (loaded(m, tmp_path / n, monkeypatch) for m, n in ((whole, "a"), (again, "b")))
    for one, other in zip(a.iterate_episodes(), b.iterate_episodes(), strict=True):
        np.testing.assert_array_equal(one.actions, other.actions)
        np.testing.assert_array_equal(one.observations["nodes"], other.observations["nodes"])


def test_what_cannot_be_demonstrated_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for words, given in {
        "built as the exact planner builds it": {"task": DESIGNS, "agent": "dqn-s0"},
        "1 to 1000000": {"task": TASK, "episodes": 0},
        "at least 0": {"task": TASK, "seed": -1},
    }.items():
        with pytest.raises(InputError, match=words):
            demonstrate(out=tmp_path, **given)
    with pytest.raises(UnknownNameError, match="two-sided-3x3-20-24"):
        demonstrate("two-sided-3x3-20-42", tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="writable"):
        demonstrate(TASK, tmp_path / "file", episodes=1)
    demonstrate(TASK, tmp_path, episodes=1)
    with pytest.raises(InputError, match="not there yet"):
        demonstrate(TASK, tmp_path, episodes=1)
    assert ROOT not in os.environ


@pytest.mark.slow
@pytest.mark.usefixtures("torch_as_before")
def test_behaviour_is_cloned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The example learns from a few episodes, and writes an entry that can be checked."""
    from learn2assemble.envs.submission import check

    demonstrate(TASK, tmp_path, episodes=10)
    script = Path(__file__).parents[1] / "examples" / "benchmark" / "behaviour_cloning.py"
    entry = tmp_path / "cloned.jsonl.gz"
    monkeypatch.setenv(ROOT, str(tmp_path))  # As the script does itself.
    monkeypatch.setattr(sys, "argv", [str(script), str(tmp_path), str(entry), "1", "1"])
    runpy.run_path(str(script), run_name="__main__")
    assert "10 episodes" in capsys.readouterr().out
    assert check(entry).entry == "behaviour cloning (10 episodes)"
