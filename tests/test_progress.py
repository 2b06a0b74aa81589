"""What is told while something takes long: the phase, the best so far and what time is left.

What is told of nonsense and of what an arm cannot do, as a stranger would read it.
"""

from __future__ import annotations

import html
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba import njit

import learn2assemble as l2a
from headless import Terminal
from learn2assemble import compiling, linear_programs, progress
from learn2assemble.acting import carry_out
from learn2assemble.acting.carry_out import Workcell
from learn2assemble.assembly.kit import load_kit
from learn2assemble.cli import main, output
from learn2assemble.cli.commands import _print_plan as print_plan
from learn2assemble.cli.output import Output
from learn2assemble.compiling import compiling_seconds
from learn2assemble.errors import as_both, as_options
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.reports import ArmFailure, ArmReport, BuilderArm
from learn2assemble.planning.tiling.exact import plan_exact
from learn2assemble.progress import Detail

KIT = load_kit("bricks-lintels")


def test_details_are_told_not_too_often_with_the_time_that_is_left() -> None:
    """By a stand-in clock."""
    now, told = [0.0], []
    clock = Clock(60.0, timer=lambda: now[0], progress=told.append)
    for second in range(5):
        now[0] = float(second)
        clock.tell(f"{second} steps")
    assert told == ["2 steps, at most 58 s left", "4 steps, at most 56 s left"]
    assert [line.what for line in told] == ["2 steps", "4 steps"]


def test_the_pace_of_steps_says_what_the_rest_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps of 3 s; one that has to be done again is as much more that is left."""
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    pace, told = progress.Pace(), []
    for left in (5, 4, 4, 3, 0):
        told.append(pace.about(left))
        now[0] += 3.0
    assert told == ["", ", about 12 s", ", about 24 s", ", about 14 s", ""]


def test_what_is_counted_is_told_with_an_estimate(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two seconds each, by a stand-in clock: nothing before the first is done."""
    now, told = [0.0], list[str]()
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    for item in progress.counted("abcde", "drawing", told.append):
        now[0] += 2.0 if item < "d" else 1.0
    assert told == [
        "drawing: 1 of 5, about 8 s left",
        "drawing: 2 of 5, about 6 s left",
        "drawing: 3 of 5, about 4 s left",
    ]
    assert all(isinstance(line, Detail) for line in told)


def test_compiling_uses_no_time_of_a_limit() -> None:
    """The first plan on a fresh machine compiles for longer than it plans."""
    started, before = time.monotonic(), compiling_seconds(time.monotonic)
    clock, still = Clock(60.0), Clock(60.0, timer=lambda: 0.0)
    assert njit(lambda x: x + 1.0)(2.0) == 3.0
    spent, compiled = clock.spent, compiling_seconds(time.monotonic) - before
    assert compiled > 0.0
    assert 0.0 <= spent <= time.monotonic() - started - compiled
    assert still.spent == 0.0


def test_compiling_is_told_with_the_time_it_is_part_of(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first run takes many times as long as the second one, and says why."""
    told = compiling.compiling_words
    assert told(41.52, 37.9) == "38 s of these compiling, once for this machine"
    assert told(55.9, 55.9).startswith("55 s of these "), "a part of it"
    assert told(1.6, 0.4) == told(0.5, 30.0) == "", "a second or less is not worth a line"
    compiling_seconds(time.monotonic)  # From now on it is watched.
    watched = compiling._watched()
    beat = output.Heartbeat("choosing blocks", 60.0)
    assert beat.words(beat.started + 5).startswith("l2a: choosing blocks ... 5 s, at most ")
    compiled = watched.spent[time.monotonic]
    monkeypatch.setitem(watched.spent, time.monotonic, compiled + 30.0)
    assert beat.words(beat.started + 35).endswith("choosing blocks ... 35 s, at most 55 s left")
    watched.begin()
    try:
        monkeypatch.setitem(watched._began, time.monotonic, time.monotonic() - 3)
        assert "l2a: compiling, once for this machine ... " in beat.words(beat.started + 38)
    finally:
        watched.end()
    said = list[str]()
    monkeypatch.setattr(linear_programs, "EVERY", 0.0)
    clock = Clock(60.0, progress=said.append)
    monkeypatch.setitem(watched.spent, time.monotonic, watched.spent[time.monotonic] + 12.0)
    clock.tell("level 2")
    clock.tell("level 3")
    assert "level 2 (compiled 12 s once for this machine; no limit counts it), at most " in said[0]
    assert said[1].startswith("level 3, at most "), "it is told once"


def told_of(monkeypatch: pytest.MonkeyPatch, wanted: np.ndarray, **options: object) -> list[str]:
    """Everything that the exact planner tells, however soon."""
    monkeypatch.setattr(linear_programs, "EVERY", 0.0)
    told: list[str] = []
    plan_exact(wanted, KIT, progress=told.append, **options)  # pyright: ignore[reportArgumentType]
    return told


def test_the_exact_planner_tells_its_phases_and_the_best_so_far(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told = told_of(monkeypatch, np.ones((6, 2, 5), bool))
    assert all(isinstance(line, Detail) and line.endswith(" s left") for line in told)
    assert any(line.startswith("choosing blocks: level 3 of 5, ") for line in told)
    proving = [line for line in told if line.startswith("proving the order: ")]
    steps = [int(line.split(": ")[1].split()[0]) for line in proving]
    assert steps == sorted(steps)
    assert steps[-1] >= 5
    assert "the weakest withstands 0.000 g" not in proving[-1]
    assert any(line.startswith("how wide joints may be: ") for line in told)


def test_tilings_and_props_that_are_tried_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    table = np.zeros((8, 4, 4), bool)
    table[:, :, 3] = True
    table[:2, :, :3] = True
    told = told_of(monkeypatch, table)
    assert any(line.startswith("tiling 1 of at most ") for line in told)
    wide = "looking for blocks that stand: tiling 1 of at most "
    assert any(line.startswith(wide) and " blocks fall" in line for line in told)
    bridge = np.zeros((6, 1, 3), bool)
    bridge[[0, -1], :, :2] = True
    bridge[:, :, 2] = True
    assert any("choosing props for " in line for line in told_of(monkeypatch, bridge))


def test_build_hands_details_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of designs and of goals."""
    monkeypatch.setattr(linear_programs, "EVERY", 0.0)
    told: list[str] = []
    l2a.build(np.ones((4, 2, 3), bool), progress=told.append)
    assert any(line.startswith("proving the order: ") for line in told)

    class Enough(Exception):
        pass

    def until_the_best_is_told(text: str) -> None:
        if "best so far: " in text:
            raise Enough

    with pytest.raises(Enough):
        l2a.build(
            Path("examples/goals/over_the_water.json"), seconds=20, progress=until_the_best_is_told
        )


def test_an_arm_tells_what_is_looked_for_and_how_far_that_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Every phase has its own name, also while another tool is tried."""
    monkeypatch.setattr(progress, "EVERY", 0.0)
    told: list[str] = []
    cells = np.zeros((6, 1, 3), bool)
    cells[:, 0, 0] = cells[1:4, 0, 1:] = True
    l2a.build(cells, arm="ur5e", physics="kinematic", progress=told.append)
    phases = [line for line in told if not isinstance(line, Detail)]
    assert phases == [
        "choosing blocks and proving their order",
        "looking where the arm stands and where blocks wait",
        "looking for an order that the arm can do",
        "moving the blocks",
    ]
    for what in (
        "kinds of blocks with a place to wait: 1 of ",
        "steps in an order that the arm can do: 1 of ",
        "attempt 1: ",
    ):
        assert any(line.startswith(what) for line in told), what
    told.clear()
    monkeypatch.setattr(carry_out, "with_other_tools", lambda *_: ["suction-side"])
    plan = l2a.build(cells)
    assert carry_out.advise(plan, Workcell("ur5e", "suction"), 1e-4, told.append)
    assert told[0] == "trying whether the arm does it with the tool suction-side"
    assert all(line.startswith("trying the tool suction-side: ") for line in told[1:])
    assert all(isinstance(line, Detail) for line in told[1:])
    assert len(told) > 3


def test_a_terminal_shows_details_in_the_line_that_beats(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = Terminal()
    monkeypatch.setattr(sys, "stderr", shown)
    monkeypatch.setattr(output, "QUIET", 0.0)
    with output.Heartbeat("working", 60.0) as beat:
        said = output.Output(False, beat)
        said.progress(Detail("12 steps", 50.0))
        assert "12 steps\n" not in shown.getvalue()
        while "l2a: 12 steps ... " not in shown.getvalue():
            time.sleep(0.01)
    assert "at most 50 s" not in shown.getvalue()  # The beat says what is left.


ROOT = Path(__file__).resolve().parents[1]
GATE = str(ROOT / "examples" / "designs" / "gate.svg")
BROKEN = (
    "<svg xmlns='http://www.w3.org/2000/svg' width='100mm' height='100mm' viewBox='0 0 100 100'>"
    "<path id='wall' d='M0 0h90v90h-90z L x'/></svg>"
)
LAYOUT = {"format": "learn2assemble-layout", "version": 2}


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """The one line in which a command is refused, and nothing before it."""
    try:
        code: Any = main(words)
    except SystemExit as left:
        code = left.code
    told = capsys.readouterr()
    assert code == 2
    (line,) = told.err.splitlines()
    assert line.startswith("l2a: error: ")
    return line


def test_values_that_mean_nothing_are_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("neg.toml").write_text("")
    Path("x.svg").write_text("<svg/>")
    out = ("--out", "new")
    assert "got 'gripper'" in refused(capsys, "build", GATE, "--tool", "gripper", *out)
    missing = refused(capsys, "build", GATE, "--kit", "missing.toml", *out)
    assert "no such file" in missing
    assert "neg.toml" not in missing  # It has the ending in common, and nothing else.
    Path("missng.svg").write_text("")
    assert "did you mean 'missng.svg'?" in refused(capsys, "build", "missing.svg", *out)
    assert "above 0" in refused(capsys, "build", GATE, "--depth", "-50", *out)
    assert "expected plan.json or its folder" in refused(capsys, "view", "x.svg")
    assert "a kit file, which is TOML" in refused(capsys, "build", GATE, "--kit", "x.svg", *out)
    assert "see l2a build --help" in refused(capsys, "build", GATE)
    Path("p.script").write_text("")
    words = ("replay-trajectory", "p.script", "--arm", "panda")
    assert "a URScript, which only a UR controller plays" in refused(capsys, *words)
    Path("old").mkdir()
    Path("old", "plan.json").write_text('{"status": "refused"}')
    words = ("export", "old", "--format", "urscript", "--out", "new")
    assert "old, which has no program: it is refused" in refused(capsys, *words)
    for name in ("karel", "wobble"):  # Like none of them.
        words = ("export", "old", "--format", name)
        assert "did you mean" not in refused(capsys, *words)
    with pytest.raises(l2a.InputError, match="got 5,"):
        l2a.build(5)  # type: ignore[arg-type]
    assert not Path("new").exists()


def test_a_broken_path_is_named(tmp_path: Path) -> None:
    """Which and where: of the first few, so that a drawing of a thousand is still one line."""
    file = tmp_path / "broken.svg"
    file.write_text(BROKEN)
    design = l2a.load_design(file)
    assert design.not_read is not None
    assert "1 path with an error (id='wall', letter 17: 'L x')" in design.not_read
    file.write_text(BROKEN.replace("</svg>", "<path d='M0 0 h1 x'/>" * 9 + "</svg>"))
    told = l2a.load_design(file).not_read
    assert told is not None
    assert "paths with an error" in told
    assert told.count("letter") <= 3


@pytest.mark.parametrize("arms", [["panda"], ["panda", "ur5e"]])
@pytest.mark.parametrize("layout", ["[]", '{"magazines": [{"kind": "nosuch", "at": [0.3, 0.3]}]}'])
def test_a_layout_is_read_before_blocks_are_chosen(
    arms: list[str], layout: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "cell.json"
    told = json.loads(layout)
    file.write_text(json.dumps(LAYOUT | told if told else told))
    words = [word for name in arms for word in ("--arm", name)]
    out = ("--out", str(tmp_path / "new"))
    assert "cell.json" in refused(capsys, "build", GATE, *words, "--layout", str(file), *out)


def test_what_the_arm_refuses_is_not_said_to_be_impossible(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Blocks were found, and none is placed: both are told, in the terminal and on the page."""
    plan = l2a.build(GATE)
    assert plan.not_placed == 0
    assert plan.assembly is not None
    refused = replace(
        plan,
        status="refused",
        reason="the arm cannot place block-3; with `tool=suction-side` there is an order",
        steps=(),
        coverage=0.0,
        blocks=replace(plan.blocks, used=0),
        assembly=replace(plan.assembly, steps=(), not_built=()),
        arms=(BuilderArm("panda", "panda", "suction", (0.0, -0.5, 0.0, 0.0), 10),),
    )
    found = len(plan.assembly.blocks)
    some = replace(refused, status="incomplete", steps=plan.steps[:3])
    assert (some.as_planned, some.not_placed, plan.as_planned) == (True, 0, False)
    assert refused.not_placed == found
    print_plan(Output(False), refused, {})
    told = capsys.readouterr().out
    assert f"refused by the arm: {found} blocks found, none placed" in told
    assert "cells, as planned: " in told
    refused.save(tmp_path)
    page = (tmp_path / "view.html").read_text(encoding="utf-8")
    assert "refused by the arm" in page
    both = "--tool suction-side / tool='suction-side'"
    assert both in html.unescape(page)
    assert both in str(l2a.load_plan(tmp_path).reason)


def test_of_the_kinematic_cell_no_times_and_errors_are_told(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Nothing moved there, and nothing could be off."""
    told: list[str] = []
    row = np.ones((2, 1, 1), bool)
    plan = l2a.build(row, arm="ur5e", physics="kinematic", progress=told.append)
    assert plan.arm is not None
    assert plan.arm.attempts == len(plan.steps)
    assert (plan.arm.seconds, plan.arm.error_mean, plan.arm.error_worst) == (None, None, None)
    print_plan(Output(False), plan, {})
    lines = capsys.readouterr().out.splitlines()
    assert f"{plan.arm.attempts} attempts (1.000 a step)" in lines
    assert not any("robot time" in line or "from their places" in line for line in lines)
    assert "starting the simulation" not in told


def test_a_summary_fits_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    """80 columns, with an arm and colours, too; files have nine lines more."""
    plan = l2a.build(GATE)
    assert plan.cells is not None
    base = (-0.125, -0.525, 0.0, 1.57)
    did = ArmReport("panda", 0.06, 120, (), 1169.0, "suction-wide", base, 12, 1.043, 2e-5, 3e-5)
    print_plan(
        Output(False), replace(plan, arm=did, cells=replace(plan.cells, other_colour=12)), {}
    )
    told = capsys.readouterr().out.splitlines()
    assert "120 attempts (1.043 a step), 1169 s of robot time" in told
    assert "cells in a block of another colour: 12" in told
    assert max(map(len, told)) <= 80, told
    assert len(told) <= 16
    failures = [
        ArmFailure(k, "dropped" if k % 3 else "unstable", "block 7", False) for k in range(9)
    ]
    many = replace(plan, arm=replace(did, failures=tuple(failures)))
    print_plan(Output(False), many, {})
    short = capsys.readouterr().out.splitlines()
    assert "more attempts that failed: 2 unstable, 4 dropped (--verbose shows each)" in short
    assert len(short) <= 19
    print_plan(Output(False, verbose=True), many, {})
    assert len(capsys.readouterr().out.splitlines()) == len(short) + 5


@pytest.mark.parametrize(
    "words",
    [
        ["build", GATE, "--arm", "ur5e", "--no-video", "--physics", "kinematic", "--out", "{d}/b"],
        ["build", GATE, "--preview", "{d}/p.png"],
        ["reach", GATE, "--arm", "ur5e", "--out", "{d}/r"],
        ["reach", GATE, "--arm", "panda", "--arm", "ur5e"],
        ["check", ROOT / "examples" / "structures" / "arch.obj", "--unit", "mm"],
    ],
)
def test_what_commands_say_fits_a_terminal(
    words: list[Any],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """80 columns; only the names of files may stick out."""
    monkeypatch.setenv("COLUMNS", "80")
    assert main([str(word).replace("{d}", str(tmp_path)) for word in words]) in (0, 1)
    told = capsys.readouterr().out.splitlines()
    assert told
    assert [line for line in told if len(line) > 80 and str(tmp_path) not in line] == []


def test_cells_larger_than_a_drawing_are_refused() -> None:
    """50, where 50mm was meant."""
    with pytest.raises(l2a.InputError, match="no cell of 50 x 50 x 50 m is half full"):
        l2a.build(GATE, cell=50.0)


def test_files_and_pages_say_both() -> None:
    text = "with `tool=suction-side` it does; `seconds=` gives more"
    assert as_options(text) == "with --tool suction-side it does; --seconds gives more"
    assert as_both(text) == (
        "with --tool suction-side / tool='suction-side' it does; --seconds / seconds= gives more"
    )
