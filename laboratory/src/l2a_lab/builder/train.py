"""Training the builder: imitation of solutions on states of its own making.

An *episode* builds one design of the training families. In every state the candidates that belong
to a known solution are right, in whatever order they come. The agent goes its own way: where it
prefers a candidate outside the solution, the teacher completes what is then there, and if it can,
that solution is followed from there on (data aggregation, DAgger); if it cannot, the episode goes
on with the solution it had.

Two teachers:

* ``exact``: solutions of the exact planner, completed by integer programming;
* ``search``: no demonstrations. Solutions are what the agent's own search has finished, renewed
  whenever it builds with fewer blocks (expert iteration); it never leaves them.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from l2a_lab.builder.network import (
    Builder,
    check_file_name,
    forward,
    initial_weights,
)
from l2a_lab.builder.search import build, window
from learn2assemble.errors import Learn2AssembleError, UnknownNameError, extra
from learn2assemble.planning.tiling.cover.candidates import bond_cost
from learn2assemble.planning.tiling.cover.tile import CoverRules, cover, seams_below
from learn2assemble.planning.tiling.world import LatticeSite, LatticeWorld
from learn2assemble.tasks.design_features import NUM_SUMMARY, describe, mirrored
from learn2assemble.tasks.designs import Solved, make_design
from learn2assemble.tasks.task import DESIGN_TASKS

if TYPE_CHECKING:
    import torch

TEACHERS = ("exact", "search")


@dataclass(frozen=True)
class BuilderConfig:
    """What a training does.

    Args:
        name: of the agent.
        teacher: see the module.
        seed: of designs, weights and choices.
        designs: how many of each task of designs are drawn, one with every ``fresh`` episodes on
            average.
        fresh: see ``designs``.
        seconds: limit of the training in processor time, drawing of designs included.
        states: most states to be visited.
        batch: states of a gradient step.
        reuse: how often a state is used, on average.
        memory: states remembered.
        kept: candidates kept of a state, those of the solution and the likeliest of the others.
        rate: first learning rate; it falls to a tenth.
        explore: share of steps that take any candidate of the solution.
        hidden, width: of the layers of the network.
    """

    name: str = "builder-s0"
    teacher: str = "exact"
    seed: int = 0
    designs: tuple[tuple[str, int], ...] = (
        ("designs-lintels-60", 350),
        ("designs-lintels-60-heap", 350),
        ("designs-bricks-60", 80),
        ("designs-cubes-60", 20),
    )
    fresh: float = 3.0
    seconds: float = 1200.0
    states: int = 1_000_000
    batch: int = 48
    reuse: float = 4.0
    memory: int = 8000
    kept: int = 96
    rate: float = 1e-3
    explore: float = 0.15
    hidden: int = 128
    width: int = 64


@dataclass(frozen=True, eq=False)
class _Sample:
    features: np.ndarray
    """float16[m, NUM_FEATURES]."""
    summary: np.ndarray
    right: np.ndarray
    """bool[m]: belongs to a solution."""


# ---------------------------------------------------------------- teachers


def complete(world: LatticeWorld, target: np.ndarray, level: int) -> np.ndarray | None:
    """A solution of what is left after a placement that was in none.

    Args:
        target: bool[n]: the candidates of the solution before it.
        level: of the placement.

    Returns:
        bool[n]; None where nothing fills the open cells.
    """
    site, found = world.site, world.site.found
    flat = all(cell[2] == 0 for way in found.ways for cell in way.cells)
    alone = flat and not (world.heap >= 0).any()
    chosen = world.alive.copy()
    if alone:
        chosen &= found.origin[:, 2] == level
    index = np.flatnonzero(chosen)
    open_ = site.wanted & (world.owner < 0).reshape(site.wanted.shape)
    if alone:
        open_[:, :, np.arange(open_.shape[2]) != level] = False
    must = np.flatnonzero(open_.reshape(-1))
    if not len(must):
        return target & world.alive
    part = found.take(index)
    if not np.isin(must, part.cell).all():
        return None
    seams = seams_below(world.owner.reshape(site.wanted.shape))
    cost = bond_cost(part, seams)
    counts = {k: int(n) for k, n in enumerate(world.heap) if n >= 0}
    try:
        answer, picked, _, _ = cover(
            part, cost, must, kit=site.kit, rules=CoverRules(counts), seconds=2.0
        )
    except Learn2AssembleError:  # The solver gave up: no teacher for this one.
        return None
    if answer.x is None:
        return None
    new = np.zeros(len(site), bool)
    if alone:
        new |= target & world.alive & (found.origin[:, 2] != level)
    new[index[picked]] = True
    return new


def _from_search(builder: Builder | None, solved: Solved, known: np.ndarray | None, seed: int):
    """The better of a known solution and what search finishes now; None where there is none."""
    outcome = build(solved.site, builder, seed=seed, seconds=20.0)
    if outcome.complete and (known is None or len(outcome.world.placed) <= known.sum()):
        known = np.zeros(len(solved.site), bool)
        known[outcome.world.placed] = True
    return known


# ---------------------------------------------------------------- episodes


def _episode(
    site: LatticeSite,
    target: np.ndarray,
    builder: Builder,
    rng: np.random.Generator,
    config: BuilderConfig,
) -> Iterator[_Sample]:
    """The states of one design; see the module."""
    world = LatticeWorld(site)
    leave = config.teacher == "exact"
    while not world.complete:
        candidates = window(world, world.legal())
        if not len(candidates):
            return
        features, summary = describe(world, candidates)
        logits = builder.scores(features, summary)
        right = target[candidates].copy()
        order = np.argsort(-logits - rng.gumbel(size=len(logits)) * 0.3, kind="stable")
        moved = False
        best = int(order[0])
        if leave and not right[best] and rng.random() > config.explore:
            trial = world.copy()
            if trial.place(int(candidates[best])):
                level = int(site.found.origin[candidates[best], 2])
                other = None if len(trial.stranded()) else complete(trial, target, level)
                if other is not None:
                    right[best] = True
                    world, target, moved = trial, other, True
        if right.any():
            yield _keep(features, summary, right, logits, config, rng)
        if moved:
            continue
        good = order[target[candidates[order]]]
        if rng.random() < config.explore:
            good = rng.permutation(good)
        ways = ((int(candidates[k]), program) for program in (False, True) for k in good)
        if not any(world.place(c, program) for c, program in ways):
            return


def _keep(
    features: np.ndarray,
    summary: np.ndarray,
    right: np.ndarray,
    logits: np.ndarray,
    config: BuilderConfig,
    rng: np.random.Generator,
) -> _Sample:
    """A sample with at most ``kept`` candidates: half of the others the likeliest, half random."""
    if len(right) > config.kept:
        noise = rng.random(len(right))
        first = np.argsort(np.argsort(-logits)) / len(right)
        rank = np.where(noise < 0.5, first, noise + 1) - 10 * right
        chosen = np.argsort(rank)[: config.kept]
        features, right = features[chosen], right[chosen]
    return _Sample(features.astype(np.float16), summary, right)


# ---------------------------------------------------------------- training


def train(
    config: BuilderConfig, report: Callable[[dict[str, float]], None] = lambda figures: None
) -> Builder:
    """Train a builder.

    Args:
        report: told every 200 gradient steps: seconds, states, loss, share of states in which the
            likeliest candidate is right.
    """
    with extra("torch", "learn"):
        import torch

    check_file_name(config.name)
    if config.teacher not in TEACHERS:
        raise UnknownNameError("teacher", config.teacher, TEACHERS)
    torch.set_num_threads(1)
    started, begun = time.process_time(), time.perf_counter()
    rng = np.random.default_rng(config.seed)
    coming = [name for name, count in config.designs for _ in range(count)]
    rng.shuffle(coming)
    designs: list[Solved] = []
    targets: list[np.ndarray | None] = []
    weights = {
        k: torch.tensor(v, requires_grad=True)
        for k, v in initial_weights(config.seed, config.hidden, config.width).items()
    }
    optimiser = torch.optim.Adam(list(weights.values()), config.rate)
    memory: list[_Sample] = []
    visited, steps, owed = 0, 0, 0.0
    figures = np.zeros(2)

    def elapsed() -> float:
        return (time.process_time() - started) / config.seconds

    while elapsed() < 1 and visited < config.states:
        if coming and (len(designs) < 8 or rng.random() < 1 / config.fresh):
            designs.append(make_design(DESIGN_TASKS[coming.pop()], rng))
            targets.append(_solution(designs[-1]) if config.teacher == "exact" else None)
        number = int(rng.integers(len(designs)))
        builder = Builder(config.name, {k: v.detach().numpy() for k, v in weights.items()})
        if config.teacher == "search" and (targets[number] is None or rng.random() < 0.3):
            player = builder if memory else None
            targets[number] = _from_search(player, designs[number], targets[number], visited)
        target = targets[number]
        if target is None:
            continue
        for sample in _episode(designs[number].site, target.copy(), builder, rng, config):
            visited += 1
            owed += config.reuse / config.batch
            if len(memory) < config.memory:
                memory.append(sample)
            else:
                memory[int(rng.integers(len(memory)))] = sample
        while owed >= 1 and len(memory) >= config.batch and elapsed() < 1:
            owed -= 1
            for group in optimiser.param_groups:
                group["lr"] = config.rate * 0.1 ** min(elapsed(), 1.0)
            picked = [memory[int(k)] for k in rng.integers(len(memory), size=config.batch)]
            loss, right = _loss(weights, picked, rng)
            optimiser.zero_grad()
            loss.backward()  # pyright: ignore[reportUnknownMemberType]
            torch.nn.utils.clip_grad_norm_(list(weights.values()), 1.0)
            optimiser.step()  # pyright: ignore[reportUnknownMemberType]
            steps += 1
            figures += (float(loss.detach()), right)
            if steps % 200 == 0:
                known = sum(t is not None for t in targets)
                report(
                    {
                        "seconds": round(elapsed() * config.seconds, 1),
                        "designs": len(designs),
                        "states": visited,
                        "steps": steps,
                        "loss": figures[0] / 200,
                        "right": figures[1] / 200,
                        "solutions": known,
                    }
                )
                figures[:] = 0
    origin = {
        "config": dataclasses.asdict(config),
        "states": visited,
        "gradient_steps": steps,
        "designs": len(designs),
        "processor_seconds": round(time.process_time() - started, 1),
        "wall_seconds": round(time.perf_counter() - begun, 1),
        "demonstrations": config.teacher == "exact",
    }
    return Builder(config.name, {k: v.detach().numpy().copy() for k, v in weights.items()}, origin)


def _solution(solved: Solved) -> np.ndarray:
    target = np.zeros(len(solved.site), bool)
    target[list(solved.order)] = True
    return target


def _loss(
    weights: dict[str, torch.Tensor], picked: list[_Sample], rng: np.random.Generator
) -> tuple[torch.Tensor, float]:
    """Loss of a batch, and the share of right choices."""
    import torch

    from learn2assemble.tasks.graph.batch import tensor_of

    most = max(len(sample.right) for sample in picked)
    features = np.zeros((len(picked), most, picked[0].features.shape[1]), np.float32)
    right = np.zeros((len(picked), most), bool)
    mask = np.zeros((len(picked), most), np.float32)
    summary = np.zeros((len(picked), 1, NUM_SUMMARY), np.float32)
    for k, sample in enumerate(picked):
        count = len(sample.right)
        flips = rng.random(2) < 0.5
        features[k, :count] = mirrored(sample.features, bool(flips[0]), bool(flips[1]))
        right[k, :count], mask[k, :count], summary[k, 0] = sample.right, 1, sample.summary
    logits = forward(weights, tensor_of(features), tensor_of(summary))
    there, wanted = tensor_of(mask), tensor_of(right)
    logits = logits.masked_fill(there == 0, -1e9)
    good = logits.masked_fill(~wanted, -1e9)
    policy = (logits.logsumexp(1) - good.logsumexp(1)).mean()
    # Beside any right choice, every right candidate is to be told from the others.
    share = torch.nn.functional.binary_cross_entropy_with_logits(
        logits, wanted.float(), reduction="none"
    )
    share = ((share * there).sum(1) / there.sum(1)).mean()
    hit = torch.gather(wanted, 1, logits.argmax(1, keepdim=True)).float().mean()
    return policy + share, float(hit)
