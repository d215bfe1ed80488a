"""Trigger lines behind one port, fired from a process of their own."""
