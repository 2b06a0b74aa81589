"""Agreement of one file of recorded transitions, and how it is counted."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass
class ReplayReport:
    """Agreement of one file; fractions, except the counts and ``max_px_diff``."""

    file: str
    lines: int = 0
    mask_exact: float = 1.0
    plane_exact: float = 1.0
    complete_exact: float = 1.0
    max_px_diff: int = 0
    valid_static: float = 1.0
    valid_rigid: float | None = None
    reward: float = 1.0
    done: float = 1.0
    views: int = 0
    tilted_views: int = 0
    """Views left out because blocks stand where the log does not say."""
    masks_within_rounding: int = 0
    """Masks that agree only for vertices moved by the rounding of the log; counted as exact."""
    real_lines: int = 0
    judged_lines: int = 0
    """Lines whose validity was compared: all of cubes, the real ones of objects, and those with a
    robot at which the arm did not fail."""
    edge_lines: int = 0
    """Those of objects that balance on an edge, see :func:`starts_or_ends_on_edge`."""
    valid_static_firm: float = 1.0
    """``valid_static`` without them."""
    valid_rigid_firm: float | None = None
    disagreements: list[dict[str, Any]] = field(default_factory=list)
    """Per line and physics that differ in validity; ``why`` is the class of :func:`explain`."""

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


class Tally:
    """Running agreement of one quantity."""

    def __init__(self) -> None:
        self.good, self.all = 0, 0

    def add(self, agrees: bool) -> bool:
        self.good += int(agrees)
        self.all += 1
        return agrees

    @property
    def fraction(self) -> float:
        return self.good / self.all if self.all else 1.0
