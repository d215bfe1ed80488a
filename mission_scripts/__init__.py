"""Flights for the aircraft, scripted with MAVSDK; each runs as ``python -m mission_scripts.<name>``."""
