"""``l2a bench``: the speed of this machine."""

from __future__ import annotations

import argparse

from learn2assemble.cli.output import Output
from learn2assemble.evaluation.bench import MEASUREMENTS, machine


def run(options: argparse.Namespace) -> int:
    output = Output(options.json)
    results: dict[str, float] = {}
    for name, measure in MEASUREMENTS.items():
        output.progress(f"measuring {name}")
        results[name] = measure(options.seconds)
    output.table(
        "speed",
        ("measurement", "value"),
        [(k, f"{v:,.3g}" if v < 10 else f"{v:,.1f}") for k, v in results.items()],
    )
    output.finish({**results, "seconds": options.seconds, **machine()})
    return 0
