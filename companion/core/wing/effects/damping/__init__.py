"""Effects on the damping."""
