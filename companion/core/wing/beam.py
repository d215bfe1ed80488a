"""Euler-Bernoulli cantilever with a tip mass: roots, frequencies, mode shapes (the paper's eqs. 9 to 12).

Lengths are scaled by the beam length l and ``x`` stands for beta*l. With ``mu = m/(rho A l)`` the tip mass ratio and
``eta = J/(rho A l^3)`` the ratio of its rotary inertia (0 in the paper), moment and shear at the tip give::

    Y'' = eta x^4 Y'      Y''' = -mu x^4 Y
    1 + cos x cosh x + mu x (cos x sinh x - sin x cosh x)
      - eta x^3 (cos x sinh x + sin x cosh x) + mu eta x^4 (1 - cos x cosh x) = 0

Everything is scaled by exp(-x), so that the hundredth mode is as safe as the first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.records import Floats

_QUADRATURE_PER_MODE = 12  # numerical: Gauss-Legendre nodes per half wave, exact to rounding for smooth shapes


def characteristic(x: float, mass_ratio: float, inertia_ratio: float = 0.0) -> float:
    """Left side of the characteristic equation divided by cosh x; its zeros are the values of beta*l."""
    decay = math.exp(-x)
    sech = 2.0 * decay / (1.0 + decay * decay)
    tanh = math.tanh(x)
    sin, cos = math.sin(x), math.cos(x)
    mass = mass_ratio * x
    inertia = inertia_ratio * x**3
    return sech + cos + mass * (cos * tanh - sin) - inertia * (cos * tanh + sin) + mass * inertia * (sech - cos)


def characteristic_roots(count: int, mass_ratio: float, inertia_ratio: float = 0.0) -> Floats:
    """Give the first ``count`` values of beta*l, (count,), ascending (paper eqs. 10 to 12).

    Without rotary inertia root n lies between (n-1) pi and n pi for every mass ratio, alone. Rotary inertia is a
    rank-one addition to the mass and pulls each root down, but not below the next lower one without it.

    Raises
    ------
    ValueError
        For a count below 1, or a ratio that is negative or not finite.
    """
    _check_ratios(count, mass_ratio, inertia_ratio)
    plain = [_bracketed((n - 1) * math.pi, n * math.pi, mass_ratio, 0.0) for n in range(1, count + 1)]
    if inertia_ratio == 0.0:
        return np.array(plain)
    lower = [0.0, *plain[:-1]]
    return np.array([_bracketed(low, high, mass_ratio, inertia_ratio) for low, high in zip(lower, plain, strict=True)])


def _bracketed(low: float, high: float, mass_ratio: float, inertia_ratio: float) -> float:
    ends = [characteristic(x, mass_ratio, inertia_ratio) for x in (low, high)]
    if ends[0] * ends[1] >= 0.0:  # the tip does not turn and feels no rotary inertia: an end is the root
        return low if abs(ends[0]) < abs(ends[1]) else high
    while low < (middle := 0.5 * (low + high)) < high:  # until no number lies between the ends: some 55 halvings
        if characteristic(middle, mass_ratio, inertia_ratio) * ends[0] > 0.0:
            low = middle
        else:
            high = middle
    return high


def _check_ratios(count: int, mass_ratio: float, inertia_ratio: float) -> None:
    if count < 1:
        raise ValueError(f"at least one mode must be asked for, not {count}")
    for name, ratio in (("mass", mass_ratio), ("inertia", inertia_ratio)):
        if not (math.isfinite(ratio) and ratio >= 0.0):
            raise ValueError(f"the {name} ratio must be finite and >= 0, not {ratio}")


@dataclass(frozen=True, slots=True)
class BeamMode:
    """One bending mode, normalised to a deflection of 1 at the tip.

    Attributes
    ----------
    root : float
        beta*l.
    omega_radps : float
        Natural frequency.
    """

    root: float
    omega_radps: float
    length_m: float
    mass_ratio: float
    inertia_ratio: float

    @property
    def frequency_hz(self) -> float:
        """Natural frequency in hertz."""
        return self.omega_radps / (2.0 * math.pi)

    @property
    def slope_at_tip_radpm(self) -> float:
        """Slope at the tip per metre of deflection there (1.3765/l for the first mode without tip mass)."""
        return float(self.slope(np.array([self.length_m]))[0])

    def shape(self, station_m: Floats) -> Floats:
        """Deflection (...,) at stations (...,) from the root, m, per unit at the tip (paper eq. 10)."""
        return self._derivative(station_m, 0)

    def slope(self, station_m: Floats) -> Floats:
        """First derivative in 1/m, (...,): rad of slope per metre of tip deflection; stations as in :meth:`shape`."""
        return self._derivative(station_m, 1)

    def curvature(self, station_m: Floats) -> Floats:
        """Second derivative in 1/m^2, (...,): bending moment is E I times it, per metre of tip deflection."""
        return self._derivative(station_m, 2)

    def modal_mass_ratio(self) -> float:
        """Modal mass over beam mass: integral of Y^2 plus tip mass and rotary inertia, for 1 at the tip."""
        node, weight = self._quadrature()
        slope_scaled = self.slope_at_tip_radpm * self.length_m
        return float(weight @ self.shape(node) ** 2 + self.mass_ratio + self.inertia_ratio * slope_scaled**2)

    def base_participation(self) -> float:
        """Factor of a base acceleration a in q'' + ... = -factor * a, for a root that is shaken across the beam."""
        node, weight = self._quadrature()
        return float(weight @ self.shape(node) + self.mass_ratio) / self.modal_mass_ratio()

    def _quadrature(self) -> tuple[Floats, Floats]:
        count = _QUADRATURE_PER_MODE * (1 + math.ceil(self.root / math.pi))
        node, weight = np.polynomial.legendre.leggauss(count)
        return 0.5 * self.length_m * (node + 1.0), 0.5 * weight

    def _derivative(self, station_m: Floats, order: int) -> Floats:
        xi = np.asarray(station_m, dtype=np.float64) / self.length_m
        tip = _raw_shape(np.ones(1), self.root, self.mass_ratio, self.inertia_ratio, 0)[0]
        raw = _raw_shape(xi, self.root, self.mass_ratio, self.inertia_ratio, order)
        return np.asarray(raw / tip * (self.root / self.length_m) ** order)


def _raw_shape(xi: Floats, x: float, mass_ratio: float, inertia_ratio: float, order: int) -> Floats:
    """Derivative of a (cosh - cos) + b (sinh - sin) with respect to x*xi, up to a common factor.

    The growing exponential's coefficient a + b is a small difference of large numbers; it is formed in closed form.
    """
    a, b, increasing = _coefficients(x, mass_ratio, inertia_ratio)
    z = x * xi
    even = 1.0 if order % 2 == 0 else -1.0
    hyperbolic = 0.5 * (increasing * np.exp(z - x) + even * (a - b) * np.exp(-z))
    circular_cos = np.cos(z + 0.5 * math.pi * order)
    circular_sin = np.sin(z + 0.5 * math.pi * order)
    return np.asarray(hyperbolic - a * circular_cos - b * circular_sin)


def _coefficients(x: float, mass_ratio: float, inertia_ratio: float) -> tuple[float, float, float]:
    """a, b and exp(x) (a + b), the null vector of the better conditioned of the two tip conditions."""
    e = math.exp(-x)
    cosh, sinh = 0.5 * (1.0 + e * e), 0.5 * (1.0 - e * e)  # both times exp(-x)
    sin, cos = math.sin(x), math.cos(x)
    inertia, mass = inertia_ratio * x**3, mass_ratio * x
    moment = (
        -(sinh + e * sin) + inertia * (cosh - e * cos),
        (cosh + e * cos) - inertia * (sinh + e * sin),
        e - sin + cos + inertia * (e - cos - sin),
    )
    shear = (
        (cosh + e * cos) + mass * (sinh - e * sin),
        -(sinh - e * sin) - mass * (cosh - e * cos),
        e + cos + sin + mass * (cos - sin - e),
    )
    moment_size = max(abs(moment[0]), abs(moment[1])) / (1.0 + inertia)
    shear_size = max(abs(shear[0]), abs(shear[1])) / (1.0 + mass)
    return moment if moment_size >= shear_size else shear


@dataclass(frozen=True, slots=True)
class Beam:
    """A uniform cantilever and what sits at its tip.

    Raises
    ------
    ValueError
        For a property that is not a positive finite number (tip mass and rotary inertia may be 0).
    """

    youngs_modulus_pa: float
    second_moment_m4: float
    density_kgpm3: float
    area_m2: float
    length_m: float
    tip_mass_kg: float = 0.0
    tip_rotary_inertia_kgm2: float = 0.0

    def __post_init__(self) -> None:
        for name in ("youngs_modulus_pa", "second_moment_m4", "density_kgpm3", "area_m2", "length_m"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} must be finite and > 0, not {value}")
        _check_ratios(1, self.mass_ratio, self.inertia_ratio)

    @property
    def mass_kg(self) -> float:
        """Mass of the beam alone."""
        return self.density_kgpm3 * self.area_m2 * self.length_m

    @property
    def mass_ratio(self) -> float:
        """Tip mass over beam mass (mu)."""
        return self.tip_mass_kg / self.mass_kg

    @property
    def inertia_ratio(self) -> float:
        """Rotary inertia of the tip mass over beam mass times length squared (eta)."""
        return self.tip_rotary_inertia_kgm2 / (self.mass_kg * self.length_m**2)

    @property
    def omega_scale_radps(self) -> float:
        """sqrt(E I / (rho A)) / l^2: omega of a mode is (beta*l)^2 times it."""
        stiffness = self.youngs_modulus_pa * self.second_moment_m4
        return math.sqrt(stiffness / (self.density_kgpm3 * self.area_m2)) / self.length_m**2

    def modes(self, count: int) -> tuple[BeamMode, ...]:
        """Give the first ``count`` bending modes."""
        roots = characteristic_roots(count, self.mass_ratio, self.inertia_ratio)
        return tuple(
            BeamMode(
                float(x), float(x) ** 2 * self.omega_scale_radps, self.length_m, self.mass_ratio, self.inertia_ratio
            )
            for x in roots
        )
