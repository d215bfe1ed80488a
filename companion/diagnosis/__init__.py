"""What the simulation gets wrong: compare, rank, extend, gain, report."""
