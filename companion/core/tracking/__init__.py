"""Tracking of the bending modes: filter, smoother, adaptation, prediction, validity; theory in README.md."""
