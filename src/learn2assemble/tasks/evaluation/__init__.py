"""Measuring: episodes and their metrics, replay of recorded transitions, benchmarks."""
