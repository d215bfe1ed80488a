"""Airframes and defaults, as package data."""
