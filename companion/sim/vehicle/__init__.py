"""Simulated autopilots and wing nodes that speak real MAVLink."""
