"""Airframe parameters that leave their priors to make a model fit: something is wrong that has no name yet.

Under the model a fitted deviation has the prior variance less the posterior variance. Where a name is only near the
truth, the parameters make up for the rest, and leave their priors.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from companion.diagnosis.model.belief import Belief
from companion.diagnosis.model.flights import FlightFit
from companion.diagnosis.selection.normal_scores import normal_score

_INFORMED = 0.1  # share of the prior's variance that the data must take away (choice)
_OF_THE_FILE = (".frequency", ".damping", ".slope", ".scale", ".delay_s", ".bias_mps2", "toe_rad", "focal", "_m")


def prior_tension(belief: Belief, fitted: FlightFit) -> dict[str, float]:
    """Standard deviations of each airframe parameter from its prior, and of all together; levels and noise are free."""
    keys = [entry.name for entry in belief.nuisances]
    index = [i for i, key in enumerate(keys) if key.endswith(_OF_THE_FILE)]
    if not index:
        return {}
    unit = fitted.sigmas[index]
    moved = fitted.values[index] / unit
    spread = np.eye(len(index)) - fitted.covariance[np.ix_(index, index)] / np.outer(unit, unit)
    variances = np.diag(spread)
    tensions = {
        f"{belief.nuisances[i].key} beyond its prior": float(moved[k] / np.sqrt(variances[k]))
        for k, i in enumerate(index)
        if variances[k] > _INFORMED
    }
    values, vectors = np.linalg.eigh(spread)
    informed = values > _INFORMED
    if informed.sum() > 1:
        along = vectors[:, informed].T @ moved
        tail = float(chi2.logsf(np.sum(along**2 / values[informed]), int(informed.sum())))
        tensions["all airframe parameters together"] = normal_score(tail)
    return tensions
