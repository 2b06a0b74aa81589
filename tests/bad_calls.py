"""Calls of ``l2a`` that must be refused: name, words, what the message must say.

Words may hold ``{d}``, a folder prepared by :func:`prepare`; nothing in it may change.
"""

from __future__ import annotations

import gzip
import io
import json
import os
import shutil
import zipfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from learn2assemble.tasks.networks.agent_file import bare_weights

TASK = "one-sided-3x3-22-24"
LONG = "x" * 300
"""Longer than a file name may be."""
ARCH = str(Path(__file__).parents[1] / "examples" / "structures" / "arch.obj")
TWO = ("--arm", "panda", "--arm", "ur5e")
"""Of two arms."""
WALL = str(Path(__file__).parent / "data" / "example_plan" / "assembly.json")
"""An assembly that can be checked."""
PROGRAM_RATES = {
    "no_limits": "1000",
    "rate_high": "1e9",
    "rate_0": "0",
    "rate_below": "-1000",
    "rate_nan": "NaN",
}
"""Tables of a robot's program without limits, and what they say of their rate."""
UR5E_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
TINY_RUN = [
    "--config",
    "published",
    "--device",
    "cpu",
    "--set",
    "network.width=16",
    "--set",
    "network.rounds=1",
    "--set",
    "num_envs=4",
    "--set",
    "replay_size=50",
    "--set",
    "batch_size=4",
    "--set",
    "initial_samples=8",
]
"""Words that make a training small."""


class BadCall(NamedTuple):
    name: str
    words: list[str]
    fragment: str


def train(*words: str) -> list[str]:
    """A training into a new folder."""
    return ["train", TASK, "--out", "{d}/new", "--samples", "8", *TINY_RUN, *words]


def resume(folder: str, *words: str, task: str = TASK) -> list[str]:
    return ["train", task, "--out", folder, "--resume", "--device", "cpu", *words]


def evaluate(*words: str) -> list[str]:
    return ["eval", TASK, "--agent", "{d}/agent", "--episodes", "1", *words]


def build(*words: str) -> list[str]:
    """A build of a task with a valid agent; later words win."""
    return ["build", TASK, "--out", "{d}/new", "--agent", "{d}/agent", "--seconds", "1", *words]


def exact_arm(*words: str) -> list[str]:
    """A design built by an arm."""
    return ["build", "{d}/design.json", "--out", "{d}/new", "--arm", "panda", *words]


def read(name: str, *words: str) -> list[str]:
    """A build of a file that cannot be read; later words win."""
    return ["build", f"{{d}}/read/{name}", "--out", "{d}/new", *words]


BLOCKS = {
    "overlap": "blocks that only touch",
    "open": "a closed surface",
    "inside_out": "faces counter-clockwise from outside",
    "flat": "volume: got 0.0",
    "thin": "thickness: got 9.99",
    "speck": "thickness: got 4",
    "specks": "thickness: got 4",
    "hung": "a block that touches one",
    "many": "got 100000, expected 1 to 10000 blocks",
}
"""Files of blocks that are refused, and what is said of each."""


_PART = "1 4 {} {} {} 1 0 0 0 1 0 0 0 1 {}\n"
"""A part of LDraw: where it is, and which."""
_SUBMODELS = "".join(
    f"0 FILE m{k}.ldr\n" + 10 * _PART.format(0, 0, 0, f"m{k + 1}.ldr") for k in range(12)
)
BRICKS = {
    "loop.mpd": (
        "0 FILE a.ldr\n" + _PART.format(0, 0, 0, "b.ldr") + "0 NOFILE\n"
        "0 FILE b.ldr\n" + _PART.format(0, 0, 0, "a.ldr"),
        "no submodel that holds itself",
    ),
    "deep.mpd": (
        _SUBMODELS + "0 FILE m12.ldr\n" + _PART.format(0, 0, 0, "3001.dat"),
        "got 1000000000000, expected 1 to 10000 bricks",
    ),
    "long.ldr": (200_001 * _PART.format(0, 0, 0, "3001.dat"), "expected at most 200000"),
    "off.ldr": (
        _PART.format(0, 0, 0, "3001.dat") + _PART.format(7, -24, 3, "3001.dat"),
        "line 2: place: got '7 -24 3'",
    ),
    "turned.ldr": ("1 4 0 0 0 0.8 0 0.6 0 1 0 -0.6 0 0.8 3001.dat\n", "turned by quarters"),
    "overlap.ldr": (
        _PART.format(0, 0, 0, "3001.dat") + _PART.format(20, 0, 0, "3001.dat"),
        "bricks that do not overlap",
    ),
    "unknown.ldr": (_PART.format(0, 0, 0, "3001x9.dat"), "nearest 300"),
    "overlap.txt": ("2x4 (0,0,0)\n2x2 (1,1,0)\n", "bricks that do not overlap"),
    "letters.txt": ("2x4 (0,0,0)\n2xA (0,0,1)\n", "line 2: got '2xA (0,0,1)'"),
    "half.txt": ("2x4 (0.5,0,0)\n", "a brick such as 2x4 (0,0,0)"),
    "below.txt": ("2x4 (0,0,-3)\n", "at or above the ground"),
    "far.txt": ("2x4 (999999,0,0)\n", "coordinates up to 100000"),
    "nan.json": ('{"bricks": [{"size": [2, 2], "at": [0, 0, NaN]}]}', "nan.json"),
}
"""Files of bricks that are refused, and what is said of each."""
_KIT = """format = "learn2assemble-kit"
version = 1
name = "k"
pitch = [0.016, 0.016, 0.0192]
density = 1000.0
[joint]
law = "clutch"
%s
[[kinds]]
name = "2x2"
box = [2, 2, 1]
"""
STUDS = {
    "negative": ("capacity = -0.7", "joint.capacity: got -0.7"),
    "nan": ("capacity = nan", "joint.capacity: got nan"),
    "absurd": ("capacity = 1e9", "expected 0 to 1000 N"),
    "words": ('capacity = "much"', "joint.capacity: got 'much'"),
    "press": ("press = -1.0", "joint.press: got -1.0"),
    "glue": ('base = "glue"', "one of grips, table"),
    "mortar": ("tensile = 3.0", "key: got 'tensile'"),
    "hook": (
        '[[kinds]]\nname = "hook"\ncells = [[0, 0, 0], [0, 0, 1], [1, 0, 1]]',
        "studs on nothing",
    ),
}
"""Kits whose joints are refused: a line of each, and what is said of it."""


def given(name: str, *words: str) -> list[str]:
    """A build of blocks that are given."""
    return ["build", f"{{d}}/blocks/{name}.json", "--out", "{d}/new", *words]


def prepare_files(folder: Path) -> None:
    """Files of designs that cannot be read, in a new folder."""
    folder.mkdir()
    arrays = {
        "empty": np.zeros((0, 3, 3)),
        "wide": np.ones((65, 65, 65), bool),
        "nan": np.full((2, 2, 2), np.nan),
        "complex": np.ones((2, 2, 2), complex),
        "object": np.full((2, 2, 2), None),
        "grey": np.full((2, 2, 2), 255, np.uint8),
        "words": np.full((2, 2, 2), "yes"),
        "flat": np.ones((5, 5)),
    }
    for name, values in arrays.items():
        np.save(folder / f"{name}.npy", values, allow_pickle=True)
    with zipfile.ZipFile(folder / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        head = io.BytesIO()
        np.lib.format.write_array_header_1_0(
            head, {"descr": "|b1", "fortran_order": False, "shape": (4000, 4000, 10)}
        )
        archive.writestr("wanted.npy", head.getvalue() + bytes(160_000_000))
    picture = io.BytesIO()
    Image.fromarray(np.zeros((64, 64, 3), np.uint8)).save(picture, "JPEG")
    whole = picture.getvalue()
    (folder / "cut.jpg").write_bytes(whole[: len(whole) // 2])
    size = whole.index(b"\xff\xc0") + 5
    (folder / "huge.jpg").write_bytes(whole[:size] + b"\xff\xff\xff\xff" + whole[size + 4 :])
    (folder / "cut.webp").write_bytes(b"RIFF\x40\0\0\0WEBPVP8 " + bytes(9))
    corners = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
    sides = "3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n"
    (folder / "short.off").write_text(f"OFF\n4 9 0\n{corners}{sides}")
    (folder / "promise.off").write_text(f"OFF\n4 999999999999 0\n{corners}{sides}")
    (folder / "open.off").write_text(f"OFF\n4 3 0\n{corners}{sides[:24]}")
    (folder / "units.off").write_text(f"OFF\n4 4 0\n{corners.replace('1', '300')}{sides}")


def prepare_blocks(folder: Path) -> None:
    """Files of blocks that cannot be built, in a new folder."""
    folder.mkdir()
    corners = np.array([[x, y, z] for z in (0, 0.1) for y in (0, 0.1) for x in (0, 0.2)])
    faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    above = corners + np.array([0, 0, 0.1])

    def write(name: str, *more: dict[str, object], scale: float = 1.0) -> None:
        first = {"id": "a", "vertices": (scale * corners).tolist()}
        both = {"faces": faces, "density": 500}
        blocks = [both | first, *(both | {"id": f"b{k}"} | b for k, b in enumerate(more))]
        document = {"format": "learn2assemble-assembly", "version": 1, "blocks": blocks}
        (folder / f"{name}.json").write_text(json.dumps(document))

    write("overlap", {"vertices": (above - [0, 0, 0.05]).tolist()})
    write("open", {"vertices": above.tolist(), "faces": faces[1:]})
    write("inside_out", {"vertices": above.tolist(), "faces": [face[::-1] for face in faces]})
    write("flat", {"vertices": (above * [1, 1, 0]).tolist()})
    write("thin", {"vertices": (corners * [1, 1, 1e-8] + [0, 0, 0.1]).tolist()})
    write("speck", {"vertices": (1e-9 * above).tolist()})
    write("specks", {"vertices": (1e-9 * above).tolist()}, scale=1e-9)
    write("hung", {"vertices": (above + np.array([0, 0, 3])).tolist(), "support": True})
    write("loose", {"vertices": (corners + np.array([1, 0, 0.3])).tolist(), "prop": True})
    many = ", ".join(['{"vertices": []}'] * 100_000)
    head = '"format": "learn2assemble-assembly", "version": 1'
    (folder / "many.json").write_text(f'{{{head}, "blocks": [{many}]}}')


def prepare_bricks(folder: Path) -> None:
    """Files of bricks, kits with studs and tasks of products that are refused, in a new folder."""
    folder.mkdir()
    for name, (content, _) in BRICKS.items():
        (folder / name).write_text(content)
    for name, (line, _) in STUDS.items():
        (folder / f"{name}.toml").write_text(_KIT % line)
    (folder / "good.txt").write_text("2x2 (0,0,0)\n2x2 (0,0,1)\n")
    (folder / "words.jsonl").write_text("no task\n")
    (folder / "empty.jsonl").write_text("")
    (folder / "short.jsonl").write_text('{"tier": 1, "task": 1, "blocks": []}\n')


def prepare(folder: Path, agent: Path, run: Path, design: Path, log: Path) -> None:
    """Fill ``folder`` with what the calls name.

    Args:
        agent: folder of a valid agent.
        run: folder of a finished training of ``TASK``.
        design: a valid design file.
        log: a valid file of recorded transitions.
    """
    shutil.copytree(agent, folder / "agent")
    shutil.copytree(run, folder / "run")
    shutil.copy(design, folder / "design.json")
    shutil.copy(log, folder / "log.jsonl")
    (folder / "file.txt").write_text("mine")
    prepare_files(folder / "read")
    prepare_bricks(folder / "bricks")
    prepare_blocks(folder / "blocks")
    head = {
        "format": "learn2assemble-robot-program",
        "version": 1,
        "arm": "ur5e",
        "joints": [f"{name}_joint" for name in UR5E_JOINTS],
    }
    for name, rate in PROGRAM_RATES.items():
        lines = [f"# {key}: {json.dumps(value)}" for key, value in head.items()]
        (folder / f"{name}.csv").write_text("\n".join([*lines, f"# rate: {rate}", "time", "0", ""]))
    for name, second in (("layout", [0.1, -0.3]), ("far", [0.1, -0.3]), ("overlap", [0.04, -0.3])):
        places = [[0.7 if name == "far" else 0.0, -0.3], second]
        places += [[0.1 * (k % 5) - 0.3, -0.42 + 0.84 * (k // 5)] for k in range(10)]
        places += [[-0.3, -0.32], [-0.2, -0.32], [-0.3, 0.32], [-0.2, 0.32]]
        layout = {
            "format": "learn2assemble-layout",
            "version": 2,
            "positions": [{"at": place} for place in places],
        }
        (folder / f"{name}.json").write_text(json.dumps(layout))
    eye = {"name": "above", "position": [0, 0, 1], "look_at": [0, 0, 0]}
    cell = {"format": "learn2assemble-layout", "version": 2, "base": {"position": [0, -0.5, 0]}}
    cells = {
        "cell": [eye],
        "cell_twice": [eye, eye],
        "cell_blind": [eye | {"resolution": [0, 0]}],
        "cell_noise": [eye | {"noise": {"floor": -1.0}}],
    }
    for name, eyes in cells.items():
        (folder / f"{name}.json").write_text(json.dumps(cell | {"cameras": eyes}))
    readings = {"format": "learn2assemble-readings", "version": 1}
    (folder / "no_readings.json").write_text(json.dumps(readings))
    touches = [{"joints": [0.0] * 6}, {"tip": [0, 0, 0]}]
    (folder / "readings.json").write_text(json.dumps(readings | {"touches": touches}))
    (folder / "special").mkdir()
    (folder / "special" / "link").symlink_to(folder / "file.txt")
    (folder / "special" / "nowhere").symlink_to(folder / "nosuch.txt")
    os.mkfifo(folder / "special" / "pipe")
    for name in ("linked", "page", "figures"):
        (folder / "special" / name).mkdir()
    (folder / "special" / "linked" / "tables.md").symlink_to(folder / "file.txt")
    (folder / "special" / "page" / "tables.md").write_text("# Mine\n")
    (folder / "special" / "figures" / "tables.csv").write_text("a,b\n1,2\n")
    shutil.copytree(run, folder / "linked")
    (folder / "linked" / "extra.txt").symlink_to(folder / "file.txt")
    (folder / "full").mkdir()
    (folder / "full" / "keep.txt").write_text("mine")
    for name in ("bad_agent", "half_agent"):
        shutil.copytree(agent, folder / name)
    (folder / "bad_agent" / "agent.safetensors").write_bytes(b"damaged" * 20)
    half = folder / "half_agent" / "agent.safetensors"
    half.write_bytes(bare_weights(half))
    for name in ("bad_config", "bad_state", "no_state"):
        shutil.copytree(run, folder / name)
    (folder / "bad_config" / "config.json").write_text("{")
    (folder / "bad_state" / "state.safetensors").write_bytes(b"damaged" * 20)
    (folder / "no_state" / "state.safetensors").unlink()
    (folder / "not_json.jsonl").write_text("{]\n")
    (folder / "list.jsonl").write_text("[1, 2]\n")
    (folder / "robot.jsonl").write_text('{"variant": "3robo", "ep": 0, "t": 0}\n')
    (folder / "empty.jsonl").write_text("")
    (folder / "not_gzip.jsonl.gz").write_bytes(b"plain text")
    (folder / "runs.jsonl.gz").write_bytes(gzip.compress(b""))
    (folder / "other_lines.jsonl.gz").write_bytes(gzip.compress(b'{"name": "dqn-s0", "a": 1}\n'))
    # Valid framing around damaged contents.
    packed = bytearray(gzip.compress(b'{"a": 1}\n' * 1000))
    packed[20] ^= 0xFF
    packed[25] ^= 0xFF
    (folder / "damaged.jsonl.gz").write_bytes(bytes(packed))
    (folder / "plan_of_others.json").write_text(json.dumps({"format": "other"}))
    (folder / "empty_plan.json").write_text(
        json.dumps({"format": "learn2assemble-plan", "version": 3})
    )
    (folder / "list.json").write_text("[]")


CALIBRATE = ["--readings", "{d}/readings.json"]
BAD = [
    BadCall(
        "calibrate without readings",
        ["calibrate", "{d}/cell.json", "--readings", "{d}/no_readings.json"],
        "no readings",
    ),
    BadCall("calibrate without the arm", ["calibrate", "{d}/cell.json", *CALIBRATE], "arm"),
    BadCall(
        "calibrate with another arm",
        ["calibrate", "{d}/cell.json", *CALIBRATE, "--arm", "panda"],
        "7 angles of panda",
    ),
    BadCall(
        "calibrate two cameras of one name",
        ["calibrate", "{d}/cell_twice.json", *CALIBRATE],
        "cameras[1].name",
    ),
    BadCall(
        "calibrate a camera without pixels",
        ["calibrate", "{d}/cell_blind.json", *CALIBRATE],
        "cameras[0].resolution",
    ),
    BadCall(
        "calibrate a camera of negative noise",
        ["calibrate", "{d}/cell_noise.json", *CALIBRATE],
        "cameras[0].noise.floor",
    ),
    BadCall(
        "calibrate a layout without a base",
        ["calibrate", "{d}/layout.json", *CALIBRATE],
        "base",
    ),
    BadCall(
        "calibrate with a layout for readings",
        ["calibrate", "{d}/cell.json", "--readings", "{d}/cell.json"],
        "learn2assemble-readings",
    ),
    BadCall(
        "calibrate into a folder",
        ["calibrate", "{d}/cell.json", *CALIBRATE, "--arm", "ur5e", "--out", "{d}/full"],
        "layout",
    ),
    # The command itself.
    BadCall("no command", [], "COMMAND"),
    BadCall("misspelt command", ["buidl"], "did you mean 'build'"),
    BadCall("unknown command", ["qqqq"], "command: got"),
    BadCall("unknown option", ["tasks", "--colour"], "--colour"),
    BadCall("tasks with a word", ["tasks", "all"], "all"),
    BadCall("a name that is not UTF-8", ["build", "caf\udce9.json", "--out", "{d}/new"], "UTF-8"),
    BadCall(
        "export into a pipe",
        ["export", "{d}", "--format", "glb", "--out", "{d}/special/pipe"],
        "not a pipe",
    ),
    BadCall(
        "export through a link",
        ["export", "{d}", "--format", "csv", "--out", "{d}/special/link"],
        "not a symbolic link",
    ),
    BadCall(
        "export through a link to nowhere",
        ["export", "{d}", "--format", "bill", "--out", "{d}/special/nowhere"],
        "not a symbolic link",
    ),
    BadCall(
        "a task by the exact planner",
        ["build", TASK, "--planner", "exact", "--out", "{d}/new"],
        "agent, for the task",
    ),
    BadCall("build into a link to nowhere", build("--out", "{d}/special/nowhere"), "nowhere"),
    BadCall("resume a run with a link in it", resume("{d}/linked"), "not a symbolic link"),
    BadCall(
        "eval through a link to nowhere",
        evaluate("--out", "{d}/special/nowhere"),
        "a new one, not a symbolic link",
    ),
    # build
    BadCall("check nothing", ["check"], "FILE"),
    BadCall("check a missing file", ["check", "{d}/nosuch.json"], "nosuch.json"),
    BadCall("check a design", ["check", "{d}/design.json"], "design.json"),
    BadCall("check a text", ["check", "{d}/file.txt"], "file.txt"),
    BadCall(
        "check with negative friction",
        ["check", "{d}/design.json", "--friction", "-1"],
        "coefficient of friction",
    ),
    BadCall(
        "check a mesh without a unit",
        ["check", ARCH],
        f"unit: got None, expected mm, cm, m or in: {ARCH} does not say it",
    ),
    BadCall("check a mesh on its edge", ["check", ARCH, "--unit", "mm", "--up", "w"], "--up"),
    BadCall(
        "check blocks whose unit is known",
        ["check", WALL, "--unit", "mm"],
        "unit: got 'mm', expected none",
    ),
    BadCall(
        "build blocks whose unit is known",
        ["build", WALL, "--out", "{d}/new", "--unit", "mm"],
        "unit: got 'mm', expected none",
    ),
    BadCall(
        "build blocks of another size",
        ["build", WALL, "--out", "{d}/new", "--size", "2"],
        "size: got 2.0, expected none",
    ),
    BadCall(
        "check blocks that are upright", ["check", WALL, "--up", "y"], "up: got 'y', expected none"
    ),
    BadCall(
        "check bricks with a unit",
        ["check", "{d}/bricks/good.txt", "--unit", "mm"],
        "unit: got 'mm', expected none",
    ),
    BadCall(
        "check bricks with friction",
        ["check", "{d}/bricks/good.txt", "--friction", "0.5"],
        "friction: got 0.5, expected none: bricks that clutch",
    ),
    BadCall(
        "a video of nobody",
        ["build", "{d}/design.json", "--out", "{d}/new", "--video"],
        "--video: got 'no arm'",
    ),
    BadCall(
        "a video of a cell in which nothing moves",
        exact_arm("--physics", "kinematic", "--video"),
        "--video: got 'a cell in which nothing moves'",
    ),
    BadCall(
        "noise where two arms are only planned for",
        exact_arm("--arm", "ur5e", "--physics", "kinematic", "--sense-noise", "0.5"),
        "noise: got (0.0005, 0.0), expected none",
    ),
    BadCall(
        "blocks for two hands of which one brings",
        ["build", WALL, "--out", "{d}/new", *TWO, "--holds", "2"],
        "holds: got 2, expected 0 or 1 with two arms",
    ),
    BadCall(
        "hands for blocks without studs, with two arms",
        ["build", WALL, "--out", "{d}/new", *TWO, "--hands"],
        "hands: got True, expected bricks that clutch",
    ),
    BadCall(
        "bricks that an arm of two shall hold",
        [
            "build",
            "{d}/bricks/good.txt",
            "--kit",
            "duplo",
            "--out",
            "{d}/new",
            *TWO,
            "--holds",
            "1",
        ],
        "holds: got 1, expected none of bricks",
    ),
    BadCall(
        "mortar with two arms",
        exact_arm("--arm", "ur5e", "--kit", "bricks-mortar"),
        "kit: got 'bricks-mortar', expected dry blocks or bricks",
    ),
    BadCall(
        "more blocks in hands than are looked for",
        ["build", WALL, "--out", "{d}/new", "--holds", "9"],
        "holds: got 9, expected a whole number from 0 to 8",
    ),
    BadCall(
        "no props and props",
        ["build", "{d}/design.json", "--out", "{d}/new", "--no-props", "--supports", "props"],
        "not allowed with argument",
    ),
    BadCall("run nothing", ["run"], "PLAN"),
    BadCall("run a missing plan", ["run", "{d}/nosuch"], "nosuch"),
    BadCall("run a folder without a plan", ["run", "{d}/full"], "plan.json"),
    BadCall("run without a scheme", ["run", "{d}", "--robot", "192.168.0.2"], "sim://"),
    BadCall(
        "run with a misspelt scheme", ["run", "{d}", "--robot", "ros://host"], "did you mean 'ros2'"
    ),
    BadCall("run at no speed", ["run", "{d}", "--speed", "0%"], "30%"),
    BadCall("run faster than planned", ["run", "{d}", "--speed", "1.5"], "30%"),
    BadCall("run until nobody knows when", ["run", "{d}", "--until", "x"], "--until"),
    BadCall("run by step and until", ["run", "{d}", "--step", "--until", "3"], "one of the two"),
    BadCall("resume a run that is not", ["run", "{d}/full", "--resume"], "run.jsonl"),
    BadCall("run in a missing layout", ["run", "{d}", "--layout", "{d}/nosuch"], "nosuch"),
    BadCall("export nothing", ["export"], "PLAN"),
    BadCall("export to an unknown format", ["export", "{d}", "--format", "glbb"], "'glb'"),
    BadCall("export a folder without a plan", ["export", "{d}/full", "--format", "glb"], "full"),
    BadCall(
        "export a folder as a program", ["export", "{d}/full", "--format", "csv"], "with an arm"
    ),
    BadCall(
        "export with a layout that no GLB needs",
        ["export", "{d}", "--format", "glb", "--layout", "{d}/design.json"],
        "--layout",
    ),
    BadCall(
        "export a table from a step on",
        ["export", "{d}", "--format", "csv", "--resume-from", "2"],
        "resume",
    ),
    BadCall(
        "export with a layout that is none",
        ["export", "{d}", "--format", "urscript", "--layout", "{d}/design.json"],
        "format",
    ),
    BadCall(
        "export a design as a program",
        ["export", "{d}/design.json", "--format", "ros2"],
        "trajectory",
    ),
    BadCall("an arm of no file", ["add-arm", "{d}/nosuch.urdf", "--out", "{d}/new"], "nosuch"),
    BadCall("an arm of a design", ["add-arm", "{d}/design.json", "--out", "{d}/new"], "a URDF"),
    BadCall("an arm without a place", ["add-arm", "{d}/design.json"], "--out"),
    BadCall(
        "replay no program", ["replay-trajectory", "{d}/nosuch.csv", "--arm", "panda"], "nosuch"
    ),
    BadCall(
        "replay a design", ["replay-trajectory", "{d}/design.json", "--arm", "panda"], "header"
    ),
    BadCall("replay a build", ["replay-trajectory", "{d}/full", "--arm", "panda"], "l2a export"),
    *(
        BadCall(
            f"replay {name} of a build",
            ["replay-trajectory", f"{{d}}/{name}", "--arm", "panda"],
            "of the build itself', expected a program, which l2a export makes",
        )
        for name in ("trajectory.json", "trajectory.csv", "trajectory-1.json", "plan.json")
    ),
    *(
        BadCall(
            f"replay a table with {name}",
            ["replay-trajectory", f"{{d}}/{name}.csv", "--arm", "ur5e"],
            "limits" if name == "no_limits" else "rate",
        )
        for name in PROGRAM_RATES
    ),
    BadCall("replay without an arm", ["replay-trajectory", "{d}/design.json"], "--arm"),
    BadCall(
        "replay with an unknown arm",
        ["replay-trajectory", "{d}/design.json", "--arm", "pandas"],
        "'panda'",
    ),
    BadCall("export a design", ["export", "{d}/design.json", "--format", "glb"], "design.json"),
    BadCall("build nothing", ["build", "--out", "{d}/new"], "DESIGN"),
    BadCall("build without --out", ["build", "{d}/design.json"], "--out"),
    BadCall("no name as design", ["build", "", *build()[2:]], "error"),
    BadCall("another file as design", ["build", "{d}/list.json", "--out", "{d}/new"], "list.json"),
    BadCall("a text as design", ["build", "{d}/file.txt", "--out", "{d}/new"], "file.txt"),
    # blocks that are given
    *(
        BadCall(f"check blocks: {name}", ["check", f"{{d}}/blocks/{name}.json"], words)
        for name, words in BLOCKS.items()
    ),
    *(BadCall(f"build blocks: {name}", given(name), words) for name, words in BLOCKS.items()),
    BadCall(
        "an arm for blocks that overlap", given("overlap", "--arm", "ur5e"), "blocks that only"
    ),
    BadCall("a prop in the air", given("loose"), "b0 in the air"),
    BadCall(
        "a prop in the air, held", given("loose", "--supports", "posts", "--holds", "1"), "b0 in"
    ),
    BadCall("holds of 0 for blocks", given("loose", "--holds", "0"), "a whole number from 1"),
    BadCall("props for blocks", given("loose", "--supports", "props"), "given blocks have no kit"),
    # reading
    BadCall("an empty array", read("empty.npy"), "shape [0, 3, 3]"),
    BadCall("an array of 65 cells each way", read("wide.npy"), "shape [65, 65, 65]"),
    BadCall("an array of NaN", read("nan.npy"), "a value nan"),
    BadCall("an array of complex numbers", read("complex.npy"), "complex numbers"),
    BadCall("an array of objects", read("object.npy"), "never unpickled"),
    BadCall("an array of grey values", read("grey.npy"), "a value 255"),
    BadCall("an array of words", read("words.npy"), "no numbers"),
    BadCall("an array of two axes", read("flat.npy"), "shape [5, 5]"),
    BadCall("an archive that unpacks to far more", read("bomb.npz"), "160000000 values"),
    BadCall("a JPEG that is cut short", read("cut.jpg"), "a whole JPEG picture"),
    BadCall("a JPEG of 65535 pixels each way", read("huge.jpg"), "65535 x 65535 pixels"),
    BadCall("a WebP that is cut short", read("cut.webp"), "a whole WEBP picture"),
    BadCall(
        "an OFF with fewer faces than it says", read("short.off", "--unit", "m"), "a whole mesh"
    ),
    BadCall(
        "an OFF that promises too much",
        read("promise.off", "--unit", "m"),
        "1000000000003 vertices and faces",
    ),
    BadCall(
        "a mesh with a large hole", read("open.off", "--unit", "m", "--repair"), "an open mesh"
    ),
    BadCall("a mesh without a unit", read("units.off"), "--unit mm gives 6 × 6 × 6 cells"),
    BadCall(
        "a mesh in too large a unit",
        read("units.off", "--unit", "m"),
        "--unit mm gives 6 × 6 × 6 cells",
    ),
    BadCall("a wrong unit", read("units.off", "--unit", "ml"), "one of cm, in, m, mm"),
    BadCall("a unit for an array", read("flat.npy", "--unit", "mm"), "no such option for NPY"),
    BadCall(
        "repair for a drawing",
        ["build", "{d}/design.json", "--out", "{d}/new", "--repair"],
        "no such option for JSON",
    ),
    BadCall(
        "a preview of a task", ["build", TASK, "--preview", "{d}/new.png"], "a design of cells"
    ),
    BadCall(
        "a preview of a text", ["build", "{d}/file.txt", "--preview", "{d}/new.png"], "file.txt"
    ),
    BadCall(
        "a preview and a build",
        ["build", "{d}/design.json", "--out", "{d}/new", "--preview", "{d}/new.png"],
        "not allowed with",
    ),
    BadCall(
        "a preview into a folder", ["build", "{d}/design.json", "--preview", "{d}/full"], "full"
    ),
    BadCall(
        "a preview into no folder",
        ["build", "{d}/design.json", "--preview", "{d}/nosuch/new.png"],
        "nosuch",
    ),
    BadCall("build into a full folder", build("--out", "{d}/full"), "name another one or empty"),
    BadCall("build into a file", build("--out", "{d}/file.txt"), "a new or empty folder"),
    BadCall("build below a file", build("--out", "{d}/file.txt/new"), "a place that can be"),
    BadCall("build into a long name", build("--out", "{d}/" + LONG), "out"),
    BadCall(
        "joints that an arm does not lay",
        ["build", "{d}/design.json", "--out", "{d}/new", "--arm", "panda", "--gap", "1mm"],
        "none with an arm, which lays joints of 0.0001 m",
    ),
    BadCall("build for no time", build("--seconds", "0"), "a number from 0.001"),
    BadCall("build for negative time", build("--seconds", "-5"), "a number from 0.001"),
    BadCall("build for nan seconds", build("--seconds", "nan"), "a number from 0.001"),
    BadCall("build for ever", build("--seconds", "inf"), "a number from 0.001"),
    BadCall(
        "unknown arm", exact_arm("--arm", "pandas"), "arm: got 'pandas', expected one of panda"
    ),
    BadCall("unknown arm for a task", build("--arm", "pandas"), "arm: got 'pandas'"),
    BadCall(
        "agent of another kind for an arm",
        ["build", "robot-two-sided-3x3-10-14", *build()[2:]],
        "network.num_actions",
    ),
    BadCall(
        "objects by an arm",
        ["build", "robot-objects-two-sided-5x5-20-24", "--out", "{d}/new"],
        "one of cubes",
    ),
    BadCall(
        "agent for the exact planner",
        [
            "build",
            "{d}/design.json",
            "--out",
            "{d}/new",
            "--planner",
            "exact",
            "--agent",
            "builder-s0",
        ],
        "none with the exact planner",
    ),
    BadCall("exact planner for a task", build("--planner", "exact"), "planner"),
    BadCall("kit for a task", build("--kit", "bricks"), "kit: got"),
    BadCall(
        "arm for a task without",
        ["build", TASK, *build()[2:], "--arm", "panda"],
        "a task with a robot",
    ),
    BadCall(
        "layout without an arm",
        ["build", "{d}/design.json", "--out", "{d}/new", "--layout", "{d}/layout.json"],
        "--arm",
    ),
    BadCall(
        "layout for a preset",
        ["build", "robot-two-sided-3x3-10-14", *build()[2:], "--layout", "{d}/layout.json"],
        "a design",
    ),
    BadCall("missing layout", exact_arm("--layout", "{d}/no.json"), "no such file"),
    BadCall(
        "layout that is a design", exact_arm("--layout", "{d}/design.json"), "learn2assemble-layout"
    ),
    BadCall("reach without an arm", ["reach", "{d}/design.json"], "--arm"),
    BadCall("reach of a missing file", ["reach", "{d}/nosuch.svg", "--arm", "panda"], "nosuch"),
    BadCall("reach of an unknown arm", ["reach", "{d}/design.json", "--arm", "pandas"], "arm: got"),
    BadCall(
        "reach with an unknown tool",
        ["reach", "{d}/design.json", "--arm", "panda", "--tool", "claw"],
        "tool: got 'claw'",
    ),
    BadCall("reach of a task", ["reach", TASK, "--arm", "panda"], "expected a design"),
    BadCall(
        "cells without extent",
        ["build", "{d}/design.json", "--out", "{d}/new", "--cell", "0"],
        "--cell: got '0', expected a length above 0",
    ),
    BadCall(
        "cells with two edges",
        ["build", "{d}/design.json", "--out", "{d}/new", "--cell", "80x120mm"],
        "--cell: got '80x120mm', expected one length or three, such as 50mm or 80x120x30mm",
    ),
    BadCall(
        "misspelt option",
        ["build", "{d}/design.json", "--out", "{d}/new", "--cels", "1"],
        "did you mean --cell?",
    ),
    BadCall("option of another command", ["eval", TASK, "--kit", "cubes"], "see l2a eval --help"),
    BadCall("check a folder without a plan", ["check", "{d}/full"], "assembly.json"),
    BadCall("unknown tool", exact_arm("--tool", "claw"), "tool: got 'claw'"),
    BadCall(
        "tool without an arm",
        ["build", "{d}/design.json", "--out", "{d}/new", "--tool", "suction"],
        "--arm",
    ),
    BadCall("unknown physics", exact_arm("--physics", "static"), "physics: got 'static'"),
    BadCall("noise in words", exact_arm("--sense-noise", "little"), "millimetres"),
    BadCall("resume a build that never began", exact_arm("--resume"), "build, to --resume"),
    BadCall(
        "layout out of reach", exact_arm("--layout", "{d}/far.json"), "a place panda can reach"
    ),
    BadCall(
        "layout with an overlap",
        exact_arm("--layout", "{d}/overlap.json"),
        "does not overlap positions[0]",
    ),
    BadCall("negative seed", build("--seed", "-1"), "a whole number"),
    BadCall("half a seed", build("--seed", "1.5"), "a whole number"),
    BadCall("unknown agent", build("--agent", "nobody"), "agent"),
    BadCall("missing agent file", build("--agent", "{d}/no.safetensors"), "no such file"),
    BadCall("folder without agent", build("--agent", "{d}/full"), "no such file"),
    BadCall("damaged agent", build("--agent", "{d}/bad_agent"), "a trained agent"),
    BadCall("half an agent", build("--agent", "{d}/half_agent"), "no description"),
    BadCall("a long name as agent", build("--agent", LONG), "File name too long"),
    # train
    BadCall("train nothing", ["train", "--out", "{d}/new"], "TASK"),
    BadCall("train without --out", ["train", TASK], "--out"),
    BadCall(
        "misspelt task",
        ["train", "one-sided-3x3-22-25", *train()[2:]],
        "did you mean 'one-sided-3x3-22-24'",
    ),
    BadCall("misspelt configuration", train("--config", "papre"), "did you mean 'paper'"),
    BadCall("unknown method", train("--method", "ppo"), "one of dqn, eps-mcts, q-mcts"),
    BadCall(
        "train into a full folder",
        train("--out", "{d}/full"),
        "empty this one or go on with --resume",
    ),
    BadCall("train into a file", train("--out", "{d}/file.txt"), "a new or empty folder"),
    BadCall("train below a file", train("--out", "{d}/file.txt/new"), "a place that can be"),
    BadCall("train over a run", train("--out", "{d}/run"), "--resume"),
    BadCall(
        "train for nan minutes",
        ["train", TASK, "--out", "{d}/new", "--minutes", "nan"],
        "a number from 0.001",
    ),
    BadCall(
        "train for negative minutes",
        ["train", TASK, "--out", "{d}/new", "--minutes", "-1"],
        "a number from 0.001",
    ),
    BadCall(
        "no hand that holds",
        ["build", "{d}/design.json", "--out", "{d}/new", "--holds", "0"],
        "a whole number from 1",
    ),
    BadCall("no samples", train("--samples", "0"), "a whole number from 1"),
    BadCall("a word as samples", train("--samples", "many"), "a whole number from 1"),
    BadCall("unknown device", train("--device", "gpu"), "auto, cpu or cuda"),
    BadCall("no threads", train("--threads", "0"), "a whole number from 1"),
    BadCall("--set without a value", train("--set", "learning_rate"), "KEY=VALUE"),
    BadCall("--set misspelt", train("--set", "lerning_rate=1"), "did you mean 'learning_rate'"),
    BadCall(
        "--set misspelt in the network", train("--set", "network.head=1"), "did you mean 'heads'"
    ),
    BadCall("--set a word for a number", train("--set", "learning_rate=fast"), "a value like"),
    BadCall("--set nan", train("--set", "learning_rate=nan"), "a rate between 0 and 1"),
    BadCall("--set a negative number", train("--set", "batch_size=-1"), "a whole number from 1"),
    BadCall("--set heads that do not divide", train("--set", "network.heads=3"), "a divisor"),
    BadCall("--set no heads", train("--set", "network.heads=0"), "heads"),
    BadCall("--set negative heads", train("--set", "network.heads=-1"), "heads"),
    BadCall("--set physics misspelt", train("--set", "physics=sttic"), "did you mean 'static'"),
    BadCall("--set a whole network", train("--set", "network=large"), "settings"),
    BadCall("--set a nan weight", train("--set", "dense_weight=nan"), "dense_weight"),
    BadCall(
        "--set labels for a published network",
        train("--set", "dense_weight=1"),
        "0 unless encoder is relational",
    ),
    BadCall(
        "--set symmetries of our own network",
        train("--set", "network.encoder=relational"),
        "augment",
    ),
    BadCall("train into a long name", train("--out", "{d}/" + LONG), "File name too long"),
    BadCall("start from an unknown agent", train("--init", "nobody"), "agent"),
    BadCall("start from a damaged agent", train("--init", "{d}/bad_agent"), "a trained agent"),
    BadCall("start from another architecture", train("--init", "{d}/agent"), "init"),
    BadCall(
        "start from an agent and resume",
        resume("{d}/run", "--init", "{d}/agent"),
        "not together with --resume",
    ),
    BadCall("resume nothing", resume("{d}/nosuch"), "--resume"),
    BadCall("resume a folder that is no run", resume("{d}/full"), "the folder of a training run"),
    BadCall("resume a run without its state", resume("{d}/no_state"), "state.safetensors"),
    BadCall("resume a damaged configuration", resume("{d}/bad_config"), "the folder of a"),
    BadCall("resume a damaged state", resume("{d}/bad_state"), "undamaged"),
    BadCall(
        "resume with another task",
        resume("{d}/run", task="two-sided-3x3-20-24"),
        "the task of the run",
    ),
    BadCall("resume with --set", resume("{d}/run", "--set", "batch_size=8"), "own configuration"),
    BadCall("resume with --seed", resume("{d}/run", "--seed", "0"), "own configuration"),
    BadCall("a network of gigabytes", train("--set", "network.width=1000000"), "1 to 4096"),
    BadCall("a memory of terabytes", train("--set", "replay_size=1000000000000"), "1 to 10000000"),
    BadCall("resume with --samples", resume("{d}/run", "--samples", "99"), "own configuration"),
    # table and curves
    BadCall("workers of one training", train("--workers", "3"), "--workers: got 3, expected none"),
    BadCall("agents by name alone", ["agents", "dqn-s0"], "fetch"),
    BadCall(
        "agents listed by name",
        ["agents", "list", "dqn-s0"],
        "got 'dqn-s0', expected none with list",
    ),
    BadCall("a misspelt agent fetched", ["agents", "fetch", "dqn-so"], "dqn-s0"),
    BadCall(
        "agents of a folder there is not",
        ["agents", "fetch", "dqn-s0", "--from", "{d}/nosuch"],
        "a file there",
    ),
    BadCall("agents of no release", ["agents", "fetch"], "no release carries them"),
    BadCall("a misspelt task shown", ["demonstrate", "two-sided-3x3-20-42"], "two-sided-3x3-20-24"),
    BadCall(
        "a design shown by an agent",
        ["demonstrate", "designs-cubes-60", "--agent", "dqn-s0", "--out", "{d}/new"],
        "as the exact planner builds it",
    ),
    BadCall(
        "data sets into a file",
        ["demonstrate", "two-sided-3x3-20-24", "--episodes", "1", "--out", "{d}/file.txt"],
        "writable",
    ),
    BadCall("no episodes shown", ["demonstrate", "designs-cubes-60", "--episodes", "0"], "from 1"),
    # eval
    BadCall("eval nothing", ["eval"], "TASK"),
    BadCall("eval a misspelt task", ["eval", "two-sided-4x4-20-30"], "did you mean"),
    BadCall("eval an unknown agent", evaluate("--agent", "nobody"), "agent"),
    BadCall("eval a damaged agent", evaluate("--agent", "{d}/bad_agent"), "a trained agent"),
    BadCall("eval with unknown physics", evaluate("--physics", "rigd"), "did you mean 'rigid'"),
    BadCall("eval with unknown search", evaluate("--search", "dfs"), "invalid choice"),
    BadCall("eval with misspelt search", evaluate("--search", "mtcs"), "did you mean 'mcts'"),
    BadCall("negative budget", evaluate("--budget", "-1"), "a whole number from 0"),
    BadCall("no rollout", evaluate("--rollout", "0"), "a whole number from 1"),
    BadCall("a word as rollout", evaluate("--rollout", "forever"), "a whole number from 1"),
    BadCall("epsilon beyond 1", evaluate("--epsilon", "1.5"), "a number from 0 to 1"),
    BadCall("nan epsilon", evaluate("--epsilon", "nan"), "a number from 0 to 1"),
    BadCall("no episodes", evaluate("--episodes", "0"), "a whole number from 1"),
    BadCall("eval with a negative seed", evaluate("--seed", "-3"), "a whole number"),
    BadCall("eval over a file", evaluate("--out", "{d}/file.txt"), "a new file"),
    BadCall("eval over a folder", evaluate("--out", "{d}/full"), "a new one, not a folder"),
    BadCall(
        "eval below a file",
        evaluate("--out", "{d}/file.txt/new.json"),
        "a place that can be written",
    ),
    BadCall(
        "eval into no folder",
        evaluate("--out", "{d}/nosuch/new.json"),
        "a place that can be written",
    ),
    BadCall("eval into a long name", evaluate("--out", "{d}/" + LONG), "--out"),
    # replay
    # bench
    BadCall(
        "a search without simulations",
        evaluate("--search", "mcts", "--budget", "0"),
        "at least 1 simulation",
    ),
    BadCall("a misspelt file", ["check", "{d}/desing.json"], "design.json'"),
    BadCall("budget without a search", ["eval", TASK, "--budget", "10"], "a search beside it"),
    BadCall(
        "looking ahead without a search",
        ["eval", TASK, "--look-ahead", "rigid"],
        "a search beside it",
    ),
    BadCall("restore faults without a search", ["eval", TASK, "--legacy"], "got '--search none'"),
    BadCall("seed of 400 digits", ["eval", TASK, "--seed", "1" * 400], "from 0 to 2147483647"),
    BadCall(
        "physics without an arm",
        ["build", "{d}/design.json", "--out", "{d}/another", "--physics", "kinematic"],
        "an arm",
    ),
    BadCall(
        "noise without an arm",
        ["build", "{d}/design.json", "--out", "{d}/another", "--sense-noise", "5"],
        "an arm",
    ),
    BadCall("bench of what is not measured", ["bench", "check_ms"], "check_s"),
    BadCall("bench for no time", ["bench", "--seconds", "0"], "a number from 0.001"),
    BadCall("bench for ever", ["bench", "--seconds", "inf"], "a number from 0.001"),
    BadCall("bench for a word", ["bench", "--seconds", "soon"], "a number from 0.001"),
    # benchmark
    BadCall("benchmark of nothing", ["benchmark", "check"], "FILE"),
    BadCall(
        "benchmark of a missing file", ["benchmark", "check", "{d}/nosuch.jsonl.gz"], "no such"
    ),
    BadCall("benchmark of a text", ["benchmark", "board", "{d}/file.txt"], "file.txt"),
    BadCall(
        "benchmark of no problems",
        ["benchmark", "run", "{d}/x.jsonl.gz", "--policy", "random", "--problems", "0"],
        "a whole number from 1",
    ),
    BadCall(
        "benchmark by nobody",
        ["benchmark", "run", "{d}/x.jsonl.gz", "--policy", "nosuch"],
        "nosuch",
    ),
    # view
    BadCall("view nothing", ["view"], "PLAN"),
    BadCall("view a missing plan", ["view", "{d}/nosuch"], "a plan.json or its folder"),
    BadCall("view a folder without a plan", ["view", "{d}/full"], "a plan.json or its folder"),
    BadCall(
        "view a text",
        ["view", "{d}/file.txt"],
        "another kind', expected plan.json or",
    ),
    BadCall("view below a file", ["view", "{d}/file.txt/plan.json"], "no such file"),
    BadCall("view another file", ["view", "{d}/plan_of_others.json"], "learn2assemble-plan"),
    BadCall(
        "view a list",
        ["view", "{d}/list.json"],
        "another kind', expected plan.json or",
    ),
    BadCall("view an empty plan", ["view", "{d}/empty_plan.json", "--no-browser"], "plan"),
    BadCall("no such port", ["view", "{d}/design.json", "--port", "70000"], "a port number"),
    BadCall("a word as port", ["view", "{d}/design.json", "--port", "http"], "a port number"),
    BadCall("view a long name", ["view", LONG], "File name too long"),
    # Names that are empty, as of a variable that is not set: the folder one is in is not meant.
    *(
        BadCall(f"an empty name for {words[0]} {words[-2]}", words, "the name of a file or folder")
        for words in (
            build("--out", ""),
            train("--out", ""),
            exact_arm("--layout", ""),
            evaluate("--out", ""),
            ["check", ""],
            ["check", "{d}/design.json", "--out", ""],
            ["reach", "{d}/design.json", "--arm", "panda", "--out", ""],
            ["export", "{d}", "--format", "glb", "--out", ""],
            ["view", "--no-browser", ""],
            ["replay-trajectory", "--arm", "panda", ""],
        )
    ),
    BadCall("a zero byte in a name", build("--out", "{d}/a\0b"), "zero byte"),
    # Nothing is worked out, or printed, for a folder that cannot be used.
    BadCall(
        "check into a full folder", ["check", WALL, "--out", "{d}/full"], "a new or empty folder"
    ),
    BadCall(
        "reach into a full folder",
        ["reach", "{d}/design.json", "--arm", "panda", "--out", "{d}/full"],
        "a new or empty folder",
    ),
    # Bricks that clutch.
    *(
        BadCall(f"bricks: {name}", ["check", f"{{d}}/bricks/{name}"], fragment)
        for name, (_, fragment) in BRICKS.items()
    ),
    *(
        BadCall(
            f"studs: {name}",
            ["check", "{d}/bricks/good.txt", "--kit", f"{{d}}/bricks/{name}.toml"],
            fragment,
        )
        for name, (_, fragment) in STUDS.items()
    ),
    *(
        BadCall(
            f"capacity {value}",
            ["check", "{d}/bricks/good.txt", "--kit", "duplo", "--capacity", value],
            "expected a force from 0 to 1000 N",
        )
        for value in ("-1", "nan", "1e99", "much")
    ),
    BadCall(
        "a cup for studs",
        [
            "build",
            "{d}/bricks/good.txt",
            "--out",
            "{d}/new",
            "--kit",
            "duplo",
            "--arm",
            "panda",
            "--tool",
            "suction",
        ],
        "a cup does not hold on studs",
    ),
    # Names that are misspelt.
    *(
        BadCall(f"a misspelt {what}", words, f"no such file', expected a {what}")
        for what, words in {
            "program": ["replay-trajectory", "{d}/rate_hihg.csv", "--arm", "ur5e"],
            "file or folder of an agent": evaluate("--agent", "{d}/agnet"),
            "file of an agent": evaluate("--agent", "{d}/agent/agnet.safetensors"),
            "folder of a build": ["export", "{d}/rnu", "--format", "csv"],
            "folder of a training run": resume("{d}/rnu"),
            "layout file": exact_arm("--layout", "{d}/layuot.json"),
            "kit file": ["build", "{d}/design.json", "--out", "{d}/new", "--kit", "{d}/kti.toml"],
        }.items()
    ),
    BadCall("a misspelt folder that was meant", resume("{d}/rnu"), "/run'?"),
    BadCall("a link to nowhere", ["check", "{d}/special/nowhere"], "a link to nowhere"),
]
