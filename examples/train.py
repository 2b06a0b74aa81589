"""Train an agent, then let it play, and a shipped one with and without search.

``python examples/train.py [SAMPLES [EPISODES]]``; a good agent takes 100,000 samples.
"""

import sys

import learn2assemble as l2a

samples, episodes = (*map(int, sys.argv[1:]), *(20_000, 50)[len(sys.argv) - 1 :])
run = l2a.train("one-sided-3x3-22-24", out="runs/example", samples=samples)
print(run.metrics)
print("success", l2a.evaluate(run.task, agent="runs/example", episodes=20).metrics.success)
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
