"""The figures of what cameras tell: measured, and told beside what was asked."""

from __future__ import annotations

import pytest

from l2a_lab import sensing


def test_every_kind_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sensing, "SAMPLES", 2)
    rig = "one camera"
    alone = sensing.entry(f"alone/{sensing.BRICKS}/{rig}")
    assert alone["seen"] == 2
    assert alone["mm"][0] < 1
    lost = sensing.entry(f"lost/two bricks beside a wall/{rig}")
    assert lost["samples"] == 2 >= lost["found"] >= lost["wrong"] == 0
    once = sensing.entry(f"calibrated/0/{rig}")
    assert once["after_mm"] < 3 < once["before_mm"]
    look = sensing.entry(f"look/40 bricks/{rig}")
    assert 0 < look["seen"] <= 40
    names = (f"alone/{sensing.BRICKS}/{rig}", f"lost/x/{rig}", f"calibrated/0/{rig}")
    rows = sensing.summary(dict(zip(names, (alone, lost, once), strict=True)))
    assert [what.split(":")[0].split(",")[0] for what, _, _ in rows] == [
        "alone",
        "lost",
        "calibrated",
    ]
    assert set(map(len, rows)) == {3}


def test_scenes_have_no_blocks_in_one_another() -> None:
    import numpy as np

    from learn2assemble.robot.bodies import overlaps, solids

    for make in sensing.SCENES.values():
        true, others = make(np.random.default_rng(0), sensing.BRICK)
        every = [solids(*one) for one in [(sensing.BRICK, true), *others]]
        assert not any(overlaps(a, b, 1e-6) for k, a in enumerate(every) for b in every[:k])


def test_turns_leave_the_shapes_as_they_are() -> None:
    from learn2assemble.cell.pieces import symmetries

    for shape, turns in sensing.TURNS.items():
        assert len(turns) == len(symmetries(shape))
