"""Contradiction between the constants that a flight teaches and what the airframe's file believes of them."""

from __future__ import annotations

import math

from companion.core.tracking.estimates import bias_parameter_estimates
from companion.core.tracking.filter import SeparatedBiasFilter
from companion.core.tracking.sensor_errors import ROOT_ERRORS, SENSOR_ERRORS

_PERIOD_S = 1.0  # chosen: between looks
_MOST_SIGMAS = 6.0  # chosen: sound flights reach 2.7 (constants) and 3.2 (frequencies), a scale 3 % off of 0.5 % 12
_AGAIN_SIGMAS = 3.0  # chosen: what has contradicted lasts until it is what a sound flight has
_LOOKS = 3  # chosen, in a row: what a blow teaches for a moment is no constant
FILE_CHECK_S = _LOOKS * _PERIOD_S
"""Time that it takes to find one (derived)."""
_TERMS = {name: (error.words, error.factor, error.unit) for name, error in {**SENSOR_ERRORS, **ROOT_ERRORS}.items()} | {
    "trim": ("trim bend", 1e3, "mm"),
    "bend_per_g": ("bend per g", 1e3, "mm"),
    "bz": ("common vertical bias", 1.0, "m/s2"),
    "shortening": ("foreshortening", 100.0, "%"),
    "further_shortening": ("foreshortening by further modes", 100.0, "%"),
}  # words, factor and unit of each constant; all others are of a mode (by definition)


class FileCheck:
    """Largest deviation of a constant, or of a further mode's frequency, from the airframe's file, in its sigmas.

    The drifting biases are none of them: beside a vibrating tip they reach 7 sigma in sound flights.

    Attributes
    ----------
    sentence : str or None
        The constant, its deviation and its sigma, as first found; None where nothing contradicts the file.
    """

    def __init__(self) -> None:
        self._steps = 0
        self._looks = 0  # in a row that contradict
        self.sentence: str | None = None

    def update(self, kalman: SeparatedBiasFilter) -> None:
        """Look at the constants once a second."""
        steps = kalman.steps
        if 0 <= (steps - self._steps) * kalman.model.step_s < _PERIOD_S:
            return
        self._steps = steps
        sigmas, name, deviation, sigma = max([*self._constants(kalman), *self._frequencies(kalman)], default=_NOTHING)
        self._looks = self._looks + 1 if sigmas > _MOST_SIGMAS else 0
        if self.sentence is None and self._looks >= _LOOKS:
            self.sentence = _sentence(name, deviation, sigma)
        elif sigmas < _AGAIN_SIGMAS:
            self.sentence = None

    def _constants(self, kalman: SeparatedBiasFilter) -> list[tuple[float, str, float, float]]:
        """Each constant: deviation in sigmas of file and estimate together, name, deviation, the file's sigma.

        What drifts may be known worse than the file states it: a mounting about x that vertical axes hardly show.
        """
        learned = bias_parameter_estimates(kalman).items()
        stated = kalman.layout.bias_parameter_sigma.tolist()
        return [
            (abs(c) / math.hypot(sigma, error), name, c, sigma)
            for (name, (c, error)), sigma in zip(learned, stated, strict=True)
        ]

    def _frequencies(self, kalman: SeparatedBiasFilter) -> list[tuple[float, str, float, float]]:
        """The same of each further mode's frequency, Hz; a mode without evidence stays where the file has it."""
        off = []
        for family, parameters in zip(kalman.layout.families, kalman.model.parameters, strict=True):
            for name, mode, loaded in zip(family.names[1:], family.modes[1:], parameters.modes[1:], strict=True):
                hz, sigma_hz = mode.frequency_hz.value, mode.frequency_hz.sigma
                if sigma_hz > 0.0:
                    sigmas = abs(math.log(loaded.frequency_hz / hz)) * hz / sigma_hz
                    off.append((sigmas, name, loaded.frequency_hz - hz, sigma_hz))
        return off


_NOTHING = (0.0, "", 0.0, 1.0)


def _sentence(name: str, deviation: float, sigma: float) -> str:
    """Sentence for the operator."""
    place, _, error = name.rpartition(".")
    mode, factor = name.removeprefix("slope.").replace("_", " ").replace(".", " "), 1.0
    if name.startswith("slope."):
        named, unit = f"slope factor of {mode}", "rad/m"
    elif error in _TERMS:
        words, factor, unit = _TERMS[error]
        named = f"{place} {words}".strip()
    else:
        named, unit = f"frequency of {mode}", "Hz"
    off, stated = f"{factor * deviation:+.2g} {unit}", f"{factor * sigma:.2g} {unit}"
    return f"{named} is {off} off the airframe's file, which states {stated}"
