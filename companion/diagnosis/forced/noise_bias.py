"""Bias of least squares whose columns hold the response's noise, which draws all coefficients to 0.

A column j is made of the measured response. Its error is T_j(omega) e with T = (-omega^2, j omega, 1) of mass, damping
and stiffness, and s_j + j omega z_j of a law with slopes s_j over deflection, z_j over speed. With rows weighted by
their noise, B_jk = sum of var(e) Re(T_j^* T_k) / var(row) is what the noise adds to the normal matrix A, and

    (A - B) theta = A theta_LS

is the estimate without it (bias-compensated least squares, Stoica and Soderstrom 1982).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.records import Floats

MOST_NOISE = 0.5
"""Share of the normal matrix that may be noise (choice): beyond, the coefficients are left as they are."""


@dataclass(frozen=True, slots=True)
class NoiseShare:
    """Columns (s, n) over the relative noise of their rows, and ``added`` (s, s), which is B.

    ``names`` (s) are the parameters' of the columns; one without noise of the response has zeros in ``added``.
    """

    names: tuple[str, ...]
    white: Floats
    added: Floats

    def ratio(self, keys: Sequence[str], log_noise: float) -> float:
        """Largest share of the normal matrix that is noise, of all combinations of the parameters among ``keys``."""
        _, normal, added = self._matrices(keys, log_noise)
        return float(np.linalg.eigvals(np.linalg.solve(normal, added)).real.max())

    def shift(self, keys: Sequence[str], values: Floats, log_noise: float) -> dict[str, float]:
        """Difference from each fitted value: ``keys`` and ``values`` (p,) are a fit's, its noise e^log_noise.

        It is 0 where the ratio exceeds :data:`MOST_NOISE`.
        """
        used, normal, added = self._matrices(keys, log_noise)
        if self.ratio(keys, log_noise) > MOST_NOISE:
            return dict.fromkeys(used, 0.0)
        theta = np.array([values[list(keys).index(name)] for name in used])
        moved = np.linalg.solve(normal - added, normal @ theta) - theta
        return dict(zip(used, moved.tolist(), strict=True))

    def _matrices(self, keys: Sequence[str], log_noise: float) -> tuple[list[str], Floats, Floats]:
        """Names of the parameters among ``keys``, with A and B of their columns."""
        used = [i for i, name in enumerate(self.names) if name in keys]
        normal = np.exp(-2.0 * log_noise) * (self.white[used] @ self.white[used].T)
        return [self.names[i] for i in used], normal, self.added[np.ix_(used, used)]


def added_by_noise(omega: Floats, kind: Floats, slopes: Floats, row_variance: Floats, scale: Floats) -> Floats:
    """B of mass, damping, stiffness and the laws (s, s), for columns over ``scale`` (s,).

    ``slopes`` (2, laws, samples) are those of the laws over deflection and speed, ``row_variance`` (n,) is that of the
    rows over that of the response, at ``omega`` (n,), ``kind`` (n,) how often the deflection was differentiated.
    """
    weight = 1.0 / (row_variance * omega ** (2.0 * kind))
    by_laws, by_slopes = slopes.mean(axis=2), [each @ each.T / each.shape[1] for each in slopes]
    # each column as a part with e and one with j omega e: of mass, damping and stiffness -omega^2, j omega and 1
    parts = (np.stack([-(omega**2), np.zeros_like(omega), np.ones_like(omega)]), np.array([[0.0], [1.0], [0.0]]))
    added = np.zeros((len(scale), len(scale)))
    for linear, mean, products, power in zip(parts, by_laws, by_slopes, (weight, weight * omega**2), strict=True):
        rows = np.concatenate([np.broadcast_to(each, (len(each), len(omega))) for each in (linear, mean[:, None])])
        normal = (rows * power) @ rows.T
        normal[len(linear) :, len(linear) :] = power.sum() * products  # two laws vary together
        added += normal
    return np.asarray(added / np.outer(scale, scale))
