"""The benchmark: what counts as an entry, what is refused, policies from elsewhere, and pictures in
place of states."""

from __future__ import annotations

import gzip
import importlib.util
import json
import runpy
import socket
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from headless import ROOT
from learn2assemble.cli import main
from learn2assemble.envs import candidate_policies, env_id, suite
from learn2assemble.envs.designs import DesignEnv
from learn2assemble.envs.hidden import HiddenEnv
from learn2assemble.envs.pictures import (
    HIDDEN_PIXEL,
    HIDDEN_SIZE,
    THERE,
    WAITING,
    WANTED,
    PictureObservation,
    pictures_of,
)
from learn2assemble.envs.policies import (
    Lookahead,
    RandomChoice,
    RemoteChoice,
    load_policy,
    trained_agent,
)
from learn2assemble.envs.submission import (
    PlayedProblem,
    Submission,
    _digest,
    _line,
    board,
    check,
    enter,
    read_submission,
)
from learn2assemble.envs.suite import SUITE, SUITE_VERSION, SuiteTask
from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.tasks.evaluation.bounds import quick_bound
from learn2assemble.tasks.evaluation.episodes import (
    episode_generators,
    lookahead_policy,
    play_episodes,
)
from learn2assemble.tasks.hidden_world import STILL
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import get_task
from learn2assemble.tasks.world.coverage import to_pixels

OUTSIDERS = ROOT / "examples" / "benchmark"
ENTRIES = sorted((ROOT / "results" / "benchmark").glob("*.jsonl.gz"))
SMALL, ROBOT = "two-sided-3x3-20-24", "robot-two-sided-3x3-10-14"
HIDDEN = "hidden-designs-20"
FEW = [SMALL, "goals-cantilever"]
PINNED = (4, 2, 0.3259584392866976, 0.04481160998406684)
"""Actions and scores of the first two problems of :data:`SMALL`, played at random."""


@pytest.fixture(scope="module")
def entry() -> Submission:
    return enter(RandomChoice(), "random", tasks=FEW, problems=2)


@pytest.fixture
def file(entry: Submission, tmp_path: Path) -> Path:
    path = tmp_path / "random.jsonl.gz"
    entry.write(path)
    return path


def rewrite(path: Path, change, *, forge: bool = True) -> None:
    """Change the lines of a file, with a hash that fits them again."""
    lines = [json.loads(line) for line in gzip.decompress(path.read_bytes()).splitlines()]
    change(lines)
    if forge:
        del lines[0]["sha256"]
        lines[0]["sha256"] = _digest([_line(line) for line in lines])
    path.write_bytes(gzip.compress("".join(_line(line) + "\n" for line in lines).encode()))


# ---------------------------------------------------------------- the suite


@pytest.mark.parametrize("name", SUITE)
def test_every_task_is_played_within_its_bound(name: str) -> None:
    task = SuiteTask(name)
    env = task.make()
    done = task.play(env, 0, RandomChoice())
    assert done.actions
    assert -1 <= done.score <= 1
    if not name.startswith("designs-"):  # These take seconds.
        assert done == task.play(env, 0, RandomChoice())
        assert done == task.play(task.make(), 0, RandomChoice())


def test_a_change_of_the_suite_is_a_new_version(entry: Submission) -> None:
    """What version 3 means: tasks, problems and scores. Where this fails raise the version."""
    assert SUITE_VERSION == 3
    first, second = (entry.played[k] for k in (-2, -1))
    assert (first.task, len(first.actions), len(second.actions)) == (SMALL, *PINNED[:2])
    assert [first.score, second.score] == pytest.approx(PINNED[2:], abs=1e-9)


@pytest.mark.parametrize("name", [SMALL, "four-sided-3x3-10-18", ROBOT])
def test_no_return_exceeds_the_bound(name: str) -> None:
    """Of look-ahead that is random now and then; where blocks touch the bound can be reached."""
    task = get_task(name)
    simulator, count = Simulator(task), 10 if task.has_arm else 50
    bound = quick_bound(task, simulator.new(count, episode_generators(0)[0]))
    returns = play_episodes(simulator, lookahead_policy(task, 0.1), count, 0).returns
    assert (returns <= bound + 1e-9).all()
    assert (returns / bound).max() > (0.6 if task.has_arm else 0.99)


def test_a_bound_is_only_for_cubes() -> None:
    simulator = Simulator("objects-two-sided-5x5-20-24")
    with pytest.raises(InputError, match="cubes"):
        quick_bound(simulator.task, simulator.new(1, np.random.default_rng(0)))


def test_tasks_and_problems_that_are_not_there_are_named() -> None:
    with pytest.raises(InputError, match="did you mean 'goals-bridge'"):
        SuiteTask("goals-bridges")
    with pytest.raises(InputError, match="0 to 49"):
        SuiteTask(SMALL).seed(50)
    seeds = {SuiteTask(SMALL).seed(n) for n in range(50)}
    assert len(seeds) == 50


# ---------------------------------------------------------------- files


def test_a_file_is_what_was_played(entry: Submission, file: Path, tmp_path: Path) -> None:
    assert read_submission(file) == check(file) == entry
    enter(RandomChoice(), "random", tasks=FEW[::-1], problems=2).write(tmp_path / "b.jsonl.gz")
    assert (tmp_path / "b.jsonl.gz").read_bytes() == file.read_bytes()


def raise_score(lines: list[dict]) -> None:
    lines[2]["score"] += 1e-6


def other_action(lines: list[dict]) -> None:
    lines[2]["actions"][0] = (lines[2]["actions"][0] + 1) % 5


def action_more(lines: list[dict]) -> None:
    lines[2]["actions"].append(0)


def action_less(lines: list[dict]) -> None:
    lines[2]["actions"].pop()


def claim_success(lines: list[dict]) -> None:
    lines[2]["success"] = not lines[2]["success"]


def leave_out(lines: list[dict]) -> None:
    del lines[2]


def twice(lines: list[dict]) -> None:
    lines.append(lines[2])


def other_suite(lines: list[dict]) -> None:
    lines[0]["suite"] += 1


def foreign_task(lines: list[dict]) -> None:
    lines[1]["task"] = "two-sided-9x9"


def no_action(lines: list[dict]) -> None:
    lines[2]["actions"][0] = 10**6


def bad_name(lines: list[dict]) -> None:
    lines[0]["entry"] = "a | b"


@pytest.mark.parametrize(
    "change",
    [
        raise_score,
        other_action,
        action_more,
        action_less,
        claim_success,
        leave_out,
        twice,
        other_suite,
        foreign_task,
        no_action,
        bad_name,
    ],
)
def test_a_file_that_was_tampered_with_is_refused(
    change, file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rewrite(file, change)
    assert main(["benchmark", "check", str(file)]) == 2
    said = capsys.readouterr()
    assert not said.out
    assert len([line for line in said.err.splitlines() if "as said" not in line]) == 1


def test_the_hash_is_looked_at_without_playing(file: Path) -> None:
    rewrite(file, raise_score, forge=False)
    with pytest.raises(InputError, match="the file was changed"):
        read_submission(file)


@pytest.mark.parametrize(
    "content", [b"", b"nonsense", gzip.compress(b"[]\n", mtime=0), gzip.compress(b"", mtime=0)]
)
def test_a_file_that_is_none_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.jsonl.gz"
    path.write_bytes(content)
    with pytest.raises(InputError):
        read_submission(path)


def test_the_board_has_the_best_first() -> None:
    entry = enter(RandomChoice(), "random", tasks=[SMALL], problems=2)
    other = enter(Lookahead(), "look-ahead", tasks=[SMALL], problems=2)
    rows = board([entry, other]).splitlines()
    assert rows[0] == "**Placements**"
    assert rows[2].startswith("| entry | knows | `two-sided-3x3-20-24` | ")
    assert rows[2].count("|") == 6
    assert rows[4].startswith("| look-ahead | model | ")
    assert rows[4].endswith(" (2) | – | – |")
    assert rows[5].startswith("| random | observation | ")
    assert f"{entry.scores(SMALL).mean():.3f} ±" in rows[5]
    assert len(rows) == 6  # Nobody played another kind of task.


def test_the_board_has_a_table_for_each_kind_of_task() -> None:
    played = [
        PlayedProblem(task, number, (), score, score == 1)
        for task in ("goals-bridge", HIDDEN)
        for number, score in enumerate((1.0,) if task != HIDDEN else (1.0, 0.5))
    ]
    text = board([Submission("x", "model", SUITE_VERSION, tuple(played))])
    assert [line for line in text.splitlines() if line.startswith("**")] == [
        "**Hidden errors**",
        "**Goals**",
    ]
    assert f"| entry | knows | `{HIDDEN}` | completed |" in text
    assert "| x | model | 0.750 ± 0.490 (2) | 1 of 2 |" in text
    heads = [line for line in text.splitlines() if line.startswith("| entry")]
    assert all(head.count("|") <= 9 for head in heads)


def test_policies_of_several_seeds_are_runs_of_one_entry(tmp_path: Path) -> None:
    entry = enter([RandomChoice(), trained_agent("dqn-s1")], "two", tasks=[SMALL], problems=3)
    assert [(one.run, one.problem) for one in entry.played] == [
        (run, problem) for run in range(2) for problem in range(3)
    ]
    alone = enter(trained_agent("dqn-s1"), "one", tasks=[SMALL], problems=3)
    assert (entry.scores(SMALL)[1] == alone.scores(SMALL)[0]).all()
    entry.write(path := tmp_path / "two.jsonl.gz")
    assert check(path) == entry
    means = entry.scores(SMALL).mean(1)
    spread = 12.706 * means.std(ddof=1) / np.sqrt(2)  # Student's t of one degree of freedom.
    assert f"| {means.mean():.3f} ± {spread:.3f} (3 x 2) |" in board([entry])
    for wrong in (entry.played[:5], entry.played[3:], entry.played[::-1]):
        replace(entry, played=wrong).write(path := tmp_path / "wrong.jsonl.gz", overwrite=True)
        with pytest.raises(InputError, match="problem"):
            read_submission(path)
    with pytest.raises(InputError, match="know the same"):
        enter([RandomChoice(), Lookahead()], "mixed", tasks=[SMALL], problems=1)


def test_the_board_of_the_documents_is_that_of_its_files() -> None:
    page = (ROOT / "docs" / "benchmark.md").read_text(encoding="utf-8")
    assert board([read_submission(file) for file in ENTRIES]) in page


@pytest.mark.parametrize("path", ENTRIES, ids=lambda path: path.name.partition(".")[0])
def test_the_first_problems_of_every_entry_play_as_they_say(path: Path, tmp_path: Path) -> None:
    """All of them take minutes; large heaps take seconds to draw."""
    entry = read_submission(path)
    few = [one for one in entry.played if one.problem == 0 and "-400-" not in one.task]
    assert few
    replace(entry, played=tuple(few)).write(tmp_path / path.name)
    check(tmp_path / path.name)


# ---------------------------------------------------------------- policies


def test_tight_heaps_ask_for_more_than_one_step_ahead() -> None:
    """The exact planner fills what the look-ahead, which knows the model as well, does not."""
    task = SuiteTask("designs-lintels-60-heap-held-out")
    env = task.make()
    planned, ahead = (task.play(env, 0, load_policy(n)) for n in ("exact-planner", "look-ahead"))
    assert (planned.score, planned.success) == (pytest.approx(1.0), True)
    assert 0 < ahead.score < 0.9
    assert not ahead.success
    with pytest.raises(InputError, match="designs-"):
        SuiteTask(SMALL).play(SuiteTask(SMALL).make(), 0, load_policy("exact-planner"))


def test_random_choices_differ_by_their_seed_and_repeat() -> None:
    runs = [load_policy(f"random:{seed}") for seed in (0, 1, 1)]
    entry = enter(runs, "random", tasks=FEW, problems=2)
    chosen = [[one.actions for one in entry.played if one.run == run] for run in range(3)]
    assert chosen[0] != chosen[1] == chosen[2]
    plain = enter(load_policy("random"), "random", tasks=FEW, problems=2)
    assert [one.actions for one in plain.played] == chosen[0]


def test_goals_ask_for_more_than_one_step_ahead(monkeypatch: pytest.MonkeyPatch) -> None:
    """Who looks one step ahead is better than chance and invents two structures of the three, with
    more blocks than the planner."""
    goals = [name for name in SUITE if name.startswith("goals-")]
    chance = enter([load_policy(f"random:{seed}") for seed in range(5)], "random", tasks=goals)
    ahead = enter(Lookahead(), "look-ahead", tasks=goals)
    assert [one.task for one in ahead.played if one.success] == goals[1:]
    for name in goals[1:]:
        assert ahead.scores(name).max() > chance.scores(name).max()
    monkeypatch.setattr(candidate_policies, "PROGRAM", 1.0)  # It finds nothing better.
    task = SuiteTask("goals-cantilever")
    exact = task.play(task.make(), 0, load_policy("exact-planner"))
    assert exact.success
    assert exact.score == pytest.approx((2 - 0.05 * len(exact.actions)) / 1.95)
    assert exact.score > ahead.scores("goals-cantilever").item()


def test_looking_ahead_changes_nothing() -> None:
    """Goals are looked at in a flat copy of their environment."""
    env = SuiteTask("goals-table").make()

    def play(ahead: Lookahead | None) -> list[tuple]:
        told, (seen, info) = [], env.reset(seed=0)
        for _ in range(4):
            if ahead is not None:
                ahead.begin(env)
                ahead(seen, info)
            seen, reward, _, _, info = env.step(np.int64(0))
            told.append((reward, info["missing"], seen["candidates"].tobytes()))
        return told

    assert play(Lookahead()) == play(None)


def test_planning_takes_time_of_the_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a policy does before the first action is thought, too."""

    class Slow(RandomChoice):
        def begin(self, env) -> None:
            monkeypatch.setattr(suite, "SECONDS", 0.0)

    task = SuiteTask(SMALL)
    assert task.play(task.make(), 0, Slow()).actions == []


def test_the_command_enters_a_policy_of_a_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "heuristic.jsonl.gz"
    policy = f"{OUTSIDERS / 'lowest_largest.py'}:choose"
    where = ["--policy", policy, "--name", "lowest-largest", "--problems", "1"]
    where += [word for task in FEW for word in ("--task", task)]
    assert main(["benchmark", "run", str(file), *where, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)["entries"][0]["tasks"]
    assert set(said) == set(FEW)
    assert check(file).entry == "lowest-largest"
    assert main(["benchmark", "board", str(file)]) == 0
    assert "| lowest-largest | observation |" in capsys.readouterr().out


def test_a_policy_in_another_process_plays_as_one_here(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, str(OUTSIDERS / "server.py"), "0"], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        port = process.stdout.readline().split()[-1]
        remote = RemoteChoice(f"127.0.0.1:{port}")
        there = enter(remote, "server", tasks=FEW, problems=2)
        remote.close()
        assert process.wait(10) == 0

    def first(observation, info) -> int:
        mask = info.get("physics_mask", info["action_masks"])
        return int(np.flatnonzero(mask if mask.any() else info["action_masks"])[0])

    assert there == enter(first, "server", tasks=FEW, problems=2)


@pytest.mark.parametrize("answer", [b"nonsense\n", b"{}\n", b'{"action": "a"}\n', b"7\n", b""])
def test_an_answer_that_makes_no_sense_is_refused(answer: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def reply() -> None:
            connection, _ = server.accept()
            with connection, connection.makefile("rb") as lines:
                lines.readline()
                connection.sendall(answer)

        thread = threading.Thread(target=reply)
        thread.start()
        remote = RemoteChoice(f"127.0.0.1:{server.getsockname()[1]}")
        with pytest.raises(InputError, match="action"):
            enter(remote, "server", tasks=[SMALL], problems=1)
        remote.close()
        thread.join()


@pytest.mark.parametrize("address", ["10.0.0.1:80", "example.org:80", "127.0.0.1", "127.0.0.1:x"])
def test_only_this_machine_is_asked(address: str) -> None:
    with pytest.raises(InputError, match="this machine"):
        RemoteChoice(address)


@pytest.mark.parametrize(
    "words",
    [
        ["run", "out.jsonl.gz"],
        ["run", "out.jsonl.gz", "--policy", "randon"],
        ["run", "out.jsonl.gz", "--policy", "nowhere.py:x"],
        ["run", "out.jsonl.gz", "--policy", "json:nothing"],
        ["run", "out.jsonl.gz", "--policy", "random", "--task", "two-sided"],
        ["run", "out.jsonl.gz", "--policy", "random", "--name", "a|b"],
        ["run", "out.json", "--policy", "random"],
        ["run", "a.jsonl.gz", "b.jsonl.gz", "--policy", "random"],
        ["run", "out.jsonl.gz", "--server", "127.0.0.1:1"],
        ["run", "out.jsonl.gz", "--policy", "random:-1"],
        ["run", "out.jsonl.gz", "--policy", "exact-planner", "--task", SMALL],
        ["check", "nowhere.jsonl.gz"],
        ["board", "nowhere.jsonl.gz"],
        ["board", "nowhere.jsonl.gz", "--policy", "random"],
    ],
)
def test_a_wrong_call_is_one_line(
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["benchmark", *words]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_classes_are_made_and_other_names_called() -> None:
    assert isinstance(load_policy("learn2assemble.envs.policies:RandomChoice"), RandomChoice)
    assert load_policy("json:loads") is json.loads


def test_a_choice_that_is_no_number_is_refused() -> None:
    with pytest.raises(InputError, match="action of the policy"):
        enter(lambda observation, info: "a", "x", tasks=[SMALL], problems=1)  # pyright: ignore


def test_a_policy_that_never_ends_is_asked_no_more() -> None:
    """Goals end only when nothing is offered, and this always asks for what is not."""
    env = SuiteTask("goals-bridge").make()
    assert isinstance(env.action_space, gymnasium.spaces.Discrete)
    never = int(env.action_space.n) - 1
    assert len(SuiteTask("goals-bridge").play(env, 0, lambda *_: never).actions) == 2000


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, torch_as_before: None) -> Path:
    """The folder that scripts are run in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.skipif(importlib.util.find_spec("sb3_contrib") is None, reason="no sb3-contrib")
@pytest.mark.filterwarnings("default")
def test_another_library_enters(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In this process: its libraries take longer to load than it plays."""
    goals = ["goals-bridge", "goals-cantilever"]
    words = [
        ["ppo.jsonl.gz", "1", "two-sided-3x3-20-24=64"],
        ["goals.jsonl.gz", "1", *(f"{task}=64" for task in goals)],
    ]
    for given in words:
        monkeypatch.setattr(sys, "argv", ["maskable_ppo.py", *given])
        runpy.run_path(str(OUTSIDERS / "maskable_ppo.py"), run_name="__main__")
    assert len(check(here / "ppo.jsonl.gz").played) == 20
    assert [one.task for one in check(here / "goals.jsonl.gz").played] == goals


def test_a_learner_without_a_library_enters(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As long as it takes to learn some steps; two seeds are two runs."""
    words = ["dqn.jsonl.gz", "2", "goals-cantilever=1020"]
    monkeypatch.setattr(sys, "argv", ["dqn.py", *words])
    runpy.run_path(str(OUTSIDERS / "dqn.py"), run_name="__main__")
    assert {one.run for one in check(here / "dqn.jsonl.gz").played} == {0, 1}


# ---------------------------------------------------------------- pictures


PLACEMENTS, HIDDEN = "two-sided-3x3-20-24", "hidden-designs-20"
SEEN = f"{ROOT / 'examples' / 'benchmark' / 'from_pictures.py'}:Seen"


def make(name: str):
    return SuiteTask(name).make()


@pytest.mark.parametrize("name", [PLACEMENTS, "designs-cubes-60", HIDDEN])
@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version")
def test_gymnasium_accepts_pictures(name: str) -> None:
    how = {"actions": "placements"} if name == PLACEMENTS else {}
    env = PictureObservation(gymnasium.make(env_id(name), **how).unwrapped)
    check_env(env, skip_render_check=True)
    assert env.observation_space["picture"].dtype == np.uint8
    assert env.action_masks().any()


def test_an_elevation_shows_target_and_blocks() -> None:
    env = make(PLACEMENTS)
    _, info = env.reset(seed=3)
    pictures = pictures_of(env)
    before = pictures.observe()
    action = int(np.flatnonzero(info["physics_mask"])[0])
    env.step(action)
    after = pictures.observe()
    for side in range(2):
        panel = after["picture"][:, 100 * side : 100 * (side + 1)]
        mask, covered = (to_pixels(v[0, side]) for v in (env.state.mask, env.state.covered))
        assert ((panel[..., WANTED] > 0) == mask).all()
        assert ((panel[..., THERE] > 0) & mask == covered & mask).all()
    # What has appeared in an elevation lies in the box of the action.
    shown = False
    for side in range(2):
        top, left, bottom, right = before["boxes"][action, side].round().astype(int)
        new = (after["picture"] > before["picture"])[:, 100 * side : 100 * (side + 1), THERE]
        if bottom:
            inside = np.zeros_like(new)
            inside[top - 1 : bottom + 1, left - 100 * side - 1 : right - 100 * side + 1] = True
            assert new.any()
            assert not (new & ~inside).any()
            shown = True
    assert shown
    plan = after["picture"][:, 200:]
    waits = before["picture"][:, 200:, WAITING].sum() - plan[..., WAITING].sum()
    assert waits > 0
    assert not before["boxes"][~env.action_masks()].any() or env.action_masks().all()


def test_a_design_shows_its_cells_and_its_heap() -> None:
    env = make("designs-lintels-60-heap-held-out")
    assert isinstance(env, DesignEnv)
    env.reset(seed=1)
    pictures, size = pictures_of(env), env.task.extent
    cells = env.world.site.wanted
    picture = pictures.observe()["picture"]
    assert picture[..., THERE].sum() == 0
    plan = picture[: cells.shape[1], : cells.shape[0], WANTED]
    assert (plan == cells.sum(2).T * 255 // size).all()
    front = picture[size - cells.shape[2] :, size : size + cells.shape[0], WANTED]
    assert (front == cells.sum(1).T[::-1] * 255 // size).all()
    heap = picture[:, 3 * size :, WAITING] > 0
    height = size // len(env.world.heap)
    assert heap[::height][: len(env.world.heap)].sum(1).tolist() == env.world.heap.tolist()
    top, left, bottom, right = pictures.observe()["boxes"][0, 1].astype(int)
    env.step(0)
    after = pictures.observe()["picture"]
    new = np.argwhere(after[:, size : 2 * size, THERE] > 0) + np.array([0, size])
    assert new.min(0).tolist() == [top, left]
    assert (new.max(0) + 1).tolist() == [bottom, right]


def test_millimetres_show_where_errors_are_hidden() -> None:
    env = make(HIDDEN)
    assert isinstance(env, HiddenEnv)
    env.reset(seed=1)
    pictures, block = pictures_of(env), int(np.flatnonzero(env.action_masks())[0])
    place = pictures.observe()
    assert (place["picture"][..., WAITING] == place["picture"][..., WANTED]).all()
    for _ in range(4):
        env.step(env.actions.adjust + 1)
    env._world.place = lambda block, correction, placing: type(env._world).place(
        env._world, block, -env._world.numbers.bias, STILL
    )
    env.step(block)
    seen = pictures.observe()["picture"]
    assert (seen[..., WAITING] != place["picture"][..., WAITING]).any()
    plan = seen[:HIDDEN_SIZE, :HIDDEN_SIZE, THERE].astype(float) / 255
    x = (np.arange(HIDDEN_SIZE) + 0.5 - HIDDEN_SIZE / 2) * HIDDEN_PIXEL
    # Believed where the correction was: 2 mm along x.
    assert (plan.sum(0) @ x) / plan.sum() == pytest.approx(
        env.design.middle[block, 0] + 2e-3, abs=2e-4
    )
    assert place["boxes"][env.actions.look :].sum() == 0


def test_what_has_no_pictures_is_refused() -> None:
    with pytest.raises(InputError, match="pictures of"):
        PictureObservation(gymnasium.make(env_id("goals-bridge")))
    with pytest.raises(InputError, match="actions='placements'"):
        PictureObservation(gymnasium.make(env_id(PLACEMENTS)))

    def choose(observation, info) -> int:
        return 0

    choose.observations = "film"
    with pytest.raises(UnknownNameError, match="observations of the policy"):
        enter(choose, "x", tasks=[PLACEMENTS], problems=1)


def test_a_policy_enters_that_sees_pictures(tmp_path) -> None:
    """Its entry is actions, like any other, and is checked without pictures."""
    entry = enter(load_policy(SEEN), "seen", tasks=[PLACEMENTS, HIDDEN], problems=2)
    assert entry.knows == "observation"
    assert entry.scores(PLACEMENTS).mean() > 0.6
    entry.write(path := tmp_path / "seen.jsonl.gz")
    assert check(path) == entry


def test_the_example_is_a_class() -> None:
    spec = importlib.util.spec_from_file_location("seen", SEEN.rpartition(":")[0])
    assert spec is not None
    assert load_policy(SEEN).observations == "picture"
