"""Evaluate a shipped agent with and without search: ``python examples/evaluate.py [EPISODES]``."""

import sys

import learn2assemble as l2a

episodes = int(sys.argv[1]) if len(sys.argv) > 1 else 50
for search, budget in (("none", 0), ("mcts", 10)):
    result = l2a.evaluate(
        "two-sided-3x3-20-24",
        agent="relational-cubes-s0",
        search=search,
        budget=budget,
        episodes=episodes,
    )
    found = result.metrics
    print(f"{search}: R {found.R:.2f} ± {found.R_ci95:.2f}, success {found.success:.0%}")
