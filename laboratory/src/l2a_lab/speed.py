"""Steps a second beside another library of environments: ``results/speed.json``.

All play random legal actions on one core, resets included, and each is measured by turns in the
same process, so that the machine is the same; ratios tell more than the numbers. A step is not the
same work: ours moves a block, proves that it stands or not, counts pixels of two elevations and
makes the graph; one of BinPack packs an item and renews the empty spaces. BinPack runs compiled by
XLA as a whole, random choice and resets included; so does our batch, whose rules are compiled,
called from Python once a step.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from typing import Any

import numpy as np

from l2a_lab.measured import Figures, Result, table_lines
from learn2assemble.benchmark import (
    BATCH,
    TASK,
    placements_single_steps_per_s,
    rate,
    static_batch_actions_per_s,
    static_single_steps_per_s,
)
from learn2assemble.envs.assembly import AssemblyVectorEnv
from learn2assemble.errors import extra

SECONDS, TURNS = 2.0, 5
"""Of the processor a measurement; how often each is measured."""
PACKING = "BinPack-v2"
STEPS = 64
"""Of a batch of BinPack in one call."""


def _vector(seconds: float) -> float:
    """Our native vector environment with the default information."""
    envs = AssemblyVectorEnv(TASK, BATCH)
    rng = np.random.default_rng(0)
    infos: dict[str, Any] = envs.reset(seed=0)[1]

    def step() -> int:
        nonlocal infos
        allowed: np.ndarray = infos["action_masks"]
        actions = np.argmax(rng.random(allowed.shape, np.float32) * allowed, 1)
        *_, infos = envs.step(actions)
        return BATCH

    return rate(step, seconds)


def _packing(worlds: int) -> Callable[[float], float]:
    """Of jumanji's BinPack, so many worlds at once."""

    def measured(seconds: float) -> float:
        flags = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
        os.environ.setdefault("XLA_FLAGS", flags)
        with extra("jumanji", "speed", "./laboratory"):
            jumanji: Any = importlib.import_module("jumanji")
            wrappers: Any = importlib.import_module("jumanji.wrappers")
            jax: Any = importlib.import_module("jax")
        jnp, env = jax.numpy, wrappers.VmapAutoResetWrapper(jumanji.make(PACKING))
        items = int(env.action_spec.num_values[1])

        def step(carry: Any, key: Any) -> Any:
            state, mask = carry
            logits = jnp.where(mask.reshape(worlds, -1), 0.0, -jnp.inf)
            flat = jax.random.categorical(key, logits)
            state, timestep = env.step(state, jnp.stack([flat // items, flat % items], -1))
            return (state, timestep.observation.action_mask), None

        def many(carry: Any, key: Any) -> Any:
            return jax.lax.scan(step, carry, jax.random.split(key, STEPS))[0]

        play, key = jax.jit(many), jax.random.key(0)
        state, timestep = jax.jit(env.reset)(jax.random.split(key, worlds))
        carry = state, timestep.observation.action_mask

        def steps() -> int:
            nonlocal carry, key
            key, used = jax.random.split(key)
            carry = jax.block_until_ready(play(carry, used))
            return worlds * STEPS

        return rate(steps, seconds)

    return measured


MEASURED: dict[str, Callable[[float], float]] = {
    "single": static_single_steps_per_s,
    "single, placements": placements_single_steps_per_s,
    f"vector of {BATCH}": _vector,
    f"batch of {BATCH}": static_batch_actions_per_s,
    f"{PACKING}, single": _packing(1),
    f"{PACKING}, batch of {BATCH}": _packing(BATCH),
}
RUN = "steps a second"
"""The one measurement: all by turns."""


def entry(name: str) -> Result:
    """All of :data:`MEASURED` by turns: medians, lowest and highest."""
    rates: dict[str, list[float]] = {what: [] for what in MEASURED}
    for _ in range(TURNS):
        for what, measure in MEASURED.items():
            rates[what].append(measure(SECONDS))
    return {
        what: {
            "median": round(float(np.median(found))),
            "lowest": round(min(found)),
            "highest": round(max(found)),
        }
        for what, found in rates.items()
    }


def configuration() -> Result:
    """What is played."""
    return {"task": TASK, "other": PACKING, "worlds": BATCH, "seconds": SECONDS, "turns": TURNS}


def summary(entries: dict[str, Result]) -> list[tuple[str, str, str]]:
    """What was asked, and what was reached: (what, asked, got)."""
    found = entries.get(RUN)
    if found is None:
        return []
    return [(what, "say", f"{found[what]['median']:,} a second") for what in MEASURED]


def table(entries: dict[str, Result]) -> str:
    """Steps a second, in Markdown."""
    of = ("median", "lowest", "highest")
    found = entries[RUN]
    rows = [[what, *(f"{found[what][one]:,}" for one in of)] for what in MEASURED]
    return "\n".join(table_lines(("played", *of), rows))


FIGURES = Figures("learn2assemble-speed-figures", lambda: [RUN], entry, configuration, summary)
