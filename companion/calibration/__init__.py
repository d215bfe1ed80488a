"""Stereo rig, wing modes, latency: from measurements to an airframe file."""
