"""Small-budget tree search over a model protocol; knows neither networks nor environments."""
