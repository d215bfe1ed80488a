"""The raw accelerometers of an ArduPilot onboard log, which the filtered streams are held against."""

from __future__ import annotations

import numpy as np

from companion.adapters.recordings.logs.dataflash import DataflashLog
from companion.records import Floats, Ints


def raw_accelerometer(log: DataflashLog, imu: int) -> tuple[Ints, Floats]:
    """Unfiltered samples of IMU 0, 1 or 2: boot ns (n,), and specific force (n, 3) in m/s^2, body FRD."""
    table = log.take("ACC", "SampleUS", "I", "AccX", "AccY", "AccZ")
    selected = table["I"] == imu
    force = np.column_stack([table[f"Acc{axis}"][selected] for axis in "XYZ"]).astype(float)
    return table["SampleUS"][selected].astype(np.int64) * 1000, force
