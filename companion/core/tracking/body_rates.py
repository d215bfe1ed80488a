"""Body rates of the epochs that the smoother can look back on."""

from __future__ import annotations

import functools
from collections import deque

import numpy as np

from companion.core.kernels.arrays import Epochs
from companion.records import Floats

# chosen: a rigid aircraft turns below some 8 Hz, of which the kernel passes 99 %; propulsion shakes the root's gyro
# above 30 Hz, where it passes 0.1 %
_CUTOFF_HZ, _REACH_S = 18.0, 0.076


class BodyRates:
    """Body rate at the end of each of the newest ``length`` epochs of ``step_s``, and whether the root measured it."""

    def __init__(self, length: int, step_s: float) -> None:
        self._radps: deque[Floats] = deque(maxlen=length)
        self._measured: deque[bool] = deque(maxlen=length)
        self._step_s = step_s

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
        """Body rate, (3,) FRD, at a fraction of an epoch (-1: the newest) without vibration; None in a gap of the root.

        It is interpolated between the ends of two epochs, low-passed without delay.
        """
        before = max(epoch - 1, -len(self._radps))
        if not (self._measured[epoch] and self._measured[before]):
            return None
        at_begin, at_end = self._low_passed(before), self._low_passed(epoch)
        return at_begin + fraction * (at_end - at_begin)

    def _low_passed(self, epoch: int) -> Floats:
        """Mean of the epochs on both sides by a sinc kernel with a Hamming window; as many on either as there are."""
        reach = min(round(_REACH_S / self._step_s), -1 - epoch, epoch + len(self._radps))
        around = range(epoch - reach, epoch + reach + 1)
        weight = _kernel(reach, self._step_s) * np.array([self._measured[k] for k in around])
        mean: Floats = weight @ np.stack([self._radps[k] for k in around]) / weight.sum()
        return mean


@functools.lru_cache(maxsize=64)
def _kernel(reach: int, step_s: float) -> Floats:
    """Weights (2 reach + 1,) of a low-pass, not normalised."""
    apart = np.arange(-reach, reach + 1)
    window = 0.54 + 0.46 * np.cos(np.pi * apart / max(reach, 1))
    return np.asarray(np.sinc(2.0 * _CUTOFF_HZ * step_s * apart) * window)
