"""A motion as a program for a controller of Universal Robots.

The program follows the cubics between the samples in every cycle of the control loop, switches the
tool, and looks in every cycle at what it must not overlook, so that the arm stops without waiting
for the network: the input that says that something is held, the force, and the beat of whoever sent
it. What came of it stands in output registers, which the state carries.
"""

from __future__ import annotations

from enum import IntEnum
from itertools import pairwise
from typing import Any

import numpy as np

from learn2assemble.motion.driver import Driver, pose_vector
from learn2assemble.plants.plant import Commands, Guard, Guards, Motion, ToolCommand
from learn2assemble.plants.settings import ProgramSettings

SERIAL, OUTCOME, PROGRESS, BEAT = 36, 37, 38, 42
"""Output registers: number of the program that runs, what came of it, how far it is [ms]; input
register: a number that changes as long as somebody watches."""
STOP_RATE = 8.0
"""At which the joints slow down where a motion is broken off [rad/s²]."""
LOOKAHEAD, GAIN = 0.03, 500
"""Of ``servoj``: over which it smooths [s], and how stiffly it follows."""
ARRIVED, WAIT = 5e-4, 0.3
"""The arm has arrived within so much [rad]; longest wait for that [s]."""
DEBOUNCE = 0.04
"""So long the input may say that nothing is held before that is believed [s]."""


class ScriptOutcome(IntEnum):
    """What a program says of itself."""

    RUNS = 0
    DONE = 1
    CONTACT = 2
    HELD = 3
    FORCE = 4
    RELEASED = 5
    SILENCE = 6


def motion_script(
    motion: Motion,
    commands: Commands,
    guards: Guards,
    driver: Driver,
    settings: ProgramSettings,
    serial: int,
    patience: float,
) -> str:
    """The program.

    Args:
        motion: thinned, with a sample wherever something changes.
        commands: by their times.
        guards: as :func:`~.common.felt` gives them.
        driver: of the arm, for its frames and the mass of its tool.
        settings: which output and input the tool is wired to.
        serial: number of the program.
        patience: longest silence of the sender [s].
    """
    lines = [
        _HEAD.format(
            serial=serial,
            outcome=OUTCOME,
            serial_register=SERIAL,
            progress=PROGRESS,
            beat=BEAT,
            patience=f"{patience:.3f}",
            rate=STOP_RATE,
            lookahead=LOOKAHEAD,
            gain=GAIN,
            arrived=ARRIVED,
            wait=WAIT,
            debounce=DEBOUNCE,
            held=_held(settings),
            tcp=_list(pose_vector(driver.tcp)),
            contact=ScriptOutcome.CONTACT.value,
            taken=ScriptOutcome.HELD.value,
            force=ScriptOutcome.FORCE.value,
            released=ScriptOutcome.RELEASED.value,
            silence=ScriptOutcome.SILENCE.value,
        )
    ]
    left, ahead = list(commands), list(guards)

    def due(time: float) -> None:
        while ahead and ahead[0].begin <= time + 1e-6:
            lines.append(_guard(ahead.pop(0)))
        while left and left[0].at <= time + 1e-6:
            lines.append(_command(left.pop(0), driver, settings))

    time, q, v = motion.time, motion.joints, motion.velocity
    if any(guard.contact is not None for guard in guards):
        lines.append("zero_ftsensor()")  # The arm stands, and touches nothing yet.
    due(0.0)
    for k, (begin, end) in enumerate(pairwise(time.tolist())):
        numbers = ", ".join(f"[{_list(one)}]" for one in (q[k], v[k], q[k + 1], v[k + 1]))
        lines.append(f"l2a_to({begin:.6f}, {end:.6f}, {numbers})")
        due(end)
    if len(time) > 1:
        lines.append(f"l2a_arrive([{_list(q[-1])}])")
    due(np.inf)
    lines.append(f"l2a_finish({ScriptOutcome.DONE.value})")
    body = [line for block in lines for line in block.splitlines()]
    return "def l2a_motion():\n" + "".join(f"  {line}\n" for line in body) + "end\n"


def stop_script(serial: int) -> str:
    """A program that takes the place of whatever runs, and brings the arm to rest."""
    return (
        "def l2a_stop():\n"
        f"  write_output_integer_register({OUTCOME}, 0)\n"
        f"  write_output_integer_register({SERIAL}, {serial})\n"
        f"  stopj({STOP_RATE})\n"
        f"  write_output_integer_register({OUTCOME}, {ScriptOutcome.DONE.value})\n"
        "end\n"
    )


_HEAD = """\
write_output_integer_register({outcome}, 0)
write_output_integer_register({progress}, 0)
write_output_integer_register({serial_register}, {serial})
set_tcp(p[{tcp}])
global l2a_cycle = get_steptime()
global l2a_time = 0.0
global l2a_beat = read_input_integer_register({beat})
global l2a_silent = 0.0
global l2a_gone = 0.0
global l2a_keep = False
global l2a_make = False
global l2a_contact = -1.0
global l2a_force = -1.0
def l2a_held():
  return {held}
end
def l2a_finish(outcome):
  write_output_integer_register({progress}, l2a_time * 1000)
  stopj({rate})
  write_output_integer_register({outcome}, outcome)
  halt
end
def l2a_watch():
  local beat = read_input_integer_register({beat})
  l2a_silent = l2a_silent + l2a_cycle
  if (beat != l2a_beat):
    l2a_beat = beat
    l2a_silent = 0.0
  end
  if (l2a_silent > {patience}):
    l2a_finish({silence})
  end
  if (l2a_keep):
    l2a_gone = l2a_gone + l2a_cycle
    if (l2a_held()):
      l2a_gone = 0.0
    end
    if (l2a_gone > {debounce}):
      l2a_finish({released})
    end
  end
  if (l2a_make):
    if (l2a_held()):
      l2a_finish({taken})
    end
  end
  if ((l2a_contact > 0) or (l2a_force > 0)):
    local wrench = get_tcp_force()
    local size = norm([wrench[0], wrench[1], wrench[2]])
    if ((l2a_contact > 0) and (size > l2a_contact)):
      l2a_finish({contact})
    end
    if ((l2a_force > 0) and (size > l2a_force)):
      l2a_finish({force})
    end
  end
end
def l2a_to(begin, finish, q, v, r, w):
  local span = finish - begin
  while (l2a_time + l2a_cycle <= finish + 0.000001):
    l2a_time = l2a_time + l2a_cycle
    local u = (l2a_time - begin) / span
    local o = 1 - u
    local a = o * o * (1 + 2 * u)
    local b = u * o * o * span
    local c = u * u * (3 - 2 * u)
    local d = u * u * (u - 1) * span
    servoj([a * q[0] + b * v[0] + c * r[0] + d * w[0], a * q[1] + b * v[1] + c * r[1] + d * w[1], \
a * q[2] + b * v[2] + c * r[2] + d * w[2], a * q[3] + b * v[3] + c * r[3] + d * w[3], \
a * q[4] + b * v[4] + c * r[4] + d * w[4], a * q[5] + b * v[5] + c * r[5] + d * w[5]], \
t=l2a_cycle, lookahead_time={lookahead}, gain={gain})
    l2a_watch()
  end
  write_output_integer_register({progress}, l2a_time * 1000)
end
def l2a_arrive(q):
  local waited = 0.0
  local off = 1.0
  while ((off > {arrived}) and (waited < {wait})):
    servoj(q, t=l2a_cycle, lookahead_time={lookahead}, gain={gain})
    l2a_watch()
    local here = get_actual_joint_positions()
    off = norm([here[0] - q[0], here[1] - q[1], here[2] - q[2], here[3] - q[3], \
here[4] - q[4], here[5] - q[5]])
    waited = waited + l2a_cycle
  end
  stopj({rate})
end"""


def _held(settings: ProgramSettings) -> str:
    held = settings.input
    if held.threshold is None:
        return f"(get_{held.bank}_digital_in({held.number}) == {held.held})"
    level = f"get_{held.bank}_analog_in({held.number}) >= {held.threshold:g}"
    return f"(({level}) == {held.held})"


def _guard(guard: Guard) -> str:
    """What is looked at from now on."""
    force = -1.0 if guard.force is None else guard.force
    contact = -1.0 if guard.contact is None else guard.contact
    return (
        f"l2a_contact = {contact:.3f}\nl2a_force = {force:.3f}\nl2a_gone = 0.0\n"
        f"l2a_keep = {guard.hold == 'kept'}\nl2a_make = {guard.hold == 'made'}"
    )


def _command(command: ToolCommand, driver: Driver, settings: ProgramSettings) -> str:
    out: list[str] = []
    close = command.vacuum
    if close is None and command.width is not None:
        close = command.force > 0
    if close is not None:
        output = settings.output
        level = output.on if close else not output.on
        out.append(f"set_{output.bank}_digital_out({output.number}, {level})")
    if command.load is not None:
        mass = driver.tool_mass + command.load
        # The block hangs at the tool point, as far as the controller has to know.
        centre = (driver.tool_mass * driver.tool_centre + command.load * driver.tcp[:3]) / mass
        out.append(f"set_payload({mass:.4f}, [{_list(centre)}])")
    return "\n".join(out)


def _list(values: Any) -> str:
    return ", ".join(f"{value + 0.0:.6f}" for value in np.asarray(values).tolist())
