"""Deciding with a trained agent: policies, and build plans for designs."""
