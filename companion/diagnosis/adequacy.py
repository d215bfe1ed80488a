"""Does the model leave nothing but noise?

Each statistic's spread is that of recordings simulated from the model itself: spectra and toe residuals with the fitted
model's own covariance; textbook thresholds are not used.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from companion.diagnosis.expectation import Expectation
from companion.diagnosis.fit import Fit
from companion.diagnosis.latent import LatentForce, law_names
from companion.diagnosis.matrices import Complexes, adjoint, apply
from companion.diagnosis.part import Part
from companion.diagnosis.screen import screen
from companion.diagnosis.supermodel import SuperModel
from companion.records import Floats

_SIMULATED = 200
_BANDS = 14
_BLOCKS = 12
LIMIT = 5.5
"""Standard deviations beyond which a statistic is not chance; with some thirty statistics that is safe in hundreds."""


@dataclass(frozen=True, slots=True)
class Check:
    """One statistic: what it looks at, and how many standard deviations it lies from what the model expects."""

    name: str
    z: float

    @property
    def passed(self) -> bool:
        """Whether it may be chance."""
        return abs(self.z) < LIMIT


def check(models: Sequence[SuperModel], fitted: Fit, seed: int = 20250101) -> list[Check]:
    """All checks of a fitted model, the worst first."""
    rng = np.random.default_rng(seed)
    checks: dict[str, float] = {}
    for model, found in zip(models, fitted.found, strict=True):
        for name, z in {**_spectral(model, found, rng), **_toe(model, found, rng)}.items():
            if abs(z) > abs(checks.get(name, 0.0)) or name not in checks:
                checks[name] = z
    for name, z in forces(models, fitted).items():
        checks[f"force with {name}"] = z
    return sorted((Check(name, z) for name, z in checks.items()), key=lambda entry: -abs(entry.z))


def forces(models: Sequence[SuperModel], fitted: Fit) -> dict[str, float]:
    """Strength of each law of the latent force."""
    parts = [Part(LatentForce(0.0, float(index)), name) for index, name in enumerate(law_names())]
    return {entry.part.channel: entry.z for entry in screen(models, fitted, parts).candidates}


def _spectral(model: SuperModel, found: Expectation, rng: np.random.Generator) -> dict[str, float]:
    """Compare the whitened spectrum's statistics with those of simulated white ones."""
    white = apply(adjoint(found.motion.whitener), found.residual).T
    names, real = _statistics(model, white)
    count, channels = white.shape
    drawn = np.empty((_SIMULATED, len(real)))
    for i in range(_SIMULATED):
        noise = rng.standard_normal((count, channels, 2)) @ np.array([1.0, 1j]) / math.sqrt(2.0)
        drawn[i] = _statistics(model, noise)[1]
    # the taper makes neighbouring bins alike, which the simulated ones are not
    z = (real - drawn.mean(0)) / drawn.std(0) * math.sqrt(model.weight)
    return dict(zip(names, z.tolist(), strict=True))


def _statistics(model: SuperModel, white: Complexes) -> tuple[list[str], Floats]:
    names: list[str] = []
    values: list[Floats] = []
    edges = np.unique(np.geomspace(1, len(white), _BANDS + 1).astype(int))
    power = np.abs(white) ** 2
    starts = edges[:-1] - 1
    f_hz = model.band_hz
    for channel, side in enumerate(model.seen.sides):
        values.append(np.log(np.add.reduceat(power[:, channel], starts)))
        names += [f"{side.name.lower()} spectrum near {f_hz[i]:.1f} Hz" for i in starts]
    if white.shape[1] == 2:
        both = white[:, 0] * white[:, 1].conj()
        values += [np.add.reduceat(both.real, starts), np.add.reduceat(both.imag, starts)]
        names += [f"left with right near {f_hz[i]:.1f} Hz" for i in starts]
        names += [f"left before right near {f_hz[i]:.1f} Hz" for i in starts]
    in_time = np.fft.ifft(white, axis=0)
    middle = in_time[len(in_time) // 16 : -len(in_time) // 16]  # clear of the taper
    kurtosis = np.mean(np.abs(middle) ** 4, 0) / np.mean(np.abs(middle) ** 2, 0) ** 2
    values.append(np.log(kurtosis))
    names += [f"{side.name.lower()} outliers" for side in model.seen.sides]
    envelope = np.stack([np.mean(np.abs(part) ** 2, 0) for part in np.array_split(middle, _BLOCKS)])
    values.append(np.log(envelope.std(0)))
    names += [f"{side.name.lower()} unsteadiness" for side in model.seen.sides]
    return names, np.concatenate(values)


def _toe(model: SuperModel, found: Expectation, rng: np.random.Generator) -> dict[str, float]:
    """Compare whitened toe residuals with chance: size, neighbours, outliers, and against what they might follow."""
    toe = model.seen.toe
    if toe is None:
        return {}
    root = np.linalg.cholesky(found.toe_covariance)
    white = solve_triangular(root, found.toe_residual_rad, lower=True)
    followed = _followed(model, found)
    whitened = {name: solve_triangular(root, values - values.mean(), lower=True) for name, values in followed.items()}

    def of(residual: Floats) -> Floats:
        basic = [
            np.log(np.mean(residual**2)),
            np.mean(residual[1:] * residual[:-1]),
            np.log(np.mean(residual**4) / np.mean(residual**2) ** 2),
        ]
        return np.array([*basic, *[float(x @ residual / np.linalg.norm(x)) for x in whitened.values()]])

    real = of(white)
    drawn = np.stack([of(rng.standard_normal(len(white))) for _ in range(_SIMULATED)])
    z = (real - drawn.mean(0)) / drawn.std(0)
    names = ["range residual size", "range residual neighbours", "range residual outliers"]
    names += [f"range residual against {name}" for name in whitened]
    return dict(zip(names, z.tolist(), strict=True))


def _followed(model: SuperModel, found: Expectation) -> dict[str, Floats]:
    toe, t_s = model.seen.toe, model.seen.t_s
    assert toe is not None
    offered = {
        "symmetric deflection": np.interp(toe.t_s, t_s, found.q_m[0]),
        "its rate": np.interp(toe.t_s, t_s, found.qdot_mps[0]),
        "its square": np.interp(toe.t_s, t_s, found.q_m[0] ** 2),
        "load factor": np.interp(toe.t_s, t_s, model.seen.load_factor),
        "inverse distance": toe.inverse_m,
        "time": toe.t_s,
    }
    return {name: values for name, values in offered.items() if float(np.std(values)) > 1e-9}
