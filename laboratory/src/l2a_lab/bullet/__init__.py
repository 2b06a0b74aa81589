"""The released fast mode of the authors' robot cell, with its contact solver."""
