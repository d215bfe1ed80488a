"""The mapping of a laboratory's text table: time in ms, an accelerometer in volts, and a column of choice."""

from __future__ import annotations


def text_table_mapping(gauge: str) -> str:
    """TOML of a mapping whose optional column ``Gauge`` is read as this channel, written ``channel unit``."""
    channel, unit = gauge.split()
    return f"""
[table]
delimiter = "tab"
header_line = 3
first_line = 5
[columns]
"Time" = {{ channel = "t_s", unit = "ms" }}
"Acc L" = {{ channel = "left_z_mps2", unit = "V", scale = -2.0, offset = -9.80665 }}
"Gauge" = {{ channel = "{channel}", unit = "{unit}", optional = true }}
"""
