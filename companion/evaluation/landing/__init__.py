"""Landings judged: ranges of rigid stereo along the path that is flown, rows, tables, and their picture."""
