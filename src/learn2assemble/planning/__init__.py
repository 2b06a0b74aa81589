"""The order of given blocks, with posts and holds, and the plan, the result of all planning."""
