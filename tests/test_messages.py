"""What is told of nonsense and of what an arm cannot do, as a stranger would read it."""

from __future__ import annotations

import html
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import learn2assemble as l2a
from learn2assemble.cli import main
from learn2assemble.cli.commands import _print_plan as print_plan
from learn2assemble.cli.output import Output
from learn2assemble.errors import as_both, as_options
from learn2assemble.planning.reports import BuilderArm

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
    with pytest.raises(l2a.InputError, match="got 5,"):
        l2a.build(5)  # type: ignore[arg-type]
    assert not Path("new").exists()


def test_a_broken_path_is_named(tmp_path: Path) -> None:
    """Which and where: of the first few, so that a drawing of a thousand is still one line."""
    file = tmp_path / "broken.svg"
    file.write_text(BROKEN)
    design = l2a.load_design(file)
    assert isinstance(design, l2a.CellDesign)
    assert design.not_read is not None
    assert "1 path with an error (id='wall', letter 17: 'L x')" in design.not_read
    file.write_text(BROKEN.replace("</svg>", "<path d='M0 0 h1 x'/>" * 9 + "</svg>"))
    design = l2a.load_design(file)
    assert isinstance(design, l2a.CellDesign)
    told = design.not_read
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
        reason="the arm cannot place block-3; a tool, `tool=suction-side`, may",
        steps=(),
        coverage=0.0,
        blocks=replace(plan.blocks, used=0),
        assembly=replace(plan.assembly, steps=(), not_built=()),
        arms=(BuilderArm("panda", "panda", "suction", (0.0, -0.5, 0.0, 0.0), 10),),
    )
    found = len(plan.assembly.blocks)
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


def test_files_and_pages_say_both() -> None:
    text = "a tool, `tool=suction-side`, may; `seconds=` gives more"
    assert as_options(text) == "a tool, --tool suction-side, may; --seconds gives more"
    assert as_both(text) == (
        "a tool, --tool suction-side / tool='suction-side', may; --seconds / seconds= gives more"
    )
