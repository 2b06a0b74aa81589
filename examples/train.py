"""Train an agent: ``python examples/train.py [SAMPLES]``; a good one takes 100,000 samples."""

import sys

import learn2assemble as l2a

samples = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
run = l2a.train("one-sided-3x3-22-24", out="runs/example", samples=samples)
print(run.metrics)
print("success", l2a.evaluate(run.task, agent="runs/example", episodes=20).metrics.success)
