"""The command line: help, JSON, exit codes, every command once, and calls that are refused."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import torch

from bad_calls import BAD, TASK, TINY_RUN, BadCall, prepare
from headless import Terminal
from learn2assemble import __version__
from learn2assemble.cli import main, output
from learn2assemble.cli.parser import COMMANDS, L2A, LABORATORY, CommandLine, make_parser
from learn2assemble.tasks.evaluation.episodes import search_config
from learn2assemble.tasks.networks.agent import Agent, agent_files, load_agent, save_agent
from learn2assemble.tasks.networks.config import NetworkConfig
from learn2assemble.tasks.networks.qnetwork import QNetwork
from learn2assemble.tasks.search.config import SEARCHES
from learn2assemble.tasks.task import PRESETS

torch.set_num_threads(1)

ROOT = Path(__file__).resolve().parents[1]
DESIGNS = ROOT / "examples" / "designs"


ARCH = ROOT / "examples" / "structures" / "arch.obj"


class Result(NamedTuple):
    code: int
    out: str
    err: str

    def json(self) -> dict[str, Any]:
        """The only line of standard output, as strict JSON."""
        assert self.out.endswith("\n")
        assert self.out.count("\n") == 1

        def refuse(word: str) -> None:
            raise AssertionError(f"{word} is not JSON")

        value = json.loads(self.out, parse_constant=refuse)
        assert isinstance(value, dict)
        return value


class Call:
    """Runs a program, ``l2a`` by default, in this process."""

    def __init__(self, capsys: pytest.CaptureFixture[str], program: CommandLine = L2A) -> None:
        self.capsys, self.program = capsys, program

    def __call__(self, *words: object) -> Result:
        self.capsys.readouterr()
        try:
            code: Any = main([str(word) for word in words], self.program)
        except SystemExit as leave:
            code = leave.code
        captured = self.capsys.readouterr()
        return Result(code, captured.out, captured.err)


@pytest.fixture
def l2a(capsys: pytest.CaptureFixture[str]) -> Call:
    return Call(capsys)


def subprocess_l2a(*words: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "learn2assemble", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def make_agent(folder: Path) -> Path:
    """Folder of a small agent that has learned nothing."""
    torch.manual_seed(0)
    config = NetworkConfig(width=16, heads=2, rounds=1, position_scale=0.1)
    save_agent(Agent("agent", QNetwork(config), TASK, {}), folder)
    return folder


def make_run(folder: Path) -> Path:
    """Folder of a finished, tiny training."""
    code = main(["train", TASK, "--out", str(folder), "--samples", "24", *TINY_RUN])
    assert code == 0
    return folder


@pytest.fixture(scope="session")
def agent(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_agent(tmp_path_factory.mktemp("agent"))


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_run(tmp_path_factory.mktemp("run") / "run")


@pytest.fixture(scope="session")
def report(tmp_path_factory: pytest.TempPathFactory, agent: Path) -> Path:
    """Folder of a finished build."""
    folder = tmp_path_factory.mktemp("build") / "tower"
    code = main(["build", str(DESIGNS / "stepped_tower.json"), "--out", str(folder)])
    assert code == 0
    return folder


def fingerprint(folder: Path) -> dict[str, str]:
    """Every path below ``folder`` with the hash of its content."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        if path.is_file()
        else "folder"
        for path in sorted(folder.rglob("*"))
    }


# Help and versions.


def help_of(call: Call, *command: str) -> str:
    """The help of a program or of a command, in one line."""
    result = call(*command, "--help")
    assert result.code == 0
    assert result.err == ""
    return " ".join(result.out.split())


def check_help(call: Call, command: str) -> None:
    """The help of a command shows an example, whose words are accepted; the files that it names are
    in the repository."""
    text, name = help_of(call, command), call.program.name
    assert f"example: {name} {command}" in text
    assert "--json" in text
    options = make_parser((), call.program).parse_args(text.split(f"example: {name} ")[1].split())
    for file in [getattr(options, "design", None), *getattr(options, "files", [])]:
        assert file is None or (ROOT / file).is_file()
    assert getattr(options, "task", TASK) in PRESETS


def test_the_help_names_every_command(l2a: Call) -> None:
    text = help_of(l2a)
    assert "example: l2a" in text
    for name in COMMANDS:
        assert name in text
    for name in LABORATORY:  # Those have a program of their own.
        assert f" {name} " not in text


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_an_example_that_can_be_parsed(l2a: Call, command: str) -> None:
    check_help(l2a, command)


def test_the_help_of_build_fits_a_page_and_the_documents_say_more(
    l2a: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = l2a("build", "--help").out.splitlines()
    assert len(lines) <= 55
    assert max(map(len, lines)) <= 80
    assert lines[0].endswith("(--out DIR | --preview PNG) DESIGN [options]")
    options = {word for line in lines for word in re.findall(r"(?<!\w)--[a-z-]+", line)} - {
        "--help"
    }
    page = (ROOT / "docs" / "commands.md").read_text("utf-8")
    table = page[page.index("## Options of l2a build") : page.index("## Tasks with an arm")]
    assert len(options) > 30
    assert {option for option in options if f"`{option}" not in table} == set()


def test_version(l2a: Call) -> None:
    assert l2a("--version") == (0, f"learn2assemble {__version__}\n", "")


# Every command once.


def test_tasks(l2a: Call) -> None:
    result = l2a("tasks", "--json")
    assert result.code == 0
    tasks = result.json()["tasks"]
    assert [task["name"] for task in tasks] == list(PRESETS)
    assert tasks[0]["blocks"] == [20, 24]
    assert {name for task in tasks for name in task["agents"]} == set(agent_files())
    human = l2a("tasks")
    assert human.code == 0
    for name in PRESETS:
        assert name in human.out


@pytest.mark.parametrize("columns", [20, 40, 80, 200])
def test_narrow_terminals_lose_nothing(
    columns: int, l2a: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    out = l2a("tasks").out
    assert "\u2026" not in out
    if columns > 20:
        assert max(map(len, out.splitlines())) <= columns
    told = "".join(out.split())
    for name in (*PRESETS, *agent_files()):
        assert name in told


@pytest.mark.parametrize("arm", [None, "panda"])
def test_resume_of_a_finished_build_is_complete(
    arm: str | None, l2a: Call, report: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "done"
    shutil.copytree(report, folder)
    plan = json.loads((folder / "plan.json").read_text("utf-8"))
    if arm:
        plan["arm"] = {"name": arm, "pitch": 0.05, "attempts": 5, "seconds": 9.0, "failures": []}
        (folder / "plan.json").write_text(json.dumps(plan), "utf-8")
    before = fingerprint(folder)
    words = ["build", DESIGNS / "stepped_tower.json", "--out", folder, "--resume"]
    done = l2a(*words, *(["--arm", arm] if arm else []))
    assert done.code == 0, done.err
    assert "complete already" in done.out
    assert fingerprint(folder) == before
    other = l2a(*words, "--arm", "ur5e")
    assert other.code == 2
    said = f"got 'a plan for {arm or 'no arm'}', expected the folder of a build by ur5e"
    assert said in other.err
    words[1] = DESIGNS / "pyramid.json"
    other = l2a(*words, *(["--arm", arm] if arm else []))
    assert other.code == 2
    assert "got 'a plan of stepped_tower.json', expected the folder of a build of pyr" in other.err
    words[1] = DESIGNS / "nonexistent.svg"
    assert "nonexistent.svg" in l2a(*words).err
    words[1] = DESIGNS / "stepped_tower.json"
    plan["status"] = "incomplete"
    (folder / "plan.json").write_text(json.dumps(plan), "utf-8")
    assert l2a(*words).code == 2


def test_a_terminal_is_never_left_in_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    """A line says what is going on, for how long, and what is left; a result takes it away."""
    shown = Terminal()
    monkeypatch.setattr(sys, "stderr", shown)
    monkeypatch.setattr(output, "QUIET", 0.0)
    beat = output.Heartbeat("working", 60.0)
    assert beat.words(beat.started + 12) == "l2a: working ... 12 s, at most 48 s left"
    assert beat.words(beat.started + 99).endswith("at most 0 s left")
    with beat:
        beat.clear("choosing blocks")
        while "choosing blocks ... " not in shown.getvalue():
            time.sleep(0.01)
        output.Output(False, beat).say("done")
        told = shown.getvalue()
        assert told.endswith("\r\x1b[K")
        time.sleep(0.7)
        assert shown.getvalue() == told
    # Nothing of it where nobody looks.
    plain = io.StringIO()
    monkeypatch.setattr(sys, "stderr", plain)
    with output.Heartbeat("working"):
        time.sleep(0.7)
    assert plain.getvalue() == ""


def test_missing_extras_are_named_together(
    l2a: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("av", "ruckig"):
        monkeypatch.setitem(sys.modules, module, None)
    words = ["build", DESIGNS / "stepped_tower.json", "--out", tmp_path / "out", "--arm", "panda"]
    for more, told in (
        ([], ("ruckig and av are not", "[robot,video]", "--physics kinematic --no-video")),
        (["--no-video"], ("ruckig is not", "[robot]", "without: --physics kinematic")),
        (["--physics", "kinematic"], ("av is not", "[video]", "without: --no-video")),
    ):
        result = l2a(*words, *more)
        assert result.code == 2
        assert result.err.count("\n") == 1
        for word in told:
            assert word in result.err
        assert not (tmp_path / "out").exists()


SEARCH = ["--search", "mcts", "--budget", "2", "--rollout", "end"]


def test_a_name_stands_for_its_search_and_arguments_take_the_place_of_its_own() -> None:
    for name in SEARCHES:
        config = search_config(name, epsilon=0.2, budget=None)
        assert config == dataclasses.replace(SEARCHES[name], epsilon=0.2)
    assert search_config("none", budget=None) is None
    assert search_config("mcts") == SEARCHES["dqn-mcts"]
    given = search_config("uct", budget=7, rollout=2, distinct=None)
    assert given == dataclasses.replace(SEARCHES["uct"], budget=7, rollout=2)


@pytest.mark.parametrize("search", [[], SEARCH, [*SEARCH, "--distinct"]], ids=len)
def test_eval(l2a: Call, agent: Path, tmp_path: Path, search: list[str]) -> None:
    """The file holds what is printed; the same seed gives the same numbers."""
    words = ["eval", TASK, "--agent", agent, "--episodes", "3", "--seed", "4", *search]
    first = l2a(*words, "--out", tmp_path / "result.json", "--json")
    assert first.code == 0
    result = first.json()
    assert result == json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))
    assert result["episodes"] == 3
    assert result["budget"] == (2 if search else 0)
    assert result["rollout"] == (10_000 if search else 0)
    assert result["distinct"] == ("--distinct" in search)
    assert result["legacy"] is False
    assert result["physics"] == "static"
    again = l2a(*words, "--json").json()
    for name in ("R", "a", "f", "b", "success", "coverage"):
        assert result[name] == again[name]
    human = l2a(*words)
    assert human.code == 0
    assert "coverage" in human.out


def test_train_and_resume(l2a: Call, tmp_path: Path) -> None:
    words = ["train", TASK, "--out", tmp_path / "run", "--seed", "3"]
    first = l2a(*words, "--samples", "300", *TINY_RUN, "--json")
    assert first.code == 0
    result = first.json()
    assert result["task"] == TASK
    assert result["samples"] == 300
    assert result["updates"] > 0
    saved = json.loads((tmp_path / "run" / "config.json").read_text(encoding="utf-8"))
    assert saved["seed"] == 3
    assert saved["config"]["network"]["width"] == 16
    loaded = load_agent(str(tmp_path / "run"))
    assert loaded.task == TASK
    assert loaded.origin["samples"] == 300
    assert loaded.origin["seed"] == 3
    # A second training that starts from the first, and says so.
    words[3] = tmp_path / "second"
    second = l2a(*words, "--samples", "4", *TINY_RUN, "--init", tmp_path / "run")
    assert second.code == 0
    origin = load_agent(str(tmp_path / "second")).origin
    assert origin["init"]["origin"]["samples"] == 300
    words[3] = tmp_path / "run"
    # Nothing is left to do, and nothing is lost.
    again = l2a(*words[:4], "--resume", "--device", "cpu", "--json")
    assert again.code == 0
    assert again.json()["samples"] == 300


def test_json_of_a_very_short_training(l2a: Call, tmp_path: Path) -> None:
    """Standard output and the log stay valid JSON when there is nothing to average."""
    words = ["train", TASK, "--out", tmp_path / "run", "--samples", "1", *TINY_RUN]
    result = l2a(*words, "--set", "num_envs=1", "--json")
    assert result.code == 0
    result.json()
    assert "NaN" not in (tmp_path / "run" / "log.jsonl").read_text(encoding="utf-8")


def test_bench(l2a: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    """Measurements are replaced, so that this test does not depend on the machine."""
    from learn2assemble import benchmark as bench

    measured = {"slow_s": lambda seconds: 9.0, "fast_things_per_s": lambda seconds: 2 * seconds}
    monkeypatch.setattr(bench, "MEASUREMENTS", measured)
    result = l2a("bench", "--seconds", "1.5", "--json")
    assert result.code == 0
    assert (result.json()["fast_things_per_s"], result.json()["slow_s"]) == (3.0, 9.0)
    assert result.err.startswith("l2a: measuring slow_s\n")
    result = l2a("bench", "fast_things_per_s", "--seconds", "1.5", "--json")
    assert result.json()["fast_things_per_s"] == 3.0
    assert "slow_s" not in result.json()


FILES = {
    "plan": "plan.json",
    "assembly": "assembly.json",
    "bill": "bill.csv",
    "cards": "cards.html",
    "page": "view.html",
    "picture": "progress.png",
}


def test_check_takes_meshes_that_point_up_another_way(l2a: Call, tmp_path: Path) -> None:
    """Of the arch with y up, what is told of the one with z up."""
    lines = list[str]()
    for line in ARCH.read_text().splitlines():
        kind, *rest = line.split()
        if kind == "v":
            x, y, z = rest
            line = f"v {x} {z} {y[1:] if y.startswith('-') else f'-{y}'}"
        lines.append(line)
    turned = tmp_path / "arch.obj"
    turned.write_text("\n".join(lines))
    usual = ["--unit", "mm", "--friction", "0.6", "--json"]
    upright = l2a("check", ARCH, *usual).json()
    same = l2a("check", turned, "--up", "y", *usual).json()
    assert upright["verdict"] == same["verdict"] == "stands"
    assert same["margin_g"] == pytest.approx(upright["margin_g"], abs=1e-3)
    assert l2a("check", turned, *usual).code != 0


def test_build(l2a: Call, tmp_path: Path) -> None:
    """A complete plan: exit code 0, its files, one JSON object that agrees with them."""
    out = tmp_path / "deep" / "tower"
    result = l2a("build", DESIGNS / "stepped_tower.json", "--out", out, "--json")
    assert result.code == 0
    summary = result.json()
    plan = json.loads((out / "plan.json").read_text(encoding="utf-8"))
    assert summary["status"] == plan["status"] == "complete"
    assert summary["steps"] == len(plan["steps"])
    assert summary["files"] == {name: str(out / file) for name, file in FILES.items()}
    assert {path.name for path in out.iterdir()} == set(FILES.values())
    assert any(line.startswith("l2a: ") for line in result.err.splitlines())


def test_build_of_a_task(l2a: Call, agent: Path, tmp_path: Path) -> None:
    words = ["build", TASK, "--seed", "2", "--agent", agent, "--seconds", "5"]
    result = l2a(*words, "--out", tmp_path / "out")
    plan = json.loads((tmp_path / "out" / "plan.json").read_text(encoding="utf-8"))
    assert result.code == (0 if plan["status"] == "complete" else 1)
    assert "view.html" in result.out
    assert "more than 97.5% is needed" in result.out


def test_build_of_what_cannot_be_built_exits_with_1(l2a: Call, tmp_path: Path) -> None:
    words = ["build", DESIGNS / "cannot_be_built.json", "--kit", "cubes", "--no-props", "--json"]
    result = l2a(*words, "--out", tmp_path / "out")
    assert result.code == 1
    assert result.json()["status"] in ("refused", "incomplete")
    assert result.json()["reason"]


@pytest.mark.skipif(not agent_files(), reason="no agent is shipped")
def test_build_with_the_shipped_agent(l2a: Call, tmp_path: Path) -> None:
    result = l2a("build", "two-sided-3x3-20-24", "--json", "--out", tmp_path / "out")
    assert result.code == 0
    assert result.json()["agent"] in agent_files()


@pytest.mark.skipif(not agent_files(), reason="no agent is shipped")
def test_eval_with_the_shipped_agent(l2a: Call) -> None:
    result = l2a("eval", TASK, "--episodes", "2", "--json")
    assert result.code == 0
    assert result.json()["agent"] in agent_files()


@pytest.mark.skipif(bool(agent_files()), reason="an agent is shipped")
def test_without_a_shipped_agent_the_message_says_so(l2a: Call) -> None:
    result = l2a("eval", TASK, "--episodes", "2")
    assert result.code == 2
    assert "none is shipped" in result.err


@pytest.mark.parametrize("by_folder", [True, False])
def test_view(
    l2a: Call, report: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, by_folder: bool
) -> None:
    """Serves the page beside the plan; writes it where it is missing, keeps it where it is not."""
    served: list[tuple[Path, int, bool]] = []

    def serve(page: Path, port: int, open_browser: bool, tell: Any) -> str:
        served.append((page, port, open_browser))
        tell("http://127.0.0.1:1/view.html")
        return ""

    monkeypatch.setattr("learn2assemble.viewer.server.serve", serve)
    for name in ("plan.json", "assembly.json"):
        shutil.copy(report / name, tmp_path / name)
    plan = tmp_path if by_folder else tmp_path / "plan.json"
    result = l2a("view", plan, "--port", "8123", "--no-browser", "--json")
    page = tmp_path / "view.html"
    assert result.code == 0
    assert result.json() == {"url": "http://127.0.0.1:1/view.html", "page": str(page)}
    assert served == [(page, 8123, False)]
    assert page.is_file()
    page.write_text("mine")
    assert l2a("view", plan).code == 0
    assert page.read_text() == "mine"
    assert served[-1] == (page, 0, True)


def test_view_says_when_the_port_is_taken(l2a: Call, report: Path) -> None:
    import socket

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        result = l2a("view", report, "--no-browser", "--port", taken.getsockname()[1])
    assert result.code == 2
    assert "a free port" in result.err
    assert result.err.count("\n") == 1


# Leaving.


def replace_command(monkeypatch: pytest.MonkeyPatch, run: Any) -> None:
    """Make ``l2a tasks`` do something else."""
    command = dataclasses.replace(COMMANDS["tasks"], run=run)
    monkeypatch.setitem(COMMANDS._entries, "tasks", command)


def test_interrupt_exits_with_130(l2a: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: Any) -> int:
        raise KeyboardInterrupt

    replace_command(monkeypatch, stop)
    assert l2a("tasks") == (130, "", "l2a: interrupted\n")


def test_errors_of_the_program_are_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only what a user can cause becomes one line; a fault of ours keeps its traceback."""

    def fail(*_: Any) -> int:
        raise AssertionError("a fault")

    replace_command(monkeypatch, fail)
    with pytest.raises(AssertionError, match="a fault"):
        main(["tasks"])


def test_module_is_the_command() -> None:
    good = subprocess_l2a("tasks", "--json")
    assert good.returncode == 0
    assert len(json.loads(good.stdout)["tasks"]) == len(PRESETS)
    assert good.stdout.count("\n") == 1
    bad = subprocess_l2a("trian")
    assert bad.returncode == 2
    assert bad.stdout == ""
    assert "did you mean 'train'" in bad.stderr
    assert bad.stderr.count("\n") == 1


def test_incomplete_build_exits_with_1_in_a_process_of_its_own(tmp_path: Path) -> None:
    words = ["build", DESIGNS / "cannot_be_built.json", "--kit", "cubes", "--no-props", "--json"]
    done = subprocess_l2a(*words, "--out", tmp_path / "out")
    assert done.returncode == 1
    assert json.loads(done.stdout)["reason"]


def test_a_reader_that_leaves_is_no_error() -> None:
    """``l2a tasks | head -0``"""
    command = [sys.executable, "-m", "learn2assemble", "tasks", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        errors = process.stderr.read().decode()
    assert process.returncode == 0
    assert "Traceback" not in errors
    assert "BrokenPipe" not in errors


# Calls that are refused.


def test_list_of_bad_calls_covers_every_command() -> None:
    assert len({call.name for call in BAD}) == len(BAD) >= 40
    assert {call.words[0] for call in BAD if call.words} >= {*COMMANDS}


def make_stage(folder: Path, agent: Path, run: Path) -> Path:
    """The folder bad calls name; a test that changes it fails."""
    log = Path(__file__).parent / "data" / "transitions_sample.jsonl"
    prepare(folder, agent, run, DESIGNS / "stepped_tower.json", log)
    return folder


@pytest.fixture(scope="session")
def stage(tmp_path_factory: pytest.TempPathFactory, agent: Path, run: Path) -> Path:
    return make_stage(tmp_path_factory.mktemp("stage"), agent, run)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["buld", "gate.svg"], "l2a: error: command: got 'buld', did you mean 'build'?"),
        (["xyzzy"], "l2a: error: command: got 'xyzzy', which there is not"),
    ],
)
def test_a_command_that_there_is_not_is_told_in_a_line(
    words: list[str], said: str, l2a: Call
) -> None:
    (line,) = l2a(*words).err.splitlines()
    assert said in line
    assert len(line) < 160


@pytest.mark.parametrize("call", [pytest.param(call, id=call.name) for call in BAD])
def test_bad_call(call: BadCall, l2a: Call, stage: Path) -> None:
    check_refused(call, l2a, stage)


def check_refused(call: BadCall, program: Call, stage: Path) -> None:
    """Exit code 2, one line on standard error that says what is wrong, nothing written."""
    before = fingerprint(stage)
    result = program(*[word.replace("{d}", str(stage)) for word in call.words])
    assert result.code == 2
    assert result.out == ""
    lines = [
        line
        for line in result.err.splitlines()
        if not line.startswith("l2a: ") or line.startswith("l2a: error")
    ]
    assert len(lines) == 1, lines
    assert "error: " in lines[0]
    assert "Traceback" not in lines[0]
    assert call.fragment in lines[0]
    assert len(lines[0]) < 600
    assert fingerprint(stage) == before


def test_good_twins_of_the_bad_calls_are_accepted(l2a: Call, stage: Path, tmp_path: Path) -> None:
    """What the bad calls start from works, so each is refused for its own reason."""
    from bad_calls import build, evaluate, resume, train

    folder = tmp_path / "stage"
    shutil.copytree(stage, folder, ignore=shutil.ignore_patterns("special", "linked"))
    for words in (build("--out", str(folder / "built")), train(), evaluate(), resume("{d}/run")):
        assert l2a(*[word.replace("{d}", str(folder)) for word in words]).code == 0, words


@pytest.mark.skipif(not hasattr(signal, "SIGINT") or os.name == "nt", reason="needs POSIX signals")
@pytest.mark.parametrize("wait", [0.0, 0.2, 1.0])
def test_an_interrupt_ends_with_130_and_no_traceback(wait: float, tmp_path: Path) -> None:
    """From the moment the program runs: while libraries load, and later."""
    code = (
        "import sys; sys.argv = ['l2a', *sys.argv[1:]]\n"
        "from learn2assemble.__main__ import run\n"
        "import signal, threading\n"
        "real = signal.signal\n"
        "def ready(*words):\n"
        "    found = real(*words); print('ready', flush=True); return found\n"
        "signal.signal = ready\n"
        "sys.exit(run())"
    )
    words = ["train", "two-sided-3x3-20-24", "--out", str(tmp_path / "out"), "--minutes", "5"]
    with subprocess.Popen(
        [sys.executable, "-c", code, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        time.sleep(wait)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert err.rstrip().endswith("l2a: interrupted")


@pytest.mark.parametrize(
    "words",
    [
        ["eval", TASK, "--episodes", "1", "--out", "mine.svg"],
        ["benchmark", "run", "mine.jsonl.gz", "--policy", "random"],
        ["train", TASK, "--out", "full"],
    ],
)
def test_commands_refuse_what_is_there(
    words: list[str], l2a: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("full").mkdir()
    for name in ("mine.svg", "mine.jsonl.gz", "full/notes.txt"):
        Path(name).write_text("mine")
    before = fingerprint(tmp_path)
    code, _, told = l2a(*words)
    assert code == 2
    assert told.count("\n") == 1
    assert "new" in told
    assert fingerprint(tmp_path) == before
