"""``trajectory.csv``: the samples of a record, one line each, units in the header."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.robot.record import BuildRecord, Samples
from learn2assemble.robot.record_files import DECIMALS, rounded, write_text


def csv_header(joints: tuple[str, ...]) -> list[str]:
    """Names of the columns of ``trajectory.csv``, with units."""
    return [
        "step", "stage", "time [s]", *(f"{name} [rad]" for name in joints),
        *(f"{name} velocity [rad/s]" for name in joints), "gripper width [m]",
    ]  # fmt: skip


def write_csv(record: BuildRecord, path: Path) -> None:
    """Write ``trajectory.csv``: one line per sample.

    Raises:
        InputError: where ``path`` cannot be written.
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(csv_header(record.arm.joints))
    for step in record.steps:
        samples = step.samples
        numbers = np.column_stack([samples.time, samples.joints, samples.velocity, samples.width])
        for time, row in zip(samples.time.tolist(), rounded(numbers).tolist(), strict=True):
            cells = (f"{value:.{DECIMALS}f}" for value in row)
            writer.writerow([step.number, step.stage_at(time), *cells])
    write_text(out.getvalue(), "trajectory table", path)


def read_csv(path: Path) -> tuple[tuple[str, ...], np.ndarray, list[str], Samples]:
    """Joint names, int64[T] step numbers, stages and samples of a ``trajectory.csv``.

    Raises:
        InputError: where it is none.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            head, *rows = list(csv.reader(file)) or [[]]
        joints = tuple(name.removesuffix(" [rad]") for name in head if name.endswith(" [rad]"))
        if head != csv_header(joints):
            raise InputError("trajectory table", ",".join(head), "its header")
        values = np.array([row[2:] for row in rows], float).reshape(len(rows), len(head) - 2)
        steps = np.array([int(row[0]) for row in rows], np.int64)
    except OSError as error:
        raise InputError("trajectory table", str(path), f"a file ({error.strerror})") from None
    except (ValueError, IndexError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError("trajectory table", str(path), f"a trajectory.csv ({error})") from None
    n = len(joints)
    samples = Samples(
        values[:, 0], values[:, 1 : n + 1], values[:, n + 1 : 2 * n + 1], values[:, 2 * n + 1]
    )
    return joints, steps, [row[1] for row in rows], samples
