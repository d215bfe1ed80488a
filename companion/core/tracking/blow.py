"""Blows: a bump that no model of gusts explains, and the ringing after it.

The spectral fit assumes a stationary segment. The ringing after a blow is fitted as a gust of hundreds of times the
power, and damping at its bound. So no fit begins until it has faded, and what was measured until then is fitted no
more. A wing that has itself changed contradicts the filter for longer.
"""

from __future__ import annotations

import numpy as np

from companion.records import Floats

_LEAST_NIS, _SUDDEN = 1.7, 2.0  # chosen: NIS of a blow, and how many times it exceeds that of the seconds before
_USUAL_S = 10.0  # chosen: memory of the usual NIS
_FADED = 2.0  # chosen: vibration over that before the blow, at which gusts hide the ringing
_LONGEST_S = 4.0  # chosen: a wing at 5 Hz, damped to 2 %, rings down to a twelfth


class BlowWatch:
    """Follows normalised innovations and vibration over the filter's runs.

    Attributes
    ----------
    under_way : bool
        A blow, or its ringing, is in the newest epochs.
    """

    def __init__(self) -> None:
        self.under_way = False
        self._usual_nis = 1.0
        self._passed_s = 0.0
        self._before_m: Floats = np.zeros(2)
        self._wing_changed = False

    def update(self, nis: float, rms_m: Floats, recent_rms_m: Floats, passed_s: float) -> bool:
        """Take a run of the filter; give whether a blow has faded with it.

        Parameters
        ----------
        nis : float
            Mean normalised innovation squared of a row over the last second.
        rms_m, recent_rms_m : (2,) float64
            Vibration of both families: the median over blocks of the last 5 s, and with a memory of 0.3 s.
        passed_s : float
            Length of the run.
        """
        sudden = nis > max(_LEAST_NIS, _SUDDEN * self._usual_nis)
        self._wing_changed &= sudden
        if not self.under_way:
            self._usual_nis += min(passed_s / _USUAL_S, 1.0) * (nis - self._usual_nis)
            self.under_way = sudden and not self._wing_changed
            self._passed_s, self._before_m = 0.0, rms_m
            return False
        self._passed_s += passed_s
        late = self._passed_s > _LONGEST_S
        if not late and (sudden or np.any(recent_rms_m > _FADED * self._before_m)):
            return False
        self.under_way, self._wing_changed = False, sudden
        return not sudden
