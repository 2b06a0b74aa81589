"""Training and measuring the builder of designs."""

from __future__ import annotations

import argparse
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any

from learn2assemble.cli.parser import (
    Command,
    arg,
    command,
    count,
    named,
    natural,
    positive,
)
from learn2assemble.errors import InputError
from learn2assemble.files import check_exists, claim_folder, read_json, write_file
from learn2assemble.values import mapping

if TYPE_CHECKING:
    from learn2assemble.cli.output import Output


COMMANDS: dict[str, Command] = {}
_OUT = arg("--out", type=named, required=True, help="new or empty folder")
_SEED = arg("--seed", type=natural, default=0, help="of designs, weights and choices")
_AGENT = arg("--agent", default="builder-s0", help="shipped builder or .safetensors")


@command(
    COMMANDS,
    "train-builder",
    "train the learned builder of designs",
    "l2a-lab train-builder --out runs/builder --seconds 600",
    _OUT,
    _SEED,
    arg("--name", default="agent", help="of the builder"),
    arg("--teacher", default="exact", help="exact planner, or own search: no demonstrations"),
    arg("--seconds", type=positive, default=1200.0, help="of processor time"),
)
def _train(options: argparse.Namespace, output: Output) -> None:
    from l2a_lab.builder.network import save_builder
    from l2a_lab.builder.train import BuilderConfig, train
    from learn2assemble.tasks.learning.run import provenance

    config = BuilderConfig(options.name, options.teacher, options.seed, seconds=options.seconds)
    curve = list[str]()

    def report(told: dict[str, float]) -> None:
        output.progress(", ".join(f"{k} {v:.4g}" for k, v in told.items()))
        if not curve:
            curve.append(",".join(("builder", *told)))
        curve.append(",".join((config.name, *(f"{value:.6g}" for value in told.values()))))

    with claim_folder(options.out):
        builder = train(config, report)
        builder.origin.update(provenance("cpu"))
        weights = save_builder(builder, options.out)
        write_file(options.out / "curve.csv", "\n".join([*curve, ""]), "--out")
    output.say(f"{builder.origin['states']} states, {builder.origin['designs']} designs: {weights}")
    output.finish({"agent": str(weights), **builder.origin})


@command(
    COMMANDS,
    "measure-builder",
    "measure the learned builder beside the exact planner",
    "l2a-lab measure-builder --out out/builder --designs 20",
    _OUT,
    _SEED,
    arg(
        "--agent",
        action="append",
        help="shipped builder or .safetensors, several times for several (builder-s0)",
    ),
    arg("--designs", type=count, default=200, help="of every small set"),
    arg("--large", type=count, default=20, help="designs of 200 to 400 blocks"),
    arg("--exact", type=count, default=40, help="of a set, for both planners"),
    arg("--examples", type=named, default=None, help="folder of the examples"),
)
def _measure(options: argparse.Namespace, output: Output) -> None:
    """``builders.json``: what builders build, with search and alone, beside rules."""
    import json

    from l2a_lab.builder.measure import BUDGETS, Measure, measure
    from l2a_lab.builder.network import DEFAULT, load_builder
    from learn2assemble.tasks.learning.run import provenance

    builders = [load_builder(name) for name in options.agent or [DEFAULT]]
    if options.examples is not None:
        check_exists(options.examples, "folder of examples")
    if options.examples is not None and not options.examples.is_dir():
        raise InputError("--examples", str(options.examples), "a folder")
    config = Measure(options.designs, options.large, options.exact, options.seed)
    head = {
        "agents": [builder.name for builder in builders],
        "measure": vars(config),
        "machine": provenance("cpu"),
    }

    def keep(found: dict[str, Any]) -> None:
        text = json.dumps({**head, **found}, indent=1)
        write_file(options.out / "builders.json", text + "\n", "--out")

    with claim_folder(options.out):
        found = measure(builders, config, options.examples, output.progress, keep)
    for name, row in found["sets"].items():
        output.table(
            f"complete of {name}",
            ("player", *BUDGETS),
            [
                (player, *(f"{played[how]['complete']:.1%}" for how in BUDGETS))
                for player, played in row["players"].items()
            ],
        )
    output.finish({**head, **found})


@command(
    COMMANDS,
    "measure-builder-arm",
    "measure the learned builder with an arm",
    "l2a-lab measure-builder-arm --out out/arm --suction 10 --gripper 10",
    arg("--out", type=named, required=True, help="new or empty folder, or --resume"),
    _SEED,
    _AGENT,
    arg("--resume", action="store_true", help="go on with what --out holds"),
    arg("--suction", type=natural, default=200, help="designs built with suction"),
    arg("--gripper", type=natural, default=200, help="designs built with fingers"),
    arg("--prior", type=count, default=50, help="designs of four planners"),
    arg("--limit", type=positive, default=60.0, help="of one of them [s, processor]"),
)
def _measure_arm(options: argparse.Namespace, output: Output) -> None:
    """``builder_arm.json``: builds with an arm, and whether the builder helps the exact planner."""
    import json

    from l2a_lab.builder.measure_arm import WAYS, ArmMeasure, measure_arm
    from l2a_lab.builder.network import load_builder
    from learn2assemble.tasks.learning.run import provenance

    load_builder(options.agent)
    config = ArmMeasure(
        options.suction, options.gripper, options.prior, options.limit, seed=options.seed
    )
    head = {"agent": options.agent, "measure": vars(config), "machine": provenance("cpu")}

    def keep(found: dict[str, Any]) -> None:
        text = json.dumps({**head, **found}, indent=1)
        write_file(options.out / "builder_arm.json", text + "\n", "--out")

    known = None
    if options.resume:
        known = mapping(read_json(options.out / "builder_arm.json", "measurement")[0], "--out")
        if known.get("agent") != options.agent:
            raise InputError("--out", str(options.out), f"a measurement of {options.agent}")
        before = {key: known.get(key) for key in ("measure", "machine")}
        if before["machine"] != head["machine"]:
            head["earlier"] = [*known.get("earlier", []), before]
    go_on = "go on with `resume=`"
    with nullcontext() if options.resume else claim_folder(options.out, otherwise=go_on):
        found = measure_arm(options.agent, config, output.progress, keep, known)
    output.table(
        "complete",
        ("tool", "designs", "complete"),
        [
            (tool, str(row["designs"]), f"{row['complete']:.1%}")
            for tool, row in found["sets"].items()
        ],
    )
    told = found["comparison"]
    output.table(
        f"{told['designs']} designs of 100 to 300 blocks",
        ("planner", "complete", "failed attempts"),
        [
            (way, f"{told[way]['complete']:.1%}", str(told[way]["failed"]))
            for way in WAYS
            if way in told
        ],
    )
    output.finish({**head, **found})
