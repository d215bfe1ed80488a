"""The simulated aircraft: gusts, wing truth, sensors, autopilot, cameras, scene."""
