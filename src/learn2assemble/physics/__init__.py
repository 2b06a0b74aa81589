"""Whether a placement holds: static equilibrium and MuJoCo rigid bodies behind one protocol."""
