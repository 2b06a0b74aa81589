"""``l2a replay``: recorded transitions against this project's world."""

from __future__ import annotations

import argparse

from learn2assemble.cli.output import Output
from learn2assemble.evaluation.replay import replay_file
from learn2assemble.physics.rigid import RigidPhysics

COLUMNS = (
    "file", "lines", "mask_exact", "plane_exact", "complete_exact", "max_px_diff",
    "valid_static", "valid_rigid", "edge_lines", "valid_static_firm", "valid_rigid_firm", "reward",
    "done",
)  # fmt: skip


def run(options: argparse.Namespace) -> int:
    output = Output(options.json)
    reports = []
    for path in options.files:
        output.progress(f"replaying {path.name}")
        reports.append(replay_file(path, RigidPhysics).to_dict())
    output.table("agreement with recorded transitions", COLUMNS, [
        [report[column] for column in COLUMNS] for report in reports
    ])  # fmt: skip
    output.finish({"files": reports})
    return 0
