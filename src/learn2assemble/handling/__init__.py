"""Picks and places, as the side that decides carries them out."""
