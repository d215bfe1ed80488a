"""Recordings in and out: MCAP, tlog, BIN, ULog, CSV folders."""
