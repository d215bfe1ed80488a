"""A second mode about which nothing was said, under a load so white that only the gyros show it."""

from __future__ import annotations

import pytest

from companion.core.tracking.tracker import WingTracker
from companion.params.settings import Settings
from tools.bench.accuracy_belief import believed_airframe
from tools.bench.accuracy_cases import Cell, cells
from tools.reference.imu import EPOCH_HOST_NS, chunks, samples
from tools.reference.truth import simulate

LENGTH_S = 6.0


def _white_at_5_hz() -> list[Cell]:
    suite_cells = cells("second-unknown", 50, LENGTH_S)
    return [cell for cell in suite_cells if cell.spec.symmetric.frequency_hz == 5.0 and cell.spec.gust.name == "white"]


@pytest.mark.slow
@pytest.mark.parametrize("cell", _white_at_5_hz(), ids=lambda cell: cell.label)
def test_what_contradicts_the_filter_is_looked_for_and_found(cell: Cell) -> None:
    run = simulate(cell.spec, cell.seeds[:1])
    tracker = WingTracker(believed_airframe(cell.spec, cell.seeds[0], cell.perturbation), Settings())
    for end_s, batches in chunks(run, samples(run), 0, [0.05 * k for k in range(1, round(LENGTH_S / 0.05))]):
        for batch in batches:
            tracker.add(batch)
        tracker.advance(EPOCH_HOST_NS + round(end_s * 1e9))
    assert tracker.nis < 2.0  # 8 to 33 without the mode
