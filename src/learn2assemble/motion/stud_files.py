"""Joints of studs as JSON, in records of builds and in programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from learn2assemble.robot.studs import GROUND, StudJoint, Studs

_FIELDS = ("lower", "upper", "at", "pull", "middle", "hull", "face")


def studs_data(studs: Studs) -> dict[str, Any]:
    """Joints as plain values; none of them is home yet.

    Args:
        studs: whose bricks are numbers of cells.
    """
    joints = [{name: getattr(joint, name) for name in _FIELDS} for joint in studs.joints]
    return {"press": studs.press, "joints": joints}


def studs_from(data: Mapping[str, Any], cells: int) -> Studs:
    """What :func:`studs_data` has made.

    Args:
        cells: how many there are.

    Raises:
        ValueError: for anything else; also KeyError and TypeError.
    """
    made: list[StudJoint] = []
    for one in data["joints"]:
        lower, upper = int(one["lower"]), int(one["upper"])
        if not (GROUND <= lower < cells and 0 <= upper < cells and lower != upper):
            raise ValueError(f"a joint of cells {lower} and {upper} of {cells}")
        hull, (low, high) = one["hull"], one["face"]
        x, y, z = _numbers(one["at"], 3)
        (pull,) = _numbers([one["pull"]], 1)
        made.append(
            StudJoint(
                lower,
                upper,
                (x, y, z),
                pull,
                _point(one["middle"]),
                tuple(map(_point, hull)),
                (_point(low), _point(high)),
                False,
            )
        )
    (press,) = _numbers([data["press"]], 1)
    if press <= 0:
        raise ValueError(f"a press of {press:g} N")
    return Studs(tuple(made), press)


def _point(value: Sequence[float]) -> tuple[float, float]:
    x, y = _numbers(value, 2)
    return x, y


def _numbers(value: Sequence[float], count: int) -> list[float]:
    array = np.array(value, float)
    if array.shape != (count,) or not np.isfinite(array).all():
        raise ValueError(f"{value} instead of {count} finite numbers")
    return array.tolist()
