"""What documents and examples say can be done can be done: commands, Python, names."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import markdown
import numpy as np
import pytest
from PIL import Image

from headless import ROOT, run_script
from learn2assemble.cli import main
from learn2assemble.cli.parser import L2A, CommandLine, make_parser
from learn2assemble.tasks.networks.agent import agent_files
from learn2assemble.tasks.task import PRESETS

PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
ALL_PAGES = [*PAGES, *(ROOT / f"{name}.md" for name in ("CONTRIBUTING", "CHANGELOG", "SECURITY"))]
FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```", re.M | re.S)
FILE = re.compile(r'^```\w+ title="([\w.]+)"\n(.*?)^```', re.M | re.S)
"""A block that a reader saves under the name it has."""
COMMAND = re.compile(r"^\s*(?:\.venv/bin/)?(l2a(?:-lab)?)\s+(.*)$", re.M)
_SMALL = ("num_envs=4", "network.width=16", "batch_size=4", "initial_samples=4")
TINY = {
    "train": [
        *["--samples", "8", "--device", "cpu"],
        *[w for s in _SMALL for w in ("--set", s)],
    ],
    "eval": ["--episodes", "1"],
    "demonstrate": ["--episodes", "20"],
    "benchmark run": ["--problems", "1"],
    "benchmark run random.jsonl.gz": ["--problems", "1", "--task", "two-sided-3x3-20-24"],
    "table": ["--from-files"],
    # Two arms are simulated in tests of their own.
    "build examples/bricks/stair.txt --kit duplo --arm panda --arm": ["--physics", "kinematic"],
    # A video is drawn of the gate, and of the stair.
    "build mine.svg --kit mine.toml --arm": ["--no-video"],
    "build examples/designs/arch_pair.json --arm": ["--no-video"],
    # What is run to its end is the H.
    "run out/bench-ur5e": ["--until", "2"],
    "run out/arch-ur5e": ["--until", "2"],
}
"""Words that make a command small, by how it begins, the longest beginning first; later words win.
"""
TABBED = {"pymdownx.tabbed": {"alternate_style": True}}
PARSED = {
    "--server": "asks a process beside it: test_benchmark",
    "ur://": "moves a robot: test_run, with a fake controller",
    "keep runs": "writes into the repository: test_table_cli",
    "--quick": "measures for minutes",
    "--train": "trains for hours",
    "--agents": "measures for hours",
    "--workers 8": "measures for hours",
    "--ray": "needs other machines",
    "measure-designs": "takes 29 s and more",
    "gate-arm": "is that of the first page in another folder",
    "--arm panda --arm ur5e": "takes 22 s",
    "gabled_house.json --arm": "takes 34 s",
}
"""Commands with these words are only parsed, and why (seconds of the processor)."""
OWN_ARM = "six"
"""Commands with this word need an arm of one's own."""


FILES = {
    name: content
    for page in PAGES
    for name, content in FILE.findall(page.read_text(encoding="utf-8"))
}


def commands() -> list[tuple[str, str, list[str]]]:
    """Page, program and words of every command in a block of a document, in order."""
    found = []
    for page in PAGES:
        for _, block in FENCE.findall(page.read_text(encoding="utf-8")):
            for program, line in COMMAND.findall(block):
                words = shlex.split(line, comments=True)
                # A template: l2a train TASK. The table T2 is none.
                if not any(word.isalpha() and word.isupper() for word in words[:2]):
                    found.append((page.name, program, words))
    return found


def test_commands_are_found() -> None:
    assert len(commands()) >= 20


def commands_of(program: CommandLine) -> list[tuple[str, list[str]]]:
    """Page and words of every command of a program."""
    return [(page, words) for page, name, words in commands() if name == program.name]


@pytest.mark.parametrize(("page", "words"), commands_of(L2A), ids=lambda value: str(value)[:60])
def test_a_command_of_a_document_is_accepted(page: str, words: list[str]) -> None:
    check_accepted(page, words, L2A)


def check_accepted(page: str, words: list[str], program: CommandLine) -> None:
    """The words are of the program, and what they name there is."""
    options = make_parser(words, program).parse_args(words)
    task = getattr(options, "task", None)
    assert task is None or task in PRESETS, page
    design = getattr(options, "design", None)
    assert design is None or (ROOT / design).is_file() or design in {*PRESETS, *FILES}, page
    agent = getattr(options, "agent", None)
    assert agent is None or "/" in agent or agent in agent_files(), page


Told = tuple[str, list[str]]
"""Program and words of a command."""


def commands_that_run() -> dict[str, list[Told]]:
    """Commands by their pages, in order, each once: pages with a command in common go together.

    Those of :data:`OWN_ARM` are left out.
    """
    groups: list[tuple[set[str], dict[str, Told]]] = []
    for page, program, words in commands():
        text = f"{program} {' '.join(words)}"
        if any(word in text for word in (*PARSED, OWN_ARM)):
            continue
        mine = [group for group in groups if page in group[0] or text in group[1]]
        pages, told = {page}, dict[str, Told]()
        for group in mine:
            groups.remove(group)
            pages |= group[0]
            told |= group[1]
        groups.append((pages, told | {text: (program, words)}))
    return {" ".join(sorted(pages)): [*told.values()] for pages, told in groups}


GROUPS = {
    pages: [words for _, words in told]
    for pages, told in commands_that_run().items()
    if {name for name, _ in told} == {L2A.name}
}
"""Those of the product alone; tests of the laboratory run the others."""


def small(words: list[str]) -> list[str]:
    """The words of a command, and what makes it small."""
    text = " ".join(words)
    mine = [key for key in TINY if f"{text} ".startswith(f"{key} ")]
    extra = TINY[max(mine, key=len)] if mine else []
    if words[0] == "train":
        words = [w for k, w in enumerate(words) if "--minutes" not in words[max(k - 1, 0) : k + 1]]
        if "published" in words:
            extra = [*extra, "--set", "network.rounds=1"]
    return [*words, *(() if "--resume" in words else extra)]


@pytest.mark.slow
@pytest.mark.parametrize("pages", GROUPS)
def test_the_commands_of_the_documents_run(
    pages: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One after the other in one folder, as they use what the ones before have written."""
    set_up_folder(tmp_path, monkeypatch)
    for words in GROUPS[pages]:
        check_runs(words, L2A, capsys)


def check_runs(words: list[str], program: CommandLine, capsys: pytest.CaptureFixture[str]) -> None:
    """The command, made small, succeeds."""
    code = main(small(words), program)
    assert code == 0, (" ".join(words), capsys.readouterr().err[-500:])


def set_up_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Be in a folder with what commands of documents read; videos have fewer pictures."""
    monkeypatch.chdir(folder)
    monkeypatch.setattr("learn2assemble.viewer.server.serve", lambda *_: "")
    monkeypatch.setattr("learn2assemble.viewer.video.SPEED", 200.0)
    for name in ("examples", "tests"):
        (folder / name).symlink_to(ROOT / name)
    shutil.copytree(ROOT / "results", folder / "results")
    for name, content in FILES.items():
        (folder / name).write_text(content, encoding="utf-8")


@pytest.mark.slow
def test_the_commands_with_an_arm_of_ones_own_run(tmp_path: Path) -> None:
    """In other processes, as the arm would stay known to all other tests: the first makes it, and
    the second one knows it from the start."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    making, *using = [words for _, _, words in commands() if OWN_ARM in " ".join(words)]
    assert making[0] == "add-arm"
    assert len(using) >= 3
    code = "import json, sys; from learn2assemble.cli import main; "
    code += "[main(words) and sys.exit(repr(words)) for words in json.loads(sys.argv[1])]"
    for some, arms in (([making], ""), (using, "arms")):
        known = {"PYTHONPATH": str(ROOT / "src"), "LEARN2ASSEMBLE_ARMS": arms}
        done = subprocess.run(
            [sys.executable, "-c", code, json.dumps(some)],
            cwd=tmp_path,
            env=os.environ | known,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr[-500:]


def test_what_is_only_parsed_is_in_a_document() -> None:
    """An exception whose command is gone is none."""
    texts = [" ".join(words) for _, _, words in commands()]
    for word in (*PARSED, OWN_ARM):
        assert any(word in text for text in texts), word


def python_blocks() -> list[tuple[str, str]]:
    return [
        (page.name, block)
        for page in PAGES
        for kind, block in FENCE.findall(page.read_text(encoding="utf-8"))
        if kind == "python"
    ]


@pytest.mark.parametrize(("page", "block"), python_blocks(), ids=lambda value: value[:30])
def test_the_python_of_a_document_runs(
    page: str, block: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    exec(compile(block, page, "exec"), {})


def test_the_site_names_every_page_and_public_name() -> None:
    import learn2assemble as l2a

    site = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for page in (ROOT / "docs").rglob("*.md"):
        assert str(page.relative_to(ROOT / "docs")) in site
    reference = (ROOT / "docs" / "reference.md").read_text(encoding="utf-8")
    left = {"Learn2AssembleError", "Shape", "Simulator"}
    for name in set(l2a.__all__) - left:
        home, there = l2a._PLACES[name]
        assert f"::: learn2assemble.{home}.{there}\n" in reference, name


def test_what_the_reference_lists_is_where_it_says() -> None:
    """Names of the package, under that name or a told one; the rest where it is imported from."""
    import learn2assemble as l2a

    reference = (ROOT / "docs" / "reference.md").read_text(encoding="utf-8")
    places = {f"learn2assemble.{'.'.join(place)}": name for name, place in l2a._PLACES.items()}
    beside = {
        f"{module}.{name}"
        for module, names in re.findall(r"^from (\S+) import (.+)$", reference, re.MULTILINE)
        for name in names.split(", ")
    }
    listed = re.findall(r"^::: (\S+)$", reference, re.MULTILINE)
    assert listed
    assert {path for path in listed if path not in places} == beside
    for path in listed:
        module, _, name = path.rpartition(".")
        found = getattr(importlib.import_module(module), name)
        public = places.get(path)
        if public is not None:
            assert getattr(l2a, public) is found
            assert public == name or {f"`{public}`", f"`{name}`"} <= set(reference.split())


def test_the_tutorial_says_how_many_flat_actions_there_are() -> None:
    from learn2assemble.envs.actions import num_flat_actions

    tutorial = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
    sizes = [num_flat_actions(task) for task in PRESETS.values()]
    assert f"are the paper's, {min(sizes):,} to {max(sizes):,} by the task" in tutorial


def test_files_named_in_the_architecture_exist() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    source, laboratory = ROOT / "src" / "learn2assemble", ROOT / "laboratory" / "src"
    for named in re.findall(r"`([a-z_0-9/]+/[a-z_0-9]*(?:\.py)?)`", text):
        name = named if named.endswith((".py", "/")) else f"{named}.py"
        assert any((folder / name).exists() for folder in (source, ROOT, laboratory)), name
    rooms = {path.name for path in source.iterdir() if (path / "__init__.py").exists()}
    for room in rooms:
        assert f"`{room}/`" in text, room


def hook(name: str) -> ModuleType:
    """A file of the site that mkdocs loads."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


MOST_WORDS = 90
"""Of a paragraph, an entry of a list or a cell of a table."""


def paragraphs(text: str) -> list[str]:
    """Paragraphs, entries of lists, and cells of tables of a page, without code and links."""
    plain = re.sub(r"\]\([^)\s]*\)", "]", FENCE.sub("\n", text))
    found, lines = [], []
    for line in [*map(str.strip, plain.splitlines()), ""]:
        if not line or line.startswith(("#", "|", "<")) or re.match(r"(?:[-*]|\d+\.) ", line):
            found.append(" ".join(lines))
            lines = []
        if line.startswith("|"):
            found += line.strip("|").split(" | ")
        elif line and not line.startswith(("#", "<")):
            lines.append(line)
    return [one.strip() for one in found if one.strip()]


def test_paragraphs_are_found() -> None:
    page = "# Title\n\nOne\ntwo [three](a.md).\n* four\n  five\n* six\n\n| a | b |\n```\nno\n```\n"
    assert paragraphs(page) == ["One two [three].", "* four five", "* six", "a", "b"]


@pytest.mark.parametrize("page", ALL_PAGES, ids=lambda page: page.name)
def test_paragraphs_are_short(page: Path) -> None:
    """What is longer is a list, a table or two paragraphs."""
    for one in paragraphs(page.read_text(encoding="utf-8")):
        assert len(one.split()) <= MOST_WORDS, (len(one.split()), one[:100])


def test_the_first_page_and_the_changes_are_short() -> None:
    """A page that is read at once, and entries of a line."""
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 90
    for line in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").splitlines():
        assert len(line) <= 160, line


def test_conditions_of_a_table_are_tabs_on_the_site() -> None:
    """One is seen at a time; a forge shows the same text as fold-outs."""
    table = "| method | R |\n| --- | ---: |\n| DQN | 3.2 |"
    opened, closed = (
        f'<details markdown="1"{state}><summary>ε = {value}</summary>\n\n{table}\n\n</details>\n\n'
        for state, value in ((" open", 0.05), ("", 0))
    )
    alone = f"# Tables\n\n### T1\n\n{opened}Between.\n\n### T2\n\n{closed}Behind.\n"
    tabs = hook("result_pages").tabs
    assert tabs(alone) == alone
    inner = "\n".join(f"    {line}" for line in table.splitlines())
    shown = f'===+ "ε = 0.05"\n\n{inner}\n\n=== "ε = 0"\n\n{inner}\n\n'
    assert tabs(f"### T1\n\n{opened}{closed}Behind.\n") == f"### T1\n\n{shown}Behind.\n"
    page = (ROOT / "results" / "tables.md").read_text(encoding="utf-8")
    site = tabs(page)
    assert page.count("<details") == site.count("\n===") + site.count("<details")
    assert site.count("<details") < 20 < site.count("\n===")
    html = markdown.markdown(
        shown, extensions=["tables", "pymdownx.tabbed"], extension_configs=TABBED
    )
    assert html.count('class="tabbed-block"') == html.count("<table>") == 2
    assert "pymdownx.tabbed:\n      alternate_style: true" in (ROOT / "mkdocs.yml").read_text()


def test_the_board_of_the_first_page_is_that_of_the_entries() -> None:
    """Words and bars of the drawing that is tracked."""
    drawings = hook("drawings")
    tracked = (ROOT / "docs" / "images" / "benchmark.svg").read_text(encoding="utf-8")
    drawn = [tracked, drawings.svg("board").decode()]
    words = [re.findall(r"<text[^>]*>([^<]*)", one) for one in drawn]
    assert "look-ahead" in words[0]
    assert words[0] == words[1]
    paths = [" ".join(re.findall(r" d=\"([^\"]*)", one)) for one in drawn]
    numbers = [np.array(re.findall(r"-?\d+(?:\.\d+)?", one), float) for one in paths]
    np.testing.assert_allclose(*numbers, atol=0.5)


def test_a_picture_of_the_gallery_is_that_of_its_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gallery = hook("gallery")
    monkeypatch.setattr(gallery, "FOLDER", tmp_path)
    assert len(gallery.entries()) >= 16
    (entry,) = (one for one in gallery.entries() if one.name == "figure")
    assert entry.facts() == {}
    facts = gallery.make(entry)
    assert facts == entry.facts()
    assert facts["blocks"] == 13
    assert not gallery.is_empty(entry.picture)
    assert entry._replace(command=f"{entry.command} --no-props").facts() == {}
    os.utime(entry.picture, (0, 0))
    assert entry.facts() == {}
    nothing = tmp_path / "nothing.png"
    Image.new("RGB", (48, 40), "#f6f5f1").save(nothing)
    assert gallery.is_empty(nothing)


@pytest.mark.parametrize("name", ["README", "CONTRIBUTING", "CHANGELOG", "SECURITY"])
def test_links_of_the_first_pages_lead_somewhere(name: str) -> None:
    """Those of the other pages are looked at when the site is built."""
    for link in re.findall(r"\]\(([^)\s]+)\)", (ROOT / f"{name}.md").read_text(encoding="utf-8")):
        place, _, section = link.partition("#")
        if not place.startswith("https://"):
            page = ROOT / (place or f"{name}.md")
            assert page.exists(), link
            if section:
                heads = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.M)
                plain = [re.sub(r"[^\w\- ]", "", head.lower()) for head in heads]
                assert section in [head.replace(" ", "-") for head in plain], link


# Every script in examples runs, from any folder.

EXAMPLES = ROOT / "examples"
WORDS = {
    "train": ["40", "2"],
    "own_network": ["200"],
    "build": [str(EXAMPLES / "designs" / "stepped_tower.json"), "panda"],
}
"""Arguments that make an example small."""
SLOW = {"build"}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(path.stem, marks=[pytest.mark.slow] if path.stem in SLOW else [])
        for path in sorted(EXAMPLES.glob("*.py"))
    ],
)
def test_example_runs(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    script, words = EXAMPLES / f"{name}.py", WORDS.get(name, [])
    if name.startswith("own_"):
        # What it registers stays a secret from all other tests.
        told = run_script(script, *words, cwd=tmp_path)
    else:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", [str(script), *words])
        runpy.run_path(str(script), run_name="__main__")
        told = capsys.readouterr().out
    assert told.strip()
