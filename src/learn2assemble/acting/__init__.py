"""An arm that acts on what it senses."""
