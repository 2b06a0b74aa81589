"""Where an arm can be, and how it comes there."""
