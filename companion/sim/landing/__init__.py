"""A flexible aeroplane in six degrees of freedom and the small autopilot that lands it."""
