"""The dynamic cell: every pick and place is simulated in MuJoCo."""
