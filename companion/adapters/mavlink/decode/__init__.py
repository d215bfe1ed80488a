"""Frames to records: the one place where MAVLink's units become SI."""
