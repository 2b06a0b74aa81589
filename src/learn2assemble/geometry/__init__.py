"""Arrays only: cameras, pixel masks, coverage and box contact. Imports nothing of the package."""
