"""Graph encoders and the Q read-out."""
