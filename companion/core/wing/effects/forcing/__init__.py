"""Effects on the load that drives the wing."""
