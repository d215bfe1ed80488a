"""Effects on the accelerometers' readings."""
