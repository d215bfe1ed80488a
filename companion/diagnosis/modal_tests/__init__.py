"""Vibration tests with a measured force: modes of each run, and what changed from run to run."""
