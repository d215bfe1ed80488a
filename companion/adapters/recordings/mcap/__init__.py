"""Our own recordings: MCAP files written by a process of their own and read back equal."""
