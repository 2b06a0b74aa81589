"""Imports point down only, and training needs five libraries (``docs/architecture.md``).

Tests of the product need the product alone, and no test but its own the laboratory.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path

import pytest
from conftest import part_of as part_of_tests

from headless import tree_of

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "learn2assemble"
SOURCE = ROOT / "src" / PACKAGE

_BASE = {"errors", "registry", "values", "files", "constants", "progress", "kernels"}
_ARM = _BASE | {"geometry", "robot", "kinematics", "motion", "plants"}
_PRODUCT = _ARM | {
    "blas",
    "linear_programs",
    "assembly",
    "design",
    "statics",
    "planning",
}
_BUILDS = {"cell", "acting", "team", "jobs"}
"""What makes a plan with arms, and carries it out."""
ALLOWED: dict[str, set[str]] = {
    "errors": set(),
    "constants": set(),
    "progress": set(),
    "registry": {"errors"},
    "values": {"errors"},
    "files": {"errors", "values"},
    "workers": {"errors"},
    "compiling": set(),
    "kernels": set(),
    "fonts": set(),
    "linear_programs": {"errors", "progress", "compiling"},
    "blas": set(),
    "geometry": {"kernels"},
    "assembly": _BASE | {"geometry"},
    "design": _BASE | {"geometry", "assembly"},
    "statics": _BASE | {"blas", "geometry", "linear_programs", "assembly"},
    "robot": _BASE | {"geometry"},
    "kinematics": _BASE | {"geometry", "robot"},
    "motion": _BASE | {"geometry", "robot", "kinematics"},
    "plants": _BASE | {"geometry", "robot", "kinematics"},
    "simulation": _ARM,
    "handling": _ARM | {"simulation"},
    "controllers": _ARM,
    "planning": _BASE | {"geometry", "linear_programs", "assembly", "design", "statics", "motion"},
    "sensing": _ARM | {"assembly"},
    "cell": _PRODUCT | {"sensing"},
    "acting": _PRODUCT | {"simulation", "handling", "sensing", "cell"},
    "team": _PRODUCT | {"simulation", "handling", "cell", "acting"},
    "jobs": _PRODUCT | {"cell", "acting", "team"},
    "export": _ARM | {"assembly", "handling", "fonts"},
    "viewer": _ARM | {"assembly", "design", "statics", "planning", "jobs", "fonts"},
    "tasks": _PRODUCT | {"simulation", "handling", "jobs", "workers"},
    "envs": _PRODUCT | {"tasks", "workers"},
    "benchmark": _PRODUCT | {"handling", "tasks", "envs"},
    "cli": _PRODUCT
    | _BUILDS
    | {"handling", "export", "viewer", "tasks", "envs", "benchmark", "compiling", "__init__"},
    "__main__": {"cli", "errors"},
    "__init__": _PRODUCT | _BUILDS | {"export", "viewer", "tasks", "envs"},
}
"""What each part may import, besides itself. ``__init__`` is the package as such."""

LIBRARIES = {"torch", "numpy", "numba", "safetensors", "tqdm"}
"""What the training path may need."""
HEAVY = {"ray", "mujoco", "gymnasium", "rich", "matplotlib", "highspy", "ruckig"}
WING = {"tasks", "envs"}
"""What is the paper's."""
LIGHT = [
    f"tasks.{part}"
    for part in ("world", "task", "graph", "simulator", "networks", "search", "learning")
]
ONLY: dict[str, set[str]] = {
    "errors": set(),
    "geometry": {"numpy", "scipy"},
    "tasks.search": {"numpy"},
    "tasks.task": set(),
    "tasks.simulator": {"numpy"},
    "tasks.networks": {"torch", "safetensors"},
    "tasks.learning": LIBRARIES | {"tensorboard"},
}
"""Libraries of the parts that promise to know few."""

STATEMENTS = ast.stmt, ast.excepthandler, ast.match_case
"""What an import may be, or be inside of."""
MODULES = {
    path.relative_to(SOURCE).with_suffix("").as_posix().replace("/", "."): path
    for path in sorted(SOURCE.rglob("*.py"))
}


def part_of(module: str) -> str:
    """``world.rules`` -> ``world``, relative to the package; "" is the package itself."""
    return module.split(".")[0] or "__init__"


def _absolute(node: ast.ImportFrom, module: str) -> str:
    """The module a ``from`` import names, dots resolved."""
    if not node.level:
        return node.module or ""
    parents = [PACKAGE, *module.split(".")][: -node.level]
    return ".".join([*parents, *([node.module] if node.module else [])])


def imports(module: str, only_on_import: bool = False) -> frozenset[str]:
    """Full names of what a module imports; ``only_on_import`` leaves out function bodies."""
    return _imports_of(MODULES[module], module, only_on_import)


@cache
def _imports_of(path: Path, module: str, only_on_import: bool) -> frozenset[str]:
    """The same of any file; its relative imports are those of a module of that name."""
    found: set[str] = set()

    def visit(node: ast.AST) -> None:
        for child in ast.iter_child_nodes(node):
            if not isinstance(child, STATEMENTS):
                continue
            if only_on_import and isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
                continue
            if (
                only_on_import
                and isinstance(child, ast.If)
                and "TYPE_CHECKING" in ast.dump(child.test)
            ):
                continue
            if isinstance(child, ast.Import):
                found.update(alias.name for alias in child.names)
            elif isinstance(child, ast.ImportFrom):
                base = _absolute(child, module)
                found.add(base)
                # "from package import module" names a module too.
                found.update(
                    f"{base}.{a.name}"
                    for a in child.names
                    if _inside(f"{base}.{a.name}") in MODULES
                )
            visit(child)

    visit(tree_of(path))
    return frozenset(found)


def _inside(name: str) -> str | None:
    """A full name relative to the package; None for other libraries."""
    if name == PACKAGE:
        return "__init__"
    return name.removeprefix(f"{PACKAGE}.") if name.startswith(f"{PACKAGE}.") else None


def libraries(names: frozenset[str]) -> set[str]:
    tops = {name.split(".")[0] for name in names}
    return tops - {PACKAGE} - set(sys.stdlib_module_names)


# ---------------------------------------------------------------- direction


def test_the_table_has_no_cycle_and_names_every_part() -> None:
    parts = {part_of(module) for module in MODULES}
    assert parts == set(ALLOWED)
    left = {part: set(below) for part, below in ALLOWED.items()}
    while left:
        free = {part for part, below in left.items() if not below & left.keys()}
        assert free, f"a cycle among {sorted(left)}"
        left = {part: below for part, below in left.items() if part not in free}


@pytest.mark.parametrize("module", MODULES)
def test_imports_point_down(module: str) -> None:
    part = part_of(module)
    inner = {name for name in map(_inside, imports(module)) if name is not None}
    wrong = {name for name in inner if part_of(name) not in ALLOWED[part] | {part}}
    assert not wrong, f"{module} may not import {sorted(wrong)}"


def test_no_two_modules_import_each_other() -> None:
    """Not even inside a part, and not even lazily."""
    graph = {
        module: {name for name in map(_inside, imports(module)) if name in MODULES} - {module}
        for module in MODULES
    }
    while graph:
        free = {module for module, below in graph.items() if not below & graph.keys()}
        assert free, f"a cycle among {sorted(graph)}"
        graph = {module: below for module, below in graph.items() if module not in free}


@pytest.mark.parametrize("part", ONLY)
def test_parts_that_know_few_libraries(part: str) -> None:
    names = [module for module in MODULES if f"{module}.".startswith(f"{part}.")]
    assert names
    for module in names:
        assert libraries(imports(module)) <= ONLY[part], module


def test_nothing_between_a_design_and_a_robot_knows_the_tasks_of_the_paper() -> None:
    above = WING | {"benchmark", "cli", "__init__"}
    for module in MODULES:
        if part_of(module) not in above:
            assert not {part_of(n) for n in map(_inside, imports(module)) if n} & WING, module


def test_no_room_imports_the_laboratory() -> None:
    for module in MODULES:
        assert "l2a_lab" not in libraries(imports(module)), module


CELLS = (
    "design",
    "planning.tiling",
    "planning.goals",
    "jobs",
    "viewer.preview",
    "tasks",
    "envs",
    "cli",
    "benchmark",
)
"""What knows cells: drawings, tilings, structures for goals, their pictures before anything is
planned, and the wing of the paper; ``jobs`` and those above hand them on."""


def test_only_designs_and_tilings_know_cells() -> None:
    """All else takes blocks with poses and shapes."""
    for module in MODULES:
        if not f"{module}.".startswith(tuple(f"{part}." for part in (*CELLS, "__init__"))):
            inner = {n for n in map(_inside, imports(module)) if n}
            used = {n for n in inner if n.startswith(("design.cells", "planning.tiling"))}
            assert not used, f"{module} knows {sorted(used)}"


@pytest.mark.parametrize(
    ("library", "parts"),
    [
        ("mujoco", _ARM | {"simulation", "handling", "sensing", "acting", "tasks"}),
        ("ruckig", {"kinematics"}),
        ("ezdxf", {"design"}),
        ("rhino3dm", {"design"}),
        ("av", {"viewer"}),
        ("mcap_ros2", {"export"}),
        ("highspy", {"linear_programs", "statics", "tasks", "planning", "benchmark"}),
        ("gymnasium", {"envs", "benchmark"}),
        ("rich", {"cli"}),
        ("torch", {"tasks", "cli", "benchmark"}),
    ],
)
def test_a_library_stays_where_it_belongs(library: str, parts: set[str]) -> None:
    users = {part_of(module) for module in MODULES if library in libraries(imports(module))}
    assert users
    assert users <= parts


# ---------------------------------------------------------------- what training needs


@cache
def loaded_with(module: str) -> set[str]:
    """Libraries that importing a module brings, through all modules it imports on the way.

    The package's own ``__init__`` is left out: it looks for Gymnasium before it asks for it.
    """
    seen, found, queue = set(), set(), [module]
    while queue:
        name = queue.pop()
        if name in seen or name == "__init__":
            continue
        seen.add(name)
        names = imports(name, only_on_import=True)
        found |= libraries(names)
        queue += [inner for inner in map(_inside, names) if inner in MODULES]
        parent = f"{name.rpartition('.')[0]}.__init__"
        queue += [parent] if parent in MODULES else []
        package = [f"{inner}.__init__" for inner in map(_inside, names) if inner]
        queue += [inner for inner in package if inner in MODULES]
    return found


LIGHT_MODULES = [
    module for module in MODULES if f"{module}.".startswith(tuple(f"{part}." for part in LIGHT))
]


@pytest.mark.parametrize(
    "module", [*LIGHT_MODULES, "tasks.physics.static", "tasks.physics.protocol"]
)
def test_light_modules_load_no_heavy_library(module: str) -> None:
    assert not loaded_with(module) & HEAVY


def test_the_walk_finds_what_is_there() -> None:
    assert "highspy" in loaded_with("tasks.physics.equilibrium")
    assert "mujoco" in loaded_with("tasks.episode")
    assert {"torch", "numba"} <= loaded_with("tasks.learning.trainer")


# ---------------------------------------------------------------- what tests need

TESTS = {path.stem: path for path in sorted((ROOT / "tests").glob("*.py"))}
TOOLS = {"pytest", "_pytest", "hypothesis"}
IMPORTED_AS = {"pillow": "PIL"}
"""Libraries that are imported by another name than they are installed by."""


def needed_by(path: Path) -> set[str]:
    """Libraries without which a file of tests cannot be loaded: its own, and those of helpers and
    of modules of the package on the way."""
    found, seen, queue = set[str](), set[Path](), [path]
    while queue:
        file = queue.pop()
        if file in seen:
            continue
        seen.add(file)
        names = _imports_of(file, "", only_on_import=True)
        tops = libraries(names)
        queue += [TESTS[top] for top in tops if top in TESTS]
        found |= tops - TESTS.keys()
        for inner in filter(None, map(_inside, names)):
            for module in (inner, f"{inner}.__init__"):
                found |= loaded_with(module) if module in MODULES else set()
    return found


def test_no_test_of_the_product_or_of_the_tasks_knows_the_laboratory() -> None:
    """Not even inside a function; what is the laboratory's is tested in its own folder."""
    for path in [*TESTS.values(), ROOT / "conftest.py"]:
        assert "l2a_lab" not in libraries(_imports_of(path, "", only_on_import=False)), path.name


def test_tests_of_the_product_are_loaded_with_the_product_alone() -> None:
    """With what ``pip install '.[robot,video]'`` brings: no PyTorch, no Gymnasium. A test that
    needs another library asks for it inside (``pytest.importorskip``)."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    lines = [*project["dependencies"], *extras["robot"], *extras["video"]]
    names = {re.split(r"[^\w-]", line)[0] for line in lines}
    brought = {IMPORTED_AS.get(name, name) for name in names} | TOOLS
    files = [path for name, path in TESTS.items() if name.startswith("test_")]
    product = [path for path in files if part_of_tests(path) == "product"]
    assert len(product) > 50
    for path in [*product, ROOT / "conftest.py"]:
        assert needed_by(path) <= brought, path.name


def test_a_test_that_needs_more_is_seen() -> None:
    """The test above can fail: also by a helper, and by a module of the package."""
    assert {"torch", "safetensors"} <= needed_by(TESTS["learning_data"])
    assert "torch" in needed_by(TESTS["test_search"])
    assert "torch" in needed_by(TESTS["test_evaluation"])
    assert part_of_tests(TESTS["test_search"]) == "tasks"


def declared() -> set[str]:
    """Every library the project declares for itself, its extras and its development."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    groups = [project["dependencies"], *project["optional-dependencies"].values()]
    return {re.split(r"[^\w-]", line)[0] for group in groups for line in group} - {PACKAGE}


def test_every_extra_that_an_error_names_is_declared() -> None:
    """``extra(module, name, package)`` and errors raised by hand name a package and one of its
    extras; ``./laboratory`` is a package of the checkout."""
    named = set[tuple[str, str]]()
    for file in [*SOURCE.rglob("*.py"), *(ROOT / "laboratory" / "src").rglob("*.py")]:
        for call in ast.walk(tree_of(file)):
            name = getattr(call.func, "id", "") if isinstance(call, ast.Call) else ""
            if not isinstance(call, ast.Call) or name not in {"extra", "MissingExtraError"}:
                continue
            words = [a.value for a in call.args if isinstance(a, ast.Constant)]
            if len(words) > 1:
                named.add((words[2] if words[2:] else PACKAGE, str(words[1])))
    assert len(named) > 8
    folders = {PACKAGE: ROOT, "./laboratory": ROOT / "laboratory"}
    extras = {
        (package, one)
        for package, folder in folders.items()
        for one in tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))[
            "project"
        ]["optional-dependencies"]
    }
    assert named <= extras


SCRIPT = """
import sys
for name in sys.argv[1].split():
    sys.modules[name] = None  # as if it were not installed
import learn2assemble.tasks.learning.run, learn2assemble.tasks.learning.trainer
from learn2assemble.tasks.learning.config import METHODS
from learn2assemble.tasks.graph.placements import distinct_placements
from learn2assemble.tasks.task import get_task
from learn2assemble.tasks.simulator import Simulator
import numpy as np
sim = Simulator(get_task("two-sided-3x3-20-24"))
state = sim.new(2, np.random.default_rng(0))
assert sim.physics_mask(state).any()
sim.step(state, np.zeros((2, 3), np.int64))
graph = sim.observe(state)
sim.outcomes(state, graph, distinct_placements(graph, sim.action_spec))
"""


def test_the_training_path_needs_five_libraries() -> None:
    assert declared() >= LIBRARIES | HEAVY
    others = sorted(declared() - LIBRARIES)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", SCRIPT, " ".join(others)],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )
    assert done.returncode == 0, done.stderr


def test_a_blocked_library_is_missed() -> None:
    """The check above can fail: the simulator cannot do without numba."""
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys; sys.modules['numba'] = None\nimport learn2assemble.tasks.simulator",
        ],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )
    assert done.returncode != 0
    assert "numba" in done.stderr
