"""Regressions under the engine: several responses, each linear in its terms, each with a noise that is fitted.

Row i of a response is y_i = x_i . theta + e_i, e_i normal with variance n_i^2 = b_i^2 (e^2s + f^2), b_i given, s of its
group of equal noise, f what no instrument resolves. With r the residual over n and c = (e^s b / n)^2, l = sum(-r^2/2 -
ln n), its gradient sum(x r / n) by theta and sum(c (r^2 - 1)) by s, its information sum(x x^T / n^2) and 2 sum(c^2).
Each is multiplied by the ratio of rows that are independent.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student_t

from companion.diagnosis.selection.check import Check
from companion.diagnosis.selection.fisher_scoring import Parameter, Scores
from companion.diagnosis.selection.fit import Fit, climb
from companion.diagnosis.selection.normal_scores import normal_score, strength
from companion.diagnosis.selection.recordings import Prediction, Progress, Recordings, no_correlation
from companion.diagnosis.selection.score_tests import Candidate, Screening
from companion.records import Bools, Floats, Ints

LIMIT = 5.0
"""Standard deviations beyond which a test is not chance (choice)."""
_SCORING_STEPS = 60  # at most: noises begin far from their values (choice)
_NOISE_SIGMA = 3.0  # of the logarithm: a factor of 20 either way (choice)
_DRAWS = 400  # of the model: the spread of a statistic is then known to 4 % (choice)
_SEED = 20250104  # convention: any fixed number
_FEWEST = 8  # rows of a response that can be tested (choice)
_RESOLVED = 1e-4  # of the noise where it is sought: what no instrument resolves (choice)
_ROUNDING = 1e-2  # of the noise's square, below which residuals are rounding: their order says nothing (choice)


@dataclass(frozen=True, slots=True)
class Coefficient:
    """One coefficient: its response, column (n,) there, prior sigma, and what it says."""

    key: str
    response: str
    column: Floats
    sigma: float
    unit: str
    meaning: str


@dataclass(frozen=True, slots=True)
class RegressionTerm:
    """An effect of the catalogue, or a law, as columns of responses."""

    name: str
    channel: str
    coefficients: tuple[Coefficient, ...]
    log_trials: float = 0.0

    @property
    def key(self) -> str:
        """A model holds an effect once for each property that it moves."""
        return f"{self.name} of {self.coefficients[0].response}"


@dataclass(frozen=True, slots=True)
class RegressionResponse:
    """Rows of one response.

    Attributes
    ----------
    values, scale : (n,)
        As measured, and the relative size of their noise.
    group : (n,)
        Of equal noise, from 0.
    block : (n,)
        Rows that are held out together.
    order : (n,)
        Along which neighbours are compared.
    level, sigma, noise : float
        Prior of the mean, and where the noise is sought.
    nuisances : tuple of Coefficient
        Columns that are in every model.
    noise_sigma : float
        Prior of the noise's logarithm.
    independent_ratio : float
        How many of the rows are independent, by their number: bins of a tapered transform share information.
    """

    name: str
    values: Floats
    scale: Floats
    group: Ints
    block: Floats
    order: Floats
    level: float
    sigma: float
    noise: float
    nuisances: tuple[Coefficient, ...] = ()
    noise_sigma: float = _NOISE_SIGMA
    independent_ratio: float = 1.0


class RegressionModel:
    """Responses with some terms; ``use`` says which rows of each count."""

    def __init__(
        self,
        responses: Sequence[RegressionResponse],
        terms: Sequence[RegressionTerm],
        wider: float = 1.0,
        use: Sequence[Bools] | None = None,
    ) -> None:
        self.responses, self.terms = tuple(responses), tuple(terms)
        self.use = [np.ones(len(entry.values), dtype=np.bool_) for entry in responses] if use is None else use
        added = [entry for term in terms for entry in term.coefficients]
        self.parameters: list[Parameter] = []
        self._first = []
        for entry in responses:
            self._first.append(len(self.parameters))
            self.parameters += [Parameter(entry.name, entry.level, entry.sigma)]
            groups = range(int(entry.group.max()) + 1)
            noise = math.log(entry.noise)
            self.parameters += [
                Parameter(f"noise {group} of {entry.name}", noise, entry.noise_sigma) for group in groups
            ]
            self.parameters += [Parameter(column.key, 0.0, column.sigma) for column in entry.nuisances]
        count = len(self.parameters)
        self.parameters += [Parameter(entry.key, 0.0, wider * entry.sigma) for entry in added]
        ends = np.cumsum([count, *(len(term.coefficients) for term in terms)]).tolist()
        self.blocks = [range(first, last) for first, last in itertools.pairwise(ends)]
        self._design = []
        for k, response in enumerate(responses):
            design = np.zeros((len(response.values), len(self.parameters)))
            design[:, self._first[k]] = 1.0
            beside = self._first[k] + 2 + int(response.group.max())
            for j, nuisance in enumerate(response.nuisances):
                design[:, beside + j] = nuisance.column
            for j, coefficient in enumerate(added):
                if coefficient.response == response.name:
                    design[:, count + j] = coefficient.column
            self._design.append(design)

    def predicted(self, values: Floats, response: int) -> Floats:
        """Mean of a response's rows, (n,)."""
        return np.asarray(self._design[response] @ values)

    def residual(self, values: Floats, response: int) -> Floats:
        """Residual of a response's rows in standard deviations, (n,)."""
        entry = self.responses[response]
        return np.asarray((entry.values - self.predicted(values, response)) / self.noise(values, response))

    def log_density(self, values: Floats, response: int) -> Floats:
        """Log density of each row of a response times the ratio of independent rows, (n,)."""
        entry, noise = self.responses[response], self.noise(values, response)
        power = ((entry.values - self.predicted(values, response)) / noise) ** 2
        return np.asarray(entry.independent_ratio * (-0.5 * power - np.log(noise * math.sqrt(2.0 * np.pi))))

    def log_predictive(self, fitted: Fit[RegressionTerm, RegressionModel], response: int) -> Floats:
        """Log density of each row of a response that was not fitted, times the ratio of independent rows, (n,).

        With h the variance of the fitted mean over that of the noise, p_g the sum of h over the n_g rows of a group
        that were fitted, a new row is Student's t of n_g - p_g degrees of freedom, of variance noise^2 n_g/(n_g - p_g)
        times 1 + h. Where the fit is extrapolated, h is large.
        """
        entry, use = self.responses[response], self.use[response]
        mean_places = np.ones(len(fitted.values), dtype=np.bool_)
        for k, other in enumerate(self.responses):
            first = self._first[k] + 1
            mean_places[first : first + 1 + int(other.group.max())] = False
        design = np.where(mean_places, self._design[response], 0.0)
        noise = self.noise(fitted.values, response)
        h = np.einsum("ij,jk,ik->i", design, fitted.covariance, design) / noise**2
        fitted_rows = np.array([float((use & (entry.group == g)).sum()) for g in range(int(entry.group.max()) + 1)])
        spent = np.array([float(h[use & (entry.group == g)].sum()) for g in range(len(fitted_rows))])
        count = np.maximum(entry.independent_ratio * fitted_rows, 1.0)
        free = np.maximum(count - entry.independent_ratio * spent, 1.0)
        scale = noise * np.sqrt((count / free)[entry.group] * (1.0 + h))
        away = (entry.values - self.predicted(fitted.values, response)) / scale
        return np.asarray(entry.independent_ratio * (student_t.logpdf(away, free[entry.group]) - np.log(scale)))

    def log_likelihood(self, values: Floats, near: RegressionModel | None = None) -> float:
        """Log likelihood at a vector (p,) of the rows that count."""
        del near
        return float(sum(self.log_density(values, k)[use].sum() for k, use in enumerate(self.use)))

    def scores(self, values: Floats) -> Scores[RegressionModel]:
        """Log likelihood, gradient (p,) and information (p, p)."""
        count = len(values)
        gradient, information = np.zeros(count), np.zeros((count, count))
        for k, use in enumerate(self.use):
            entry, noise = self.responses[k], self.noise(values, k)[use]
            ratio, fitted = entry.independent_ratio, 1.0 - (_RESOLVED * entry.noise * entry.scale[use] / noise) ** 2
            r, white = self.residual(values, k)[use], self._design[k][use] / noise[:, None]
            gradient += ratio * (white.T @ r)
            information += ratio * (white.T @ white)
            place = self._first[k] + 1 + entry.group[use]
            np.add.at(gradient, place, ratio * fitted * (r**2 - 1.0))
            np.add.at(information, (place, place), 2.0 * ratio * fitted**2)
        return Scores(self.log_likelihood(values), gradient, information, self)

    def noise(self, values: Floats, response: int) -> Floats:
        """Standard deviation of each row of a response, (n,)."""
        entry = self.responses[response]
        fitted = np.exp(values[self._first[response] + 1 + entry.group])
        return np.asarray(np.hypot(fitted, _RESOLVED * entry.noise) * entry.scale)


RegressionFit = Fit[RegressionTerm, RegressionModel]


class Regressions(Recordings[RegressionTerm, RegressionModel]):
    """Responses, and the terms that may explain them."""

    def __init__(self, responses: Sequence[RegressionResponse], offered: Sequence[RegressionTerm]) -> None:
        self.responses, self._offered = tuple(responses), tuple(offered)

    @property
    def log_count(self) -> float:
        """Logarithm of the number of independent rows."""
        return math.log(sum(entry.independent_ratio * len(entry.values) for entry in self.responses))

    def null(self) -> RegressionFit:
        """Every response at its mean."""
        return self._climb(RegressionModel(self.responses, ()), None)

    def fit(
        self, terms: Sequence[RegressionTerm], near: RegressionFit, wider: float = 1.0, quick: bool = False
    ) -> RegressionFit:
        """Fit with some terms from what another fit has in common with it."""
        del quick
        return self._climb(RegressionModel(self.responses, terms, wider), near)

    def screen(self, fitted: RegressionFit, progress: Progress) -> Screening[RegressionTerm]:
        """Refit with every further term: with few rows a score at 0 is bounded, as the noise was fitted."""
        progress("screen", 0.0)
        keys = {term.key for term in fitted.terms}
        return no_correlation([self._tried(fitted, term) for term in self._offered if term.key not in keys])

    def refit(
        self, fitted: RegressionFit, candidate: Candidate[RegressionTerm]
    ) -> tuple[Candidate[RegressionTerm], RegressionFit]:
        """Fit with one term more."""
        return candidate, self.fit((*fitted.terms, candidate.term), fitted)

    def checks(self, fitted: RegressionFit) -> list[Check]:
        """Neighbours along each response's order, and outliers, against draws of the model."""
        rng, model = np.random.default_rng(_SEED), fitted.state
        drawn = [[rng.standard_normal(len(entry.values)) for entry in self.responses] for _ in range(_DRAWS)]
        tests = []
        for k, entry in enumerate(self.responses):
            white = model.residual(fitted.values, k)
            if len(white) < _FEWEST or float(np.mean(white**2)) < _ROUNDING:
                continue
            order = np.argsort(entry.order, kind="stable")
            real = _statistics(white[order])
            table = np.stack([_statistics(rows[k][order]) for rows in drawn])
            for name, value, chance in zip(("neighbours", "outliers"), real, table.T, strict=True):
                tests.append(Check(f"{entry.name}: {name}", strength(float(value), chance), LIMIT))
        return sorted(tests, key=lambda entry: -abs(entry.z))

    def folds(self) -> list[Callable[[RegressionFit], list[Prediction]]]:
        """Each block of rows in turn."""
        blocks = sorted({float(block) for entry in self.responses for block in entry.block})
        return [lambda fitted, block=block: [self._predict(fitted, block)] for block in blocks]  # type: ignore[misc]

    def without(self, fitted: RegressionFit, block: float) -> RegressionFit:
        """The same model fitted without a block."""
        use = [entry.block != block for entry in self.responses]
        return self._climb(RegressionModel(self.responses, fitted.terms, 1.0, use), fitted)

    def _predict(self, fitted: RegressionFit, block: float) -> Prediction:
        again = self.without(fitted, block)
        inside = [entry.block == block for entry in self.responses]
        scores = {
            entry.name: float(again.state.log_predictive(again, k)[rows].sum())
            for k, (entry, rows) in enumerate(zip(self.responses, inside, strict=True))
        }
        first, rows = self.responses[0], inside[0]
        error = (first.values - again.state.predicted(again.values, 0))[rows]
        signal = (first.values - first.values.mean())[rows]
        return Prediction(scores, float(np.sum(error**2)), float(np.sum(signal**2)), int(rows.sum()))

    def _tried(self, fitted: RegressionFit, term: RegressionTerm) -> Candidate[RegressionTerm]:
        again = self.fit((*fitted.terms, term), fitted)
        power = max(2.0 * (again.log_likelihood - fitted.log_likelihood), 0.0)
        z = normal_score(float(chi2.logsf(power, len(term.coefficients))))
        return Candidate(term, z, again.log_evidence - fitted.log_evidence)

    def _climb(self, model: RegressionModel, near: RegressionFit | None) -> RegressionFit:
        before = {} if near is None else dict(zip(near.keys, near.values.tolist(), strict=True))
        start = np.array([before.get(entry.key, entry.centre) for entry in model.parameters])
        return climb(model, model.terms, model.blocks, start, _SCORING_STEPS)


def _statistics(white: Floats) -> Floats:
    squares = white * white
    power = float(np.mean(squares))
    return np.array([float(np.mean(white[1:] * white[:-1])) / power, math.log(float(np.mean(squares**2)) / power**2)])
