"""The simulated vehicle on which missions are rehearsed."""
