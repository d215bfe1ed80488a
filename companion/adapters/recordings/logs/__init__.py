"""Logs of autopilots and ground stations: ArduPilot .BIN, PX4 ULog, tlog."""
