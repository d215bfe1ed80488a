"""Errors that wander: Gauss-Markov processes at evenly spaced nodes, straight in between."""

from __future__ import annotations

import math

import numpy as np

from companion.records import Floats


def wandering(shape: tuple[int, ...], step: float, rng: np.random.Generator) -> Floats:
    """Gauss-Markov process of unit variance, (n, ...); ``step`` is that of a row over the correlation time."""
    wander = rng.standard_normal(shape)
    keep = math.exp(-step)
    wander[1:] *= math.sqrt(1.0 - keep**2)
    for k in range(1, len(wander)):
        wander[k] += keep * wander[k - 1]
    return wander


def between(nodes_s: Floats, nodes: Floats, t_s: Floats) -> Floats:
    """Values (n, columns) at instants (n,), straight between nodes (k, columns)."""
    return np.stack([np.interp(t_s, nodes_s, column) for column in nodes.T], 1)
