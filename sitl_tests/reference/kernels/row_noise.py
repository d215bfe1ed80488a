"""Terms of the rows' noise in numpy: ``native/noise.c``."""

from __future__ import annotations

import numpy as np

from companion.records import Floats, Ints


def noise_terms(innovation: Floats, covariance: Floats, steps: Ints, rows: Ints, columns: Floats) -> Floats:
    """As :func:`companion.core.tracking.row_noise.noise_terms`, of covariances that are positive definite."""
    S = covariance[np.ix_(steps, rows, rows)]
    S = S + np.tril(S, -1).transpose(0, 2, 1)
    weighted = np.linalg.solve(S, columns[rows])  # S^-1 g, (m, rows, sources)
    score = np.einsum("nrk,nr->nk", weighted, innovation[steps][:, rows])
    change = np.einsum("nrk,nr->nk", weighted, (innovation[steps] - innovation[steps - 1])[:, rows])
    coupling = np.einsum("rk,nrl->nkl", columns[rows], weighted).reshape(len(steps), -1)
    terms: Floats = np.concatenate([coupling, score**2, 0.5 * change**2], axis=1).T
    return terms
