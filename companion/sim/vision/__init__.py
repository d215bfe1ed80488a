"""Simulated cameras: scene, renderer, shutter, calibration boards."""
