"""Tracking the bending modes: causal filter, fixed-lag smoother, adaptation, phase, validity."""
