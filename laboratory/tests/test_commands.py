"""The commands of ``l2a-lab``: help, bad calls, files that are there, and what documents say;
what commands of ``l2a`` and the site take from the laboratory.

What is asked of every command of ``l2a`` is asked of these, by the same checks.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import learn2assemble as l2a
from bad_calls import LONG, TASK, BadCall, build
from l2a_lab.__main__ import command_line
from learn2assemble.cli import main
from learn2assemble.cli.parser import COMMANDS, L2A, LABORATORY
from learn2assemble.errors import InputError, MissingExtraError
from test_cli import Call, check_help, check_refused, make_agent, make_run, make_stage
from test_docs import (
    PAGES,
    check_accepted,
    check_runs,
    commands_of,
    commands_that_run,
    hook,
    set_up_folder,
)
from test_files import MINE, check_explosive, commands_that_write, contents
from test_product import check_extra_is_named, without_extra
from test_product import check_help as check_help_without_extra

ROOT = Path(__file__).parents[2]
LAB = command_line()
LEARNS = {
    "curves": ["algorithms"],
    "keep": ["run"],
    "fidelities": ["robot-two-sided-3x3-10-14"],
    "measure-builder": ["--out", "new"],
    "measure-builder-arm": ["--out", "new"],
    "measure-builds": [],
    "measure-designs": [],
    "measure-goals": [],
    "measure-hidden": [],
    "measure-sensing": [],
    "measure-speed": [],
    "measure-structures": [],
    "measure-two-arms": [],
    "replay": ["transitions.jsonl"],
    "table": ["T1"],
    "train-builder": ["--out", "new"],
    "workbenchmark": ["--tasks", "tasks.jsonl.gz"],
}
"""Commands that need the extra, with what they cannot do without."""


def table(*words: str) -> list[str]:
    """A table from no files at all; nothing is measured."""
    return [
        "table",
        *words,
        *([] if "--agents" in words or "--train" in words else ["--from-files"]),
        *([] if "--out" in words else ["--out", "{d}/new"]),
    ]


def keep(folder: str) -> list[str]:
    return ["keep", folder, "--runs", "{d}/new/runs.jsonl.gz", "--agents", "{d}/new"]


def curves(name: str, *words: str) -> list[str]:
    return ["curves", name, "--runs", "{d}/nosuch", "--out", "{d}/new", *words]


BAD = [
    BadCall(
        "measured builds through a link",
        ["measure-builds", "--out", "{d}/special/link"],
        "not a symbolic link",
    ),
    BadCall("table into a link", table("T1", "--out", "{d}/special/linked"), "not a symbolic link"),
    BadCall("fidelities of a task without an arm", ["fidelities", TASK], "tasks with an arm"),
    BadCall(
        "fidelities into a file that is there",
        ["fidelities", "robot-two-sided-3x3-10-14", "--out", "{d}/file.txt"],
        "a new file",
    ),
    BadCall(
        "fidelities with an unknown arm",
        ["fidelities", "robot-two-sided-3x3-10-14", "--arm", "kuka"],
        "arm",
    ),
    BadCall("no table", ["table"], "NAME"),
    BadCall("unknown table", table("T22"), "did you mean 'T2'"),
    BadCall("misspelt table", table("shiped"), "did you mean 'shipped'"),
    BadCall("table of no episodes", table("T1", "--episodes", "0"), "a whole number from 1"),
    BadCall("table by no worker", table("T1", "--workers", "0"), "a whole number from 1"),
    BadCall("table into a file", ["table", "T1", "--out", "{d}/file.txt"], "a writable folder"),
    BadCall("table of missing agents", table("T1", "--agents", "{d}/nosuch"), "no such file"),
    BadCall("table trained and not", table("T1", "--train", "--from-files"), "not allowed with"),
    BadCall(
        "table into another page",
        table("T1", "--out", "{d}/special/page"),
        "a page of this command",
    ),
    BadCall(
        "table into other figures",
        table("T1", "--out", "{d}/special/figures"),
        "figures of this command",
    ),
    BadCall("no curves", ["curves"], "NAME"),
    BadCall("misspelt curves", curves("algoritms"), "did you mean 'algorithms'"),
    BadCall(
        "curves of no runs",
        curves("algorithms", "--runs", "{d}/runs.jsonl.gz"),
        "such as dqn-paper-s0",
    ),
    BadCall("curves of missing runs", curves("algorithms"), "file of runs"),
    BadCall("curves of a folder", curves("algorithms", "--runs", "{d}/full"), "runs.jsonl.gz"),
    BadCall(
        "curves of what is not packed",
        curves("algorithms", "--runs", "{d}/not_gzip.jsonl.gz"),
        "a file of runs",
    ),
    BadCall(
        "curves of other lines",
        curves("algorithms", "--runs", "{d}/other_lines.jsonl.gz"),
        "config and log of a training",
    ),
    BadCall("keep nothing", ["keep"], "FOLDER"),
    BadCall("keep no run", keep("{d}/full"), "no such file"),
    BadCall("keep a missing run", keep("{d}/nosuch"), "no such file"),
    BadCall("keep a damaged run", keep("{d}/bad_config"), "config.json: line 1"),
    BadCall("replay nothing", ["replay"], "FILE"),
    BadCall("replay a missing file", ["replay", "{d}/nosuch.jsonl"], "no such file"),
    BadCall("replay a folder", ["replay", "{d}/full"], "not a plain file"),
    BadCall("replay what is not JSON", ["replay", "{d}/not_json.jsonl"], "line 1"),
    BadCall("replay a list", ["replay", "{d}/list.jsonl"], "a JSON object"),
    BadCall("replay another robot's log", ["replay", "{d}/robot.jsonl"], "3robo"),
    BadCall("replay what is not packed", ["replay", "{d}/not_gzip.jsonl.gz"], "line 1"),
    BadCall(
        "replay a good and a bad file",
        ["replay", "{d}/log.jsonl", "{d}/list.jsonl"],
        "list.jsonl line 1",
    ),
    BadCall("replay an empty file", ["replay", "{d}/empty.jsonl"], "empty.jsonl"),
    BadCall("replay a damaged archive", ["replay", "{d}/damaged.jsonl.gz"], "damaged.jsonl.gz"),
    BadCall("replay a long name", ["replay", LONG], "no such file"),
    BadCall(
        "builder of another teacher",
        ["train-builder", "--out", "{d}/another", "--teacher", "paper"],
        "exact",
    ),
    BadCall(
        "builder with the name of a folder",
        ["train-builder", "--out", "{d}/another", "--name", "../up"],
        "without a folder",
    ),
    BadCall(
        "builds that were not measured go on",
        ["measure-builder-arm", "--out", "{d}/new", "--resume"],
        "expected a measurement",
    ),
    BadCall(
        "builder there is not",
        ["measure-builder", "--out", "{d}/new", "--agent", "nobody"],
        "builder",
    ),
    BadCall(
        "measured builds into another file",
        ["measure-builds", "--out", "{d}/design.json"],
        "a new file",
    ),
    BadCall(
        "measured builds there are not",
        ["measure-builds", "--out", "{d}/new.json", "--only", "nosuch"],
        "--only",
    ),
    BadCall(
        "measured goals into another file",
        ["measure-goals", "--out", "{d}/design.json"],
        "a new file",
    ),
    BadCall(
        "measured goals there are not",
        ["measure-goals", "--out", "{d}/new.json", "--only", "nosuch"],
        "--only",
    ),
    BadCall(
        "a builder into a folder with something in it",
        ["train-builder", "--out", "{d}/run"],
        "new or empty folder",
    ),
    BadCall(
        "figures of cameras that are not there",
        ["measure-sensing", "--out", "{d}/new.json", "--only", "nosuch"],
        "part of the name",
    ),
    BadCall(
        "figures of given blocks over a design",
        ["measure-structures", "--out", "{d}/design.json"],
        "a new file, or a result of this command",
    ),
    BadCall(
        "figures of given blocks that are not there",
        ["measure-structures", "--out", "{d}/new.json", "--only", "nosuch"],
        "part of the name",
    ),
    BadCall(
        "figures of speed over a design",
        ["measure-speed", "--out", "{d}/design.json"],
        "a new file, or a result of this command",
    ),
    BadCall(
        "figures of two arms over a design",
        ["measure-two-arms", "--out", "{d}/design.json"],
        "a new file, or a result of this command",
    ),
    BadCall(
        "figures of two arms that are not there",
        ["measure-two-arms", "--out", "{d}/new.json", "--only", "nosuch"],
        "part of the name",
    ),
    BadCall(
        "figures of hidden errors over a design",
        ["measure-hidden", "--out", "{d}/design.json"],
        "a new file, or a result of this command",
    ),
    BadCall(
        "figures of hidden errors that are not there",
        ["measure-hidden", "--out", "{d}/new.json", "--only", "nosuch"],
        "part of the name",
    ),
    BadCall(
        "measured designs into another file",
        ["measure-designs", "--out", "{d}/design.json"],
        "a new file",
    ),
    BadCall(
        "measured designs there are not",
        ["measure-designs", "--out", "{d}/new.json", "--only", "nosuch"],
        "--only",
    ),
    BadCall(
        "a builder that is misspelt",
        ["measure-builder", "--out", "{d}/new", "--agent", "bilder-s0"],
        "did you mean 'builder-s0'",
    ),
    *(
        BadCall(
            f"tasks: {name}",
            ["workbenchmark", "--tasks", f"{{d}}/bricks/{name}.jsonl", "--out", "{d}/new"],
            fragment,
        )
        for name, fragment in {
            "words": "expected JSON",
            "empty": "got '0 lines'",
            "short": "the key 'initial_blocks'",
            "none": "no such file",
        }.items()
    ),
    *(
        BadCall(f"an empty name for {words[0]} {words[-2]}", words, "the name of a file or folder")
        for words in (
            ["replay", ""],
            ["table", "T1", "--from-files", "--out", ""],
            ["curves", "algorithms", "--runs", ""],
            ["measure-goals", "--out", ""],
        )
    ),
    *(
        BadCall(f"a misspelt {what}", words, f"no such file', expected a {what}")
        for what, words in {
            "recording": ["replay", "{d}/lgo.jsonl"],
            "file of runs": curves("algorithms", "--runs", "{d}/rusn.jsonl.gz"),
            "folder of agents": table("T1", "--agents", "{d}/agnet"),
            "folder of examples": ["measure-builder", "--out", "{d}/new", "--examples", "{d}/rnu"],
        }.items()
    ),
]


BAD_BUILDS = [
    BadCall("missing design", ["build", "{d}/nosuch.json", *build()[2:]], "nosuch.json"),
    BadCall(
        "misspelt preset",
        ["build", "two-sided-3x3-20-25", *build()[2:]],
        "did you mean 'two-sided-3x3-20-24'",
    ),
    BadCall("a folder as design", ["build", "{d}/full", *build()[2:]], "full"),
    BadCall(
        "a path below a file as design", ["build", "{d}/file.txt/a.json", *build()[2:]], "a.json"
    ),
    BadCall(
        "agent of the paper for a design",
        ["build", "{d}/design.json", *build()[2:]],
        "a builder of designs",
    ),
    BadCall("a long name as design", ["build", LONG, *build()[2:]], "File name too long"),
    BadCall("a design without its ending", ["build", "{d}/design", *build()[2:]], "/design.json'?"),
    BadCall(
        "a misspelt file of a builder",
        ["build", "{d}/design.json", "--out", "{d}/new", "--agent", "{d}/agent/agnet.safetensors"],
        "no such file', expected a file of a builder",
    ),
]
"""Calls of ``l2a build`` with an agent that is none, which the builder of designs refuses."""


@pytest.fixture
def lab(capsys: pytest.CaptureFixture[str]) -> Call:
    return Call(capsys, LAB)


# ---------------------------------------------------------------- help


@pytest.mark.parametrize("command", LABORATORY)
def test_help_shows_an_example_that_can_be_parsed(lab: Call, command: str) -> None:
    check_help(lab, command)


def test_commands_of_the_laboratory_are_not_those_of_the_product(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Who asks the one program for a command of the other is told where it is."""
    assert not set(COMMANDS) & set(LABORATORY)
    with pytest.raises(SystemExit):
        main(["table", "T2"])
    (line,) = capsys.readouterr().err.splitlines()
    assert "l2a-lab table, or python -m l2a_lab table" in line
    assert len(line) < 160


# ---------------------------------------------------------------- calls that are refused


def test_list_of_bad_calls_covers_every_command() -> None:
    assert len({call.name for call in BAD}) == len(BAD)
    assert {call.words[0] for call in BAD} == {*LABORATORY}


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    agent = make_agent(tmp_path_factory.mktemp("agent"))
    run = make_run(tmp_path_factory.mktemp("run") / "run")
    return make_stage(tmp_path_factory.mktemp("stage"), agent, run)


@pytest.mark.parametrize("call", [pytest.param(call, id=call.name) for call in BAD])
def test_bad_call(call: BadCall, lab: Call, stage: Path) -> None:
    check_refused(call, lab, stage)


@pytest.mark.parametrize("call", [pytest.param(call, id=call.name) for call in BAD_BUILDS])
def test_bad_build(call: BadCall, stage: Path, capsys: pytest.CaptureFixture[str]) -> None:
    check_refused(call, Call(capsys), stage)


# ---------------------------------------------------------------- without the extra


@pytest.mark.parametrize("command", LEARNS)
def test_what_learns_names_the_extra(
    command: str,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    without_extra(monkeypatch, tmp_path)
    check_extra_is_named([command, *LEARNS[command]], LAB, tmp_path, capsys)


def test_the_list_of_what_learns_is_complete() -> None:
    assert {name for name, command in LABORATORY.items() if command.learns} == set(LEARNS)


def test_the_help_needs_no_extra(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    without_extra(monkeypatch, tmp_path)
    check_help_without_extra(LAB, capsys)


# ---------------------------------------------------------------- files


WRITES = {
    "curves": "own",
    "fidelities": "file",
    "table": "own",
    "workbenchmark": "own",
    **dict.fromkeys(("measure-builder", "measure-builder-arm", "train-builder"), "folder"),
    **{
        f"measure-{what}": "own"
        for what in (
            *("builds", "designs", "goals", "hidden", "sensing", "speed", "structures"),
            "two-arms",
        )
    },
}
"""What commands write by a name that they are given, as in ``test_files.py``."""


def test_every_command_that_writes_is_known() -> None:
    """A new one needs an answer to what it does with files that are there."""
    assert commands_that_write(LAB) == set(WRITES)


def test_a_recording_that_explodes_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    check_explosive(["replay"], [], LAB, tmp_path / "a.jsonl", capsys)


@pytest.mark.parametrize(
    "words",
    [
        ["fidelities", "robot-two-sided-3x3-10-14", "--out", "victim.svg"],
        ["measure-speed", "--out", "victim.svg"],
        ["workbenchmark", "--tasks", "victim.svg", "--out", "victim.svg"],
        [
            "curves",
            "architectures",
            "--out",
            "pictures",
            "--runs",
            str(ROOT / "results/runs.jsonl.gz"),
        ],
    ],
)
def test_commands_of_the_laboratory_refuse_what_is_there(
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("victim.svg").write_text(MINE)
    Path("pictures").mkdir()
    Path("pictures/architectures.png").write_text(MINE)
    before = contents(tmp_path)
    assert main(words, LAB) == 2
    assert "l2a-lab: error: " in capsys.readouterr().err
    assert contents(tmp_path) == before


# ---------------------------------------------------------------- documents


def test_commands_of_the_laboratory_are_those_of_its_own_program() -> None:
    """Everywhere in the documents, in their sentences, too."""
    names = set(LAB.commands)
    assert names
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert not names & set(re.findall(r"\bl2a ([a-z][a-z-]*)", text)), page.name
        assert set(re.findall(r"\bl2a-lab ([a-z][a-z-]*)", text)) <= names, page.name


@pytest.mark.parametrize(("page", "words"), commands_of(LAB), ids=lambda value: str(value)[:60])
def test_a_command_of_a_document_is_accepted(page: str, words: list[str]) -> None:
    check_accepted(page, words, LAB)


GROUPS = {
    pages: told
    for pages, told in commands_that_run().items()
    if LAB.name in {name for name, _ in told}
}


@pytest.mark.slow
@pytest.mark.parametrize("pages", GROUPS)
def test_the_commands_of_the_documents_run(
    pages: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Those of the product among them, as one uses what the ones before have written."""
    set_up_folder(tmp_path, monkeypatch)
    for name, words in GROUPS[pages]:
        check_runs(words, LAB if name == LAB.name else L2A, capsys)


# ---------------------------------------------------------------- the builder of designs


GATE = str(ROOT / "examples" / "designs" / "gate.svg")
BUILDER = (["--planner", "agent"], ["--agent", "builder-s0"])
"""Options of ``l2a build`` that ask for it."""


@pytest.mark.parametrize("options", BUILDER)
def test_a_build_by_it_names_the_extra(
    options: list[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    without_extra(monkeypatch, tmp_path)
    check_extra_is_named(["build", GATE, *options, "--out", "new"], L2A, tmp_path, capsys)
    with pytest.raises(MissingExtraError, match=r"learn2assemble\[learn\]"):
        l2a.build(GATE, **{options[0].removeprefix("--"): options[1]})  # pyright: ignore


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--planner", "auto"], "got 'auto', expected one of agent, exact"),
        (["--planner", "agent", "--agent", "builder-x"], "a builder of designs"),
    ],
)
def test_a_build_by_another_is_refused(
    options: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = Call(capsys)("build", GATE, *options, "--out", tmp_path / "out")
    assert result.code == 2
    (line,) = (line for line in result.err.splitlines() if "error:" in line)
    assert told in line
    assert not (tmp_path / "out").exists()


def test_a_builder_is_asked_for_by_its_name() -> None:
    plan = l2a.build(ROOT / "examples" / "designs" / "pyramid.json", agent="builder-s0")
    assert (plan.planner, plan.agent) == ("agent", "builder-s0")


@pytest.mark.parametrize("design", ["stepped_tower.json", "h.svg"])
def test_build_with_the_shipped_builder(
    design: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["build", ROOT / "examples" / "designs" / design, "--planner", "agent", "--json"]
    result = Call(capsys)(*words, "--out", tmp_path / "out")
    told = result.json()
    assert result.code == 0
    assert (told["planner"], told["agent"]) == ("agent", "builder-s0")
    assert told["cells_missing"] == told["cells_outside"] == told["props"] == 0


def test_replay(lab: Call, data: Path) -> None:
    result = lab("replay", data / "transitions_sample.jsonl", "--json")
    assert result.code == 0
    (file,) = result.json()["files"]
    assert file["mask_exact"] == 1.0
    assert file["lines"] > 0
    assert result.err.startswith("l2a: replaying transitions_sample.jsonl\n")


def test_eval_with_the_restore_faults(stage: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = Call(capsys)(
        "eval",
        TASK,
        "--agent",
        stage / "agent",
        "--episodes",
        "2",
        "--search",
        "eps-mcts",
        "--budget",
        "3",
        "--legacy",
        "--json",
    )
    assert result.code == 0
    summary = result.json()
    assert summary["search"] == "eps-mcts"
    assert summary["legacy"] is True


def test_an_agent_of_the_paper_does_not_build_drawings() -> None:
    with pytest.raises(InputError, match=r"relational-cubes-s0.*a builder of designs"):
        l2a.build(ROOT / "examples/designs/pyramid.json", agent="relational-cubes-s0")


def test_the_builder_of_designs_builds_no_goals() -> None:
    goals = ROOT / "examples" / "goals" / "over_the_water.json"
    asked: tuple[dict[str, Any], ...] = {"planner": "agent"}, {"agent": "builder-s0"}
    for given in asked:
        with pytest.raises(InputError, match="expected exact, for goals"):
            l2a.build(goals, **given)


# ---------------------------------------------------------------- the site


def test_every_page_has_its_picture() -> None:
    """Every page of the site begins with one, below its title; the hook knows what it names."""
    drawings, gallery = hook("drawings"), hook("gallery")
    site = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").split("\nnav:\n")[1]
    pages = re.findall(r"[\w/]+\.md", site)
    assert len(pages) == len(set(pages)) > 25
    assert set(pages) - {"index.md"} == set(drawings.PAGES)
    built = tomllib.loads((ROOT / "docs" / "gallery.toml").read_text(encoding="utf-8"))["build"]
    known = set(drawings.DRAWINGS) | {f"gallery/{one['name']}" for one in built}
    assert {name for name, _ in drawings.PAGES.values()} <= known
    for name in ("proof", "tables", "sides"):
        assert drawings.svg(name).startswith(b"<?xml"), name
    facts = {one.name: {"blocks": 1, "seconds": 1.0, "arm": ""} for one in gallery.entries()}
    results = hook("result_pages")
    made = {"gallery.md": gallery.page(facts), "tables.md": results.HEAD + "# Tables\n\nText.\n"}
    made["curves.md"] = results.curves_page()
    for name in re.findall(r"\(curves/([\w-]+)\.png\)", made["curves.md"]):
        assert results.curves_picture(name).startswith(b"\x89PNG"), name
    for name in pages:
        text = made.get(name) or (ROOT / "docs" / name).read_text(encoding="utf-8")
        page = SimpleNamespace(file=SimpleNamespace(src_uri=name))
        shown = drawings.on_page_markdown(text, page, None, None)
        _, below = re.split(r"^# .*\n", shown, maxsplit=1, flags=re.M)
        first = re.match(r"\n!\[([^\]]+)\]\((?:\.\./)*([^)]+)\)", below)
        assert first is not None, name
        if not first[2].startswith("images/"):
            assert re.sub(r"^drawings/|\.\w+$", "", first[2]) in known, name
        assert shown.count("![") == text.count("![") + (name != "index.md"), name
    page = SimpleNamespace(file=SimpleNamespace(src_uri="methods/dqn.md"))
    shown = drawings.on_page_markdown("# Title\n\nText.\n", page, None, None)
    assert shown.startswith("# Title\n\n![Returns of five agents")
    assert "](../drawings/learning.svg)" in shown
