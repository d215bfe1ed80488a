"""The pure core: records in, records out; no I/O, clock, thread, logging or random state."""
