"""Flights under the engine: screening, proposals, tests of what is left, and laws without a name."""
