"""When to fire: the next instant of least blur, its uncertainty, and the learned latency."""
