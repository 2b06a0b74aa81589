"""What stands between the side that decides and a cell."""
