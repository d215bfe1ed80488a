"""Regressors of the measured toe and of its variance, for laws without a name."""

from __future__ import annotations

import numpy as np

from companion.core.wing.effect import halves
from companion.core.wing.effects.damping.hysteresis import stretch_along
from companion.diagnosis.data.observations import ToeData
from companion.diagnosis.model.generic_effects import PLAY, SPREAD, TOE, across
from companion.records import Floats


def toe_regressors(
    toe: ToeData, modal: Floats, rates: Floats, load_factor: Floats, expected_rad: Floats
) -> dict[str, Floats]:
    """Regressors of the toe, each about its mean (but the whole reading) and of rms 1, (k,).

    Parameters
    ----------
    toe : ToeData
        The exposures.
    modal, rates : (n, k)
        Smoothed modes at the exposures.
    load_factor, expected_rad : (k,)
        Load factor of the wing, and the whole reading: B/Z of the reference plus the expected toe, rad.
    """
    q, rate = modal[0], rates[0]
    x, nearness = across(toe.t_s), toe.inverse_m - toe.inverse_m.mean()
    values = [q, rate, q**2, q**3, rate**2, q * x, rate * x, load_factor]
    values += [expected_rad, nearness, nearness**2, q * nearness, x, x**2, *modal[1:2], *rates[1:2]]
    values += [*modal[2:3], *rates[2:3]]
    centred = {
        name: values_of if name == "the whole reading" else values_of - np.mean(values_of)
        for name, values_of in zip(TOE, values, strict=False)
    }
    return {name: unit for name, values_of in centred.items() if (unit := of_unit_rms(values_of)) is not None}


def of_unit_rms(values: Floats) -> Floats | None:
    """A regressor (m,) over its rms; None where it is 0."""
    size = float(np.sqrt(np.mean(values**2)))
    return values / size if size > 1e-12 else None


def toe_variance_regressors(toe: ToeData, modal: Floats, rates: Floats, turning: Floats) -> dict[str, Floats]:
    """Regressors of the toe's variance, of mean 1, (k,); ``turning`` (k,) is the sum of both cameras' squared rates."""
    values = (modal[0] ** 2, rates[0] ** 2, turning, toe.inverse_m**2, 0.5 * (1.0 + across(toe.t_s)))
    return {
        name: regressor / np.mean(regressor)
        for name, regressor in zip(SPREAD, values, strict=True)
        if float(np.std(regressor)) > 1e-12
    }


def taken_up(modal: Floats, which: str) -> Floats:
    """Deflection that the play of the mounts takes up along a motion (n, m), sum of both halves, (m,), m."""
    deflection = np.ascontiguousarray(halves(modal))
    return np.asarray(stretch_along(deflection, PLAY[which] * float(np.std(deflection))).sum(0))
