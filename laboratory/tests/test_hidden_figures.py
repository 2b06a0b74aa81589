"""The sweep of hidden errors: what is measured, and the table of the page."""

from __future__ import annotations

import pytest

from l2a_lab import hidden


@pytest.mark.parametrize("who", ["with repair", "sturdiest first"])
def test_a_measurement_counts_what_happens(who: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hidden, "COUNT", 1)
    found = hidden.entry(f"0/{who}")
    assert found == {"score": 1.0, "completed": 1, "falls": 0, "collisions": 0}
    assert hidden.summary({f"0/{who}": found}) == [(f"0/{who}", "say", "100% of 1, score 1.000")]
