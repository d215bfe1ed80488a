"""Where a model may be wrong without anybody having a name for it: generic directions, tested like named effects.

Spectra by band and channel, coherence and phase between the sides, forces and sensors by law, and the toe against what
it might follow. Each is tested by its efficient score, with everything that was fitted projected out, so its spread is
the model's own and not a textbook's; each family also as a whole, which sees what is spread thinly.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from companion.diagnosis.expectation import Expectation
from companion.diagnosis.fit import Fit, derivatives
from companion.diagnosis.latent import laws
from companion.diagnosis.part import Part
from companion.diagnosis.scores import Column
from companion.diagnosis.screen import efficient, normal_of
from companion.diagnosis.simulated import bends_samples, scatter
from companion.diagnosis.supermodel import SuperModel
from companion.records import Floats

_BANDS = 14
_KNOWN = 1e-3  # share of a direction's information that must be left once the fit is projected out


def judge_directions(models: Sequence[SuperModel], fitted: Fit) -> dict[str, float]:
    """Standard deviations of every direction, and of each family as a whole."""
    names, columns = _spectral(models)
    families = {"all spectra together": len(names)}
    more, toe = _toe(models, fitted.found)
    names += more
    families["all range residuals together"] = len(names)
    found = [[*fit, *mine, *his] for fit, mine, his in zip(fitted.columns, columns, toe, strict=True)]
    known = laws()
    for _, effect in known:
        values = np.concatenate([fitted.values, [0.0, effect.law]])  # type: ignore[attr-defined]
        sigmas = np.concatenate([fitted.sigmas, [effect.parameters()[0].sigma, 1.0]])
        own = derivatives(models, values, (*fitted.parts, Part(effect)), fitted.found, sigmas, [len(fitted.values)])
        found = [[*before, *new] for before, new in zip(found, own, strict=True)]
    names += [name for name, _ in known]
    families["all laws together"] = len(names)
    score, left = efficient(models, fitted, found)
    bent = [i for i, (_, effect) in enumerate(known) if bends_samples(effect)]
    wider = np.ones(len(score))
    unit = [dataclasses.replace(known[i][1], strength=1e-3) for i in bent]  # type: ignore[call-arg]
    wider[[len(score) - len(known) + i for i in bent]] = scatter(models, fitted.found, unit)
    left = left * np.outer(wider, wider)
    return _strengths(names, families, score, left)


def _strengths(names: Sequence[str], families: dict[str, int], score: Floats, left: Floats) -> dict[str, float]:
    spread = np.diag(left)
    telling = spread > _KNOWN * np.median(spread[spread > 0.0]) * 1e-6
    strengths = {name: float(score[i] / np.sqrt(spread[i])) for i, name in enumerate(names) if telling[i]}
    start = 0
    for family, stop in families.items():
        mine = np.arange(start, stop)[telling[start:stop]]
        start = stop
        if len(mine) < 2:
            continue
        unit = 1.0 / np.sqrt(spread[mine])
        values, vectors = np.linalg.eigh(left[np.ix_(mine, mine)] * np.outer(unit, unit))
        kept = values > 1e-3
        along = vectors[:, kept].T @ (score[mine] * unit)
        tail = float(chi2.logsf(np.sum(along**2 / values[kept]), int(kept.sum())))
        strengths[family] = normal_of(tail)
    return strengths


def _spectral(models: Sequence[SuperModel]) -> tuple[list[str], list[list[Column]]]:
    """Indicator of a band in each entry of the whitened spectral matrix."""
    names: list[str] = []
    columns: list[list[Column]] = [[] for _ in models]
    top_hz = max(float(model.band_hz[-1]) for model in models)
    edges = np.geomspace(float(models[0].band_hz[0]), top_hz * 1.0001, _BANDS + 1)
    for low, high in itertools.pairwise(edges.tolist()):
        if not any(_inside(model, low, high).sum() > 4 for model in models):
            continue
        for k, what in enumerate(_entries(models[0])):
            names.append(f"{what} near {np.sqrt(low * high):.1f} Hz")
            for model, mine in zip(models, columns, strict=True):
                inside = _inside(model, low, high).astype(float)
                packed = np.zeros(len(_entries(model)) * len(inside))
                packed[k * len(inside) : (k + 1) * len(inside)] = inside
                mine.append(Column(power=packed))
    return names, columns


def _inside(model: SuperModel, low: float, high: float) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    return np.asarray((model.band_hz >= low) & (model.band_hz < high))


def _entries(model: SuperModel) -> list[str]:
    sides = [side.name.lower() for side in model.seen.sides]
    return [f"{side} spectrum" for side in sides] + (
        ["left with right", "left before right"] if len(sides) == 2 else []
    )


def _toe(models: Sequence[SuperModel], found: Sequence[Expectation]) -> tuple[list[str], list[list[Column]]]:
    """The toe against what it might follow."""
    offered = [_followed(model, one) for model, one in zip(models, found, strict=True)]
    names = sorted({name for entry in offered for name in entry})
    columns = [
        [Column(toe=entry.get(name, np.zeros(len(one.toe_residual_rad)))) for name in names]
        for entry, one in zip(offered, found, strict=True)
    ]
    return [f"range residual against {name}" for name in names], columns


def _followed(model: SuperModel, found: Expectation) -> dict[str, Floats]:
    toe, t_s = model.seen.toe, model.seen.t_s
    if toe is None:
        return {}
    q, rate = np.interp(toe.t_s, t_s, found.q_m[0]), np.interp(toe.t_s, t_s, found.qdot_mps[0])
    x = (toe.t_s - toe.t_s.mean()) / max(float(np.ptp(toe.t_s)), 1e-9)
    distance = toe.inverse_m - toe.inverse_m.mean()
    offered = {
        "symmetric deflection": q,
        "its rate": rate,
        "its square": q**2 - np.mean(q**2),
        "its cube": q**3,
        "its rate squared": rate**2 - np.mean(rate**2),
        "deflection drifting in time": q * x,
        "rate drifting in time": rate * x,
        "load factor": np.interp(toe.t_s, t_s, model.seen.load_factor - model.seen.load_factor.mean()),
        "inverse distance": distance,
        "inverse distance squared": distance**2 - np.mean(distance**2),
        "deflection by inverse distance": q * distance,
        "time": x,
        "time squared": x**2 - np.mean(x**2),
    }
    if len(found.q_m) > 1:
        offered["antisymmetric deflection"] = np.interp(toe.t_s, t_s, found.q_m[1])
        offered["antisymmetric rate"] = np.interp(toe.t_s, t_s, found.qdot_mps[1])
    return {name: values / np.std(values) for name, values in offered.items() if float(np.std(values)) > 1e-12}
