"""``l2a replay``: recorded transitions against this project's world."""

from __future__ import annotations

import argparse

from learn2assemble.cli.output import Output
from learn2assemble.physics.rigid import RigidPhysics
from learn2assemble.reproduction.recordings import read_lines
from learn2assemble.reproduction.replay import replay_file
from learn2assemble.reproduction.robot_replay import is_robot_line, replay_robot_file

COLUMNS = (
    "file", "lines", "mask_exact", "plane_exact", "complete_exact", "max_px_diff",
    "valid_static", "valid_rigid", "edge_lines", "valid_static_firm", "valid_rigid_firm", "reward",
    "done",
)  # fmt: skip
ROBOT_COLUMNS = ("file", "cell", "lines", "agree", "same_class", "rule")


def run(options: argparse.Namespace) -> int:
    output = Output(options.json)
    reports, robots = [], []
    for path in options.files:
        output.progress(f"replaying {path.name}")
        reports.append(replay_file(path, RigidPhysics).to_dict())
        if any(map(is_robot_line, read_lines(path))):
            robots.append(replay_robot_file(path).to_dict())
    output.table("agreement with recorded transitions", COLUMNS, [
        [report[column] for column in COLUMNS] for report in reports
    ])  # fmt: skip
    if robots:
        output.table("agreement of the arm on success or failure", ROBOT_COLUMNS, [
            [report[column] for column in ROBOT_COLUMNS] for report in robots
        ])  # fmt: skip
    output.finish({"files": reports, "robot": robots})
    return 0
