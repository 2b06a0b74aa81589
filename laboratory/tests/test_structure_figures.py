"""The figures of given blocks: measured once, kept, and told beside what was asked."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from l2a_lab import structures as figures
from l2a_lab.measured import measure
from l2a_lab.meshes import MESHES, mesh_table
from l2a_lab.states import count_states, every, largest_moves, opened, states_of, upright
from learn2assemble.assembly.blocks import Assembly, AssemblyStep, box_block
from learn2assemble.cli import main

ROOT = Path(__file__).parents[2]


def test_entries_are_measured_once_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "structures.json"
    call = ["measure-structures", "--out", str(out), "--only", "arch, 9 voussoirs"]
    assert main([*call, "--json"]) == 0
    rows = {what: got for what, _, got in json.loads(capsys.readouterr().out)["rows"]}
    assert "complete, 2 posts and 0 held" in rows["arch, 9 voussoirs"]
    assert "complete, 0 posts and 2 held" in rows["arch, 9 voussoirs, one hold"]
    kept = json.loads(out.read_text())
    names = {n for n in figures.names() if "arch, 9 voussoirs" in n}
    assert set(kept["entries"]) == names
    for name in ("arch, 9 voussoirs", "arch, 9 voussoirs, one hold"):
        one = kept["entries"][f"states/{name}"]
        assert one["simulated"] == one["states"] > 9
        assert one["largest_move_m"] <= figures.LIMIT
    monkeypatch.setattr(figures, "order_entry", lambda *_: pytest.fail("measured again"))
    assert measure(figures.FIGURES, out, only="order/arch, 9 voussoirs") == kept


def test_figures_are_told_with_what_is_missed() -> None:
    pile = {"status": "complete", "largest_move_m": 2e-4, "largest_move_all_faces_m": 5e-3}
    posts = {"status": "complete", "posts": 3}
    rows = figures.summary(
        {
            "pile/0": pile,
            "pile/11": {**pile, "status": "incomplete"},
            "posts/4": {**posts, "fewest_posts": 2},
            "posts/5": {**posts, "fewest_posts": 3},
            "posts/6": {**posts, "fewest_posts": None},
        }
    )
    told = {what: got for what, _, got in rows}
    assert told["piles"] == "1 of 2 with every state proven; not: 11"
    assert told["MuJoCo: piles"] == "0.200 mm at most; more in: none"
    assert told["MuJoCo: piles, all faces"] == "5.000 mm at most; more in: 0, 11"
    assert told["fewest posts"] == "1 of 2; not: 4"


def pair() -> Assembly:
    """A block on a prop, held while the prop goes: not to be built so, but to be counted."""
    blocks = (box_block("b", (0, 0, 1), (1, 1, 2)), box_block("p", (0, 0, 0), (1, 1, 1), prop=True))
    steps = [{"place": "p"}, {"place": "b"}, {"hold": "b"}, {"remove": "p"}, {"release": "b"}]
    return Assembly(blocks, tuple(AssemblyStep(**step) for step in steps))


def test_states_have_props_as_blocks_and_what_is_held_as_supports() -> None:
    states = list(states_of(pair()))
    assert count_states(pair()) == len(states)
    assert [[b.id for b in state.blocks] for state in states] == [["p"], ["b", "p"], ["b"], ["b"]]
    assert [[b.support for b in state.blocks] for state in states] == [
        [False],
        [True, False],
        [True],
        [False],
    ]
    assert not any(b.prop for state in states for b in state.blocks)
    moves = largest_moves(pair(), gap=0.0, seconds=0.5)
    assert max(moves[:3]) < 1e-5
    assert moves[3] > 0.5  # Nothing carries it any more.
    assert len(largest_moves(pair(), gap=0.0, seconds=0.01, most=2)) == 2


def test_faces_are_drawn_in_by_half_a_joint() -> None:
    wide, deep = (opened(pair(), 0.02, which) for which in (upright, every))
    for made, z in ((wide, (1.0, 2.0)), (deep, (1.01, 1.99))):
        ends = np.array([made.blocks[0].vertices.min(0), made.blocks[0].vertices.max(0)])
        np.testing.assert_allclose(ends, [[0.01, 0.01, z[0]], [0.99, 0.99, z[1]]], atol=1e-12)


def test_the_table_of_meshes_is_that_of_the_results() -> None:
    entries = json.loads((ROOT / "results" / "structures.json").read_text())["entries"]
    page = (ROOT / "docs" / "bricks.md").read_text(encoding="utf-8")
    assert mesh_table(entries) in page
    for one in (entries[f"mesh/{name}"] for name in MESHES):
        assert one["ldraw_steps"] == one["placed"]
        stands = one["check_verdict"] == "stands"
        assert stands == (one["status"] == "complete") == (one["placed"] == one["bricks"])
