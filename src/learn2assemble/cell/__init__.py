"""The workcell of an arm: where things lie, what it reaches, its order, and the build."""
