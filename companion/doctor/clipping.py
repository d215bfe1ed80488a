"""Samples at their sensor's limits: what still can be used, and the remedy."""

from __future__ import annotations

from collections.abc import Iterator

from companion.core.tracking.clipping import MOST_SHARE
from companion.doctor.evidence import Evidence, Finding

_REMEDY = "damp the mount, or set a higher range in the sensor and in accel_range_mps2"


def check_clipping(evidence: Evidence) -> Iterator[Finding]:
    """Clipped samples of each station as they come, and those that the autopilot counts ahead of its low-pass."""
    for station, (clipped, total) in sorted(evidence.clipped.items()):
        if clipped:
            bad = clipped > MOST_SHARE * total
            text = f"{station.name.lower()}: {100 * clipped / total:.3g} % of the samples are at the sensor's limit"
            text += f", above {100 * MOST_SHARE:.0f} % no range is trusted: {_REMEDY}" if bad else f"; {_REMEDY}"
            yield Finding.fix("clipping", text) if bad else Finding.note("clipping", text)
    if len(evidence.autopilot_clips) > 1 and (clips := evidence.autopilot_clips[-1] - evidence.autopilot_clips[0]) > 0:
        text = f"the autopilot's accelerometers clipped {clips} times (VIBRATION), which its low-pass hides: damp them"
        yield Finding.fix("clipping", text)
