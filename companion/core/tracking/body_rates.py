"""Body rates of the epochs that the smoother can look back on."""

from __future__ import annotations

from collections import deque

from companion.core.kernels.arrays import Epochs
from companion.records import Floats


class BodyRates:
    """Body rate at the end of each of the newest ``length`` epochs, and whether the root measured it."""

    def __init__(self, length: int) -> None:
        self._radps: deque[Floats] = deque(maxlen=length)
        self._measured: deque[bool] = deque(maxlen=length)

    def __len__(self) -> int:
        return len(self._radps)

    @property
    def newest_radps(self) -> Floats:
        """Body rate, (3,) FRD, at the end of the newest epoch; that of the last one measured in a gap of the root."""
        return self._radps[-1]

    def extend(self, epochs: Epochs) -> None:
        """Take the epochs that follow."""
        self._radps.extend(epochs.body_rate_radps)
        self._measured.extend(epochs.root_covered.tolist())

    def clear(self) -> None:
        """Forget all epochs."""
        self._radps.clear()
        self._measured.clear()

    def at(self, epoch: int, fraction: float) -> Floats | None:
        """Body rate, (3,) FRD, at a fraction of an epoch (-1: the newest), interpolated; None in a gap of the root."""
        before = max(epoch - 1, -len(self._radps))
        if not (self._measured[epoch] and self._measured[before]):
            return None
        body_rate_radps: Floats = self._radps[before] + fraction * (self._radps[epoch] - self._radps[before])
        return body_rate_radps
