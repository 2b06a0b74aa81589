"""The command that carries out a plan with a robot, simulated or behind a controller."""

from __future__ import annotations

import argparse
import sys
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any

from learn2assemble.cli.parser import Command, arg, command, count, named, percent
from learn2assemble.errors import InputError
from learn2assemble.files import alone_in
from learn2assemble.values import to_plain

if TYPE_CHECKING:
    from learn2assemble.cli.output import Output
    from learn2assemble.plants.plant import Request

COMMANDS: dict[str, Command] = {}
STATE = "run.jsonl"
"""What a run appends to, in the folder of its plan; gone when everything is done."""
WORDS = {
    "place": "put {} where it shall be",
    "remove": "take {} away",
}
"""What a person is asked to do."""


@command(
    COMMANDS,
    "run",
    "carry out a plan with a robot, or go on with it",
    "l2a run out/wall --robot ur://192.168.0.2 --speed 30% --step",
    arg("plan", metavar="PLAN", type=named, help="folder of a build with an arm (l2a build --arm)"),
    arg(
        "--robot",
        action="append",
        metavar="URL",
        help="sim:// (the default), ur://HOST, ros2://HOST:PORT or franka://HOST (docs/run.md); "
        "of two arms once for each, in the order of the plan",
    ),
    arg(
        "--layout",
        type=named,
        default=None,
        metavar="FILE",
        help="the workcell: where blocks wait, how the tool is wired, what the arm may not do",
    ),
    arg("--step", action="store_true", help="ask before every attempt"),
    arg("--until", type=count, default=None, metavar="N", help="pause after N steps"),
    arg("--speed", type=percent, default=1.0, metavar="SHARE", help="of the plan's, as 30%% (1)"),
    arg("--resume", action="store_true", help="go on with a run that was paused or interrupted"),
    arg(
        "--trust-placements",
        action="store_true",
        help="nothing sees blocks: take them to be where they were put",
    ),
)
def _run(options: argparse.Namespace, output: Output) -> int:
    """Exit code 0 where everything is done, or the run was paused as asked; else 1."""
    from learn2assemble.cell.site import Site, read_site
    from learn2assemble.jobs.run import SIMULATION, run
    from learn2assemble.planning.plan import load_plan
    from learn2assemble.plants.safety import by_rule
    from learn2assemble.plants.setup import Surroundings

    if options.step and options.until is not None:
        raise InputError("--step", f"with --until {options.until}", "one of the two")
    folder = options.plan if options.plan.is_dir() else options.plan.parent
    state = folder / STATE
    if state.exists() != options.resume:
        got = f"{state}, which {'is' if state.exists() else 'is not'} there"
        expected = "a run to --resume" if options.resume else "--resume, or that file away"
        raise InputError("--resume", got, expected)
    site = Site() if options.layout is None else read_site(options.layout)
    for option in ("step", "until"):
        if not getattr(options, option):
            continue
        plan = load_plan(options.plan)
        if len(plan.arms) > 1 and plan.by_turns:
            expected = "none where arms hold blocks, or posts are set by hand between two arms: "
            expected += "what was in a hand would be gone, so such a run cannot be gone on with"
            raise InputError(f"--{option}", getattr(options, option), expected)

    def confirm(done: int, what: str) -> bool:
        if options.until is not None:
            return done < options.until
        return not options.step or _asked(f"{done} steps done; next: {what}. Go on? [Y/n] ")

    around = Surroundings(
        program=site.program, serve=_serve, trust_placements=options.trust_placements
    )
    robots = options.robot or [SIMULATION]
    # Two runs of one plan would both move its robot.
    there = (folder / "plan.json").is_file()
    with alone_in(folder, "PLAN") if there else nullcontext():
        ran = run(
            options.plan,
            robots,
            layout=site,
            state=state,
            speed=options.speed,
            confirm=confirm,
            around=around,
            progress=output.progress,
        )
        if ran.complete:
            state.unlink(missing_ok=True)
    paused = ran.reason == "paused"
    result: dict[str, Any] = {
        "design": ran.plan.design.name,
        "robot": robots[0] if len(robots) == 1 else robots,
        "complete": ran.complete,
        "stop": ran.stop.value,
        "reason": ran.reason,
        "blocks": ran.blocks,
        "seconds": ran.seconds,
        "seconds_a_block": ran.seconds_a_block,
        "links": [to_plain(link._asdict()) for link in ran.links],
        "state": str(state) if state.exists() else None,
    }
    output.paragraph("complete" if ran.complete else f"{ran.reason}")
    if ran.blocks:
        who = "both robots" if ran.links[1:] else "the robot"
        output.say(
            f"{ran.blocks} blocks in {ran.seconds:.0f} s of {who}, {ran.seconds_a_block:.2f} s each"
        )
    for number, link in enumerate(ran.links if ran.blocks else ()):
        longer = f"{round(1e3 * link.overhead)} ms longer than planned each"
        arm = f"{ran.plan.arms[number].name}: " if ran.plan.arms else ""
        output.say(f"{arm}{link.motions} motions, {longer}")
    if not ran.complete and state.exists():
        first = "when `safety` of the layout allows it, " if by_rule(ran.reason or "") else ""
        output.say(f"{first}goes on with `resume=`: {state}")
    output.finish(result)
    return 0 if ran.complete or paused else 1


def _asked(question: str) -> bool:
    """Whether somebody at the terminal says yes; nobody there says no."""
    sys.stderr.write(question)
    sys.stderr.flush()
    answer = sys.stdin.readline()
    return bool(answer) and answer.strip().lower() in ("", "y", "yes")


def _serve(request: Request) -> None:
    """Magazines do what they are asked to; a person is asked at the terminal.

    Raises:
        PlantError: where nobody says that it is done.
    """
    from learn2assemble.jobs.driven import IN_HAND
    from learn2assemble.plants.plant import PlantError, Stop

    if request.what in WORDS:
        what = WORDS[request.what].format(request.block)
        if request.block.startswith(IN_HAND):
            what = f"take out what the {request.block} holds"
        if not _asked(f"{what}; done? [Y/n] "):
            raise PlantError(Stop.REFUSED, f"nobody did it: {what}")
