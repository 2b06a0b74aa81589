"""The product without the extra ``learn``: what a design needs on its way to a robot program.

The wheel carries everything a build needs.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from learn2assemble.cli import main
from learn2assemble.cli.parser import COMMANDS, L2A, CommandLine
from learn2assemble.errors import MissingExtraError, require

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "learn2assemble"
LINE = "install it with: pip install 'learn2assemble[learn]'"

WITHOUT = """
import sys
asked = []

class Missing:
    '''As if what the extra brings were not installed; the laboratory may not be looked for.'''
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.split('.')[0] in {'torch', 'gymnasium', 'safetensors', 'tqdm'} or (
            laboratory and name.startswith('l2a_lab')
        ):
            asked.append(name)
            raise ModuleNotFoundError(f'No module named {name!r}', name=name)

sys.meta_path.insert(0, Missing)
"""
PRODUCT = (
    "laboratory = True"
    + WITHOUT
    + """
import os
from pathlib import Path
import learn2assemble as l2a
from learn2assemble.cli import main
import learn2assemble.viewer.server as server
server.serve = lambda page, *rest: print(page.read_text(encoding='utf-8')[:15])
designs = Path(sys.argv[1])
gate = str(designs / 'gate.svg')
block = l2a.box_block('a', (0, 0, 0), (0.05, 0.05, 0.05))
l2a.write_assembly(l2a.Assembly((block,)), 'block.json')
Path('goals.json').write_text('{"format": "learn2assemble-goals", "version": 1, "kit": "cubes", '
    '"site": [0.2, 0.1, 0.3], "reach": [[0.025, 0.025, 0.1]]}')
for words in (
    ['build', gate, '--out', 'gate'],
    ['build', gate, '--out', 'arm', '--arm', 'panda', '--physics', 'kinematic', '--no-video'],
    ['build', 'block.json', '--out', 'block', '--arm', 'panda', '--no-video'],
    ['build', 'goals.json', '--out', 'goals'],
    ['check', 'gate/assembly.json'],
    ['export', 'gate', '--format', 'glb', '--out', 'gate.glb'],
    ['export', 'gate', '--format', 'compas', '--out', 'gate.json'],
    ['export', 'gate', '--format', 'mjcf', '--out', 'gate.xml'],
    ['view', 'gate', '--no-browser'],
    ['reach', gate, '--arm', 'panda'],
    ['export', 'block', '--format', 'csv', '--out', 'program.csv'],
    ['replay-trajectory', 'program.csv', '--arm', 'panda'],
):
    code = main(words)
    if code or asked:
        sys.exit(f'{words} ends with {code} and has asked for {asked}')
assert l2a.build(gate).complete
loaded = {'torch', 'gymnasium', 'l2a_lab'} & set(sys.modules)
sys.exit(f'asked for {asked}, loaded {loaded}' if asked or loaded else None)
"""
)
"""Everything the product promises, in one process that has nothing but the product."""
ALL_MODULES = (
    "laboratory = False"
    + WITHOUT
    + """
import importlib
from learn2assemble.errors import MissingExtraError
for name in sys.argv[1:]:
    try:
        importlib.import_module(name)
    except MissingExtraError as error:
        assert error.extra == 'learn', (name, error)
        print(name)
"""
)
LEARNS = {
    "agents": ["list"],
    "benchmark": ["board", "entry.jsonl.gz"],
    "demonstrate": ["two-sided-3x3-20-24"],
    "eval": ["two-sided-3x3-20-24"],
    "tasks": [],
    "train": ["two-sided-3x3-20-24", "--out", "new"],
}
"""Commands that need the extra, with what they cannot do without."""


def python(code: str, *words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code, *words],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
    )


def test_the_product_asks_for_nothing_of_the_extra(tmp_path: Path) -> None:
    done = python(PRODUCT, str(ROOT / "examples" / "designs"), folder=tmp_path)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "complete: 10 blocks" in done.stdout
    assert "<!doctype html>" in done.stdout.lower()


def test_a_library_of_the_extra_that_is_asked_for_is_seen(tmp_path: Path) -> None:
    """The test above can fail."""
    code = f"laboratory = True{WITHOUT}\ntry: import torch\nexcept ImportError: print(asked)"
    assert python(code, folder=tmp_path).stdout == "['torch']\n"


def test_every_module_loads_or_names_the_extra(tmp_path: Path) -> None:
    files = [path.relative_to(SOURCE.parent).with_suffix("") for path in SOURCE.rglob("*.py")]
    names = sorted(".".join(path.parts).removesuffix(".__init__") for path in files)
    names.remove("learn2assemble.__main__")
    done = python(ALL_MODULES, *names, folder=tmp_path)
    assert done.returncode == 0, done.stderr[-2000:]
    learning = {name.split(".")[1] for name in done.stdout.split()}
    assert learning == {"tasks", "envs"}
    wing = {name.split(".")[2] for name in done.stdout.split() if ".tasks." in name}
    assert wing == {
        "graph",
        "networks",
        "learning",
        "evaluation",
        "episode",
        "playing",
        "built",
        "world_model",
    }


@pytest.fixture
def product(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    without_extra(monkeypatch, tmp_path)


def without_extra(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """Be in an empty folder, without what the extra brings."""
    for name in ("torch", "gymnasium", "safetensors", "tqdm"):
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.chdir(folder)


@pytest.mark.usefixtures("product")
@pytest.mark.parametrize(
    "words",
    [
        *([name, *words] for name, words in LEARNS.items()),
        ["build", "two-sided-3x3-20-24", "--out", "new"],
    ],
    ids=lambda words: " ".join(words[:2]),
)
def test_what_learns_names_the_extra(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    check_extra_is_named(words, L2A, tmp_path, capsys)


def check_extra_is_named(
    words: list[str], program: CommandLine, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A command without it says how to install it in one line, and writes nothing."""
    assert main(words, program) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.count("\n") == 1
    assert LINE in told.err
    assert not list(folder.iterdir())


def test_the_list_of_what_learns_is_complete() -> None:
    assert {name for name, command in COMMANDS.items() if command.learns} == set(LEARNS)


@pytest.mark.usefixtures("product")
def test_the_help_needs_no_extra(capsys: pytest.CaptureFixture[str]) -> None:
    check_help(L2A, capsys)


def check_help(program: CommandLine, capsys: pytest.CaptureFixture[str]) -> None:
    """Every command of a program shows its help."""
    for name in program.commands:
        with pytest.raises(SystemExit) as left:
            main([name, "--help"], program)
        assert left.value.code == 0
        assert f"example: {program.name} {name}" in capsys.readouterr().out


def test_public_names_of_agents_name_the_extra(tmp_path: Path) -> None:
    code = (
        f"laboratory = True{WITHOUT}"
        + """
import learn2assemble as l2a
for name in l2a.__all__:
    try:
        getattr(l2a, name)
    except l2a.Learn2AssembleError as error:
        print(name, error)
try:
    l2a.build('two-sided-3x3-20-24')
except l2a.Learn2AssembleError as error:
    print('build', error)
"""
    )
    lines = python(code, folder=tmp_path).stdout.splitlines()
    assert all(line.endswith(LINE) for line in lines)
    assert {line.split()[0] for line in lines} == {
        "Agent",
        "AssemblyEnv",
        "AssemblyVectorEnv",
        "Demonstrated",
        "Evaluation",
        "TrainingRun",
        "build",
        "demonstrate",
        "evaluate",
        "load_agent",
        "train",
    }


def test_the_bench_measures_the_product(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from learn2assemble import benchmark as bench

    names = ("check_s", "decision_ms", "gradient_samples_per_s", "static_single_steps_per_s")
    for name in ("torch", "gymnasium", "safetensors", "tqdm"):
        monkeypatch.setitem(sys.modules, name, None)
    for name in list(sys.modules):
        # Loaded by other tests, with what they need.
        if name.startswith(("learn2assemble.envs", "learn2assemble.tasks.learning.trainer")):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(bench, "MEASUREMENTS", {name: bench.MEASUREMENTS[name] for name in names})
    monkeypatch.setattr(bench, "rate", lambda step, seconds: step() and 1.0)
    assert main(["bench"]) == 0
    told = capsys.readouterr()
    assert "check_s" in told.out
    assert "decision_ms" not in told.out
    assert f"left out decision_ms, gradient_samples_per_s: torch is not installed; {LINE}" in (
        told.err
    )
    assert f"left out static_single_steps_per_s: gymnasium is not installed; {LINE}" in told.err


def test_an_extra_is_named_once_for_several_libraries(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("torch", "gymnasium"):
        monkeypatch.setitem(sys.modules, name, None)
    told = r"^torch and gymnasium are not .* install them with: .*\[learn\]'$"
    with pytest.raises(MissingExtraError, match=told):
        require(("torch", "learn", ""), ("gymnasium", "learn", ""))


REPOSITORY = Path(__file__).parent.parent


@pytest.mark.slow
def test_the_wheel_builds_a_design_elsewhere(tmp_path: Path) -> None:
    """Built, unpacked in another place, run from a third: nothing of the checkout is used."""
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", str(tmp_path)]
    subprocess.run([*command, str(REPOSITORY)], check=True, capture_output=True, timeout=300)
    (wheel,) = tmp_path.glob("learn2assemble-*.whl")
    assert wheel.stat().st_size <= 4_000_000
    installed = tmp_path / "installed"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(installed)
        names = set(archive.namelist())
    for arm in ("panda", "ur5e"):
        folder = f"learn2assemble/assets/arms/{arm}"
        wanted = {f"{folder}/{name}" for name in ("arm.toml", f"{arm}.xml", "LICENSE", "NOTICE")}
        assert wanted <= names
        assert f"{folder}/meshes.zip" in names
    tower = [[-0.025, 0.0], [-0.025, 0.1], [0.025, 0.1], [0.025, 0.0]]
    design = tmp_path / "tower.json"
    design.write_text(
        json.dumps(
            {
                "format": "learn2assemble-design",
                "version": 1,
                "kit": "cubes",
                "elevations": [{"name": "front", "outline": tower}],
            }
        )
    )
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "learn2assemble",
            "build",
            str(design),
            "--out",
            "out",
            "--json",
            "--seconds",
            "200",
        ],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
        # In a new place all kernels would be compiled again, for longer than they run as Python.
        env={**os.environ, "PYTHONPATH": str(installed), "NUMBA_DISABLE_JIT": "1"},
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout.splitlines()[-1])
    assert result["status"] == "complete"
    for name in ("plan.json", "view.html", "progress.png"):
        assert (tmp_path / "out" / name).stat().st_size > 1000
    where = subprocess.run(
        [sys.executable, "-c", "import learn2assemble; print(learn2assemble.__file__)"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": str(installed)},
    )
    assert str(installed) in where.stdout
    pytest.importorskip("torch")  # What follows is told where the extra is installed.
    absent = subprocess.run(
        [sys.executable, "-m", "learn2assemble", "eval", "bars-one-sided-5x5-25-27"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(installed)},
    )
    assert absent.returncode == 2
    (line,) = absent.stderr.splitlines()
    assert "relational-bars-s0" in line
    assert "to fetch it (fetch_agents)" in line
