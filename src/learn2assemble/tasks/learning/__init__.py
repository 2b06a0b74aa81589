"""Replay, losses, schedules, the one training loop, checkpoints.

Importing this needs torch, numpy, numba, safetensors and tqdm, nothing else.
"""
