"""The spectrum of ``native/whittle.c`` by itself, with the signatures of its numpy version."""

from __future__ import annotations

import numpy as np

from companion.core.tracking.adaptation.model_spectrum import SpectralGrid
from companion.native.library import ARRAY, REAL, RECORD, kernel, packed
from companion.records import Floats

_pack_grid = packed(SpectralGrid)
_density = kernel("spectrum_density", ARRAY, RECORD, REAL, ARRAY)


def acceleration_density(log_params: Floats, grid: SpectralGrid, reference_hz: float) -> Floats:
    return _rows(log_params, grid, reference_hz, 1)[0]


def acceleration_gradient(log_params: Floats, grid: SpectralGrid, reference_hz: float) -> Floats:
    return _rows(log_params, grid, reference_hz, 1 + len(log_params))


def _rows(log_params: Floats, grid: SpectralGrid, reference_hz: float, count: int) -> Floats:
    rows = np.empty((count, len(grid.before)))
    _density(log_params, _pack_grid(grid), reference_hz, rows)
    return rows
