"""Smoother, bias parameters, forecast, lines and Whittle fit against numpy; the filter: test_tracking_kernel."""

from __future__ import annotations

import numpy as np
import pytest

from companion.core.kernels.arrays import make_history
from companion.core.tracking import bias_information, prediction
from companion.core.tracking.adaptation import whittle
from companion.core.tracking.adaptation.periodogram import Periodogram, make_periodogram
from companion.core.tracking.adaptation.whittle import LogNormalPrior
from companion.core.tracking.estimates import oscillation
from companion.core.tracking.line_peaks import squared_envelope
from companion.core.tracking.line_removal import LineStates, copied, line_states, remove_lines
from companion.core.tracking.parameters import parameter_index
from companion.core.tracking.prediction import _FilterSnapshot, _OutputIndices
from companion.core.tracking.row_noise import noise_terms
from companion.core.tracking.smoother import backward_pass
from companion.core.tracking.validity import rate_squares
from companion.records import Floats
from sitl_tests.native import spectra
from sitl_tests.reference.kernels import bias_information as plain_bias
from sitl_tests.reference.kernels import lines as plain_lines
from sitl_tests.reference.kernels import model_spectrum as plain_spectrum
from sitl_tests.reference.kernels import prediction as plain_prediction
from sitl_tests.reference.kernels import row_noise as plain_row_noise
from sitl_tests.reference.kernels import smoother as plain_smoother
from sitl_tests.reference.kernels import whittle as plain_whittle

STEP_S = 0.004


def _agree(got: object, expected: object, rtol: float = 1e-9, name: str = "") -> None:
    size = float(np.abs(np.asarray(expected)).max(initial=0.0))
    np.testing.assert_allclose(got, expected, rtol=rtol, atol=1e-2 * rtol * size + 1e-300, err_msg=name)


def _stable(rng: np.random.Generator, n: int) -> Floats:
    return 0.7 * np.linalg.qr(rng.standard_normal((n, n)))[0]


def _spread(rng: np.random.Generator, n: int) -> Floats:
    root = rng.standard_normal((n, n))
    return root @ root.T / n


@pytest.mark.parametrize(("n", "parameters", "size", "count"), [(12, 5, 40, 40), (24, 21, 16, 9), (3, 0, 1, 1)])
def test_the_adjoint_runs_back_as_in_numpy(n: int, parameters: int, size: int, count: int) -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        history = make_history(size, n, parameters, 9)
        for column in (history.whitened_H, history.whitened_innovation, history.whitened_cross_cov):
            column[:] = 0.2 * rng.standard_normal(column.shape)
        history.transition[:] = [_stable(rng, n) for _ in history.transition]
        history.transition_index[:] = rng.integers(0, len(history.transition), size)
        history.row_count[:] = rng.integers(0, 10, size)
        first = int(rng.integers(0, 100))
        for got, expected in zip(
            backward_pass(history, first, count), plain_smoother.backward_pass(history, first, count), strict=True
        ):
            _agree(got, expected)


@pytest.mark.parametrize(("n", "estimated", "considered"), [(24, 17, 5), (12, 3, 0), (5, 0, 4), (4, 1, 1), (3, 0, 0)])
def test_bias_parameters_age_and_are_solved_as_in_numpy(n: int, estimated: int, considered: int) -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        c = estimated + considered
        sigma = 10.0 ** rng.uniform(-4, 0, c)
        learned = rng.standard_normal((3 * c + 3, 1 + c)) * np.concatenate(
            [[1.0], 10.0 ** rng.uniform(-1, 2, c) / sigma]
        )
        information = learned.T @ learned
        x, covariance = rng.standard_normal((n + 1, 1 + c)), _spread(rng, n)
        order = rng.permutation(c)
        kinds = np.sort(order[:estimated]), np.sort(order[estimated:])
        wandering = 1 + rng.permutation(c)[: c // 2]
        compiled, plain = ([each.copy() for each in (information, x, covariance)] for _ in range(2))
        bias_information.age_information(*compiled, wandering, sigma, 0.9)
        plain_bias.age_information(*plain, wandering, sigma, 0.9)
        for got, expected in zip(compiled, plain, strict=True):
            np.testing.assert_allclose(got, expected, rtol=1e-13, atol=1e-14 * float(np.abs(expected).max()))
        got, expected = ((np.zeros(c), np.diag(sigma**2)) for _ in range(2))
        bias_information.solve_parameters(information, sigma, *kinds, *got)
        plain_bias.solve_parameters(information, sigma, *kinds, *expected)
        np.testing.assert_allclose(got[0] / sigma, expected[0] / sigma, rtol=1e-9, atol=1e-11)
        scale = np.outer(sigma, sigma)
        np.testing.assert_allclose(got[1] / scale, expected[1] / scale, rtol=1e-9, atol=1e-11)
        assert np.array_equal(got[1], got[1].T)


@pytest.mark.parametrize("entry", [np.nan, np.inf, -1e30])
def test_information_that_has_run_away_gives_no_number(entry: float) -> None:
    information = np.eye(4)
    information[2, 2] = entry
    parameters, covariance = np.zeros(3), np.eye(3)
    bias_information.solve_parameters(information, np.ones(3), np.array([0, 1]), np.array([2]), parameters, covariance)
    assert np.isnan(parameters[:2]).all()
    assert np.isnan(covariance[:2]).all()
    assert parameters[2] == 0.0
    assert covariance[2, 2] == 1.0


def test_places_outside_the_information_are_refused() -> None:
    information, x, covariance, sigma, none = np.eye(3), np.zeros((3, 3)), np.eye(2), np.ones(2), np.array([], np.int64)
    for place in (-1, 2):
        with pytest.raises(TypeError, match="bias_solve"):
            bias_information.solve_parameters(information, sigma, np.array([place]), none, np.zeros(2), covariance)
        with pytest.raises(TypeError, match="bias_age"):
            bias_information.age_information(information, x, covariance, np.array([place + 1]), sigma, 0.9)


@pytest.mark.parametrize(("rows", "sources"), [(9, 6), (7, 6), (2, 1), (1, 3)])
def test_terms_of_the_rows_noise_are_those_of_numpy(rows: int, sources: int) -> None:
    for seed in range(8):
        rng = np.random.default_rng(seed)
        count = int(rng.integers(2, 60))
        innovation = rng.standard_normal((count, 9))
        covariance = np.stack([np.tril(_spread(rng, 9) + 0.01 * np.eye(9)) for _ in range(count)])
        steps = np.flatnonzero(rng.random(count - 1) < 0.7) + 1
        used = np.sort(rng.permutation(9)[:rows])
        arguments = (innovation, covariance, steps, used, rng.standard_normal((9, sources)))
        terms = noise_terms(*arguments)
        assert terms is not None
        _agree(terms, plain_row_noise.noise_terms(*arguments), 1e-8)


def test_rows_whose_covariance_has_run_away_tell_no_noise() -> None:
    covariance = np.stack([np.eye(9), np.eye(9), -np.eye(9)])
    innovation, columns, rows = np.ones((3, 9)), np.ones((9, 2)), np.arange(9)
    assert noise_terms(innovation, covariance, np.array([1]), rows, columns) is not None
    assert noise_terms(innovation, covariance, np.array([1, 2]), rows, columns) is None
    for step, row in ((0, 1), (3, 1), (1, 9), (1, -1)):
        with pytest.raises(TypeError, match="noise_terms"):
            noise_terms(innovation, covariance, np.array([step]), np.array([row]), columns)


@pytest.mark.parametrize("factors", [0, 2])
def test_the_wing_runs_ahead_as_in_numpy(factors: int) -> None:
    for seed in range(8):
        rng = np.random.default_rng(seed)
        states, n, c, count = 20, 16, 7, int(rng.integers(1, 40))
        modal_states = np.array([0, 1, 4, 5, 8, 9, 12, 13])
        transition, noise = _stable(rng, n), _spread(rng, n)
        powers = prediction.powers(transition, noise, modal_states, count)
        for got, expected in zip(powers, plain_prediction.powers(transition, noise, modal_states, count), strict=True):
            _agree(got, expected)
        indices = _OutputIndices(
            modal_states, np.array([0, 4]), 0, np.arange(factors), np.array([1, 5][:factors], np.int64),
            rng.standard_normal((factors, 2)),
        )  # fmt: skip
        snapshot = _FilterSnapshot(
            rng.standard_normal((states + 1, 1 + c)), rng.standard_normal(1 + c), _spread(rng, states), _spread(rng, c)
        )
        arguments = (*powers, rng.standard_normal((2, 8)), indices, snapshot)
        for got, expected in zip(
            prediction.run_ahead(*arguments), plain_prediction.run_ahead(*arguments), strict=True
        ):  # fmt: skip
            _agree(got, expected)


def test_squares_of_rates_are_summed_as_in_numpy() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        size, n, width = int(rng.integers(1, 20)), 6, int(rng.integers(1, 12))
        states, one_and_bias = rng.standard_normal((size, n, width)), rng.standard_normal(width)
        arguments = (states, int(rng.integers(0, 50)), int(rng.integers(0, size + 1)), rng.permutation(n)[:2])
        _agree(rate_squares(*arguments, one_and_bias), plain_prediction.rate_squares(*arguments, one_and_bias))
    with pytest.raises(TypeError, match="estimate_squares"):
        rate_squares(states, 0, 1, np.array([0, n]), one_and_bias)


def test_an_oscillation_is_described_as_in_numpy() -> None:
    for seed in range(30):
        rng = np.random.default_rng(seed)
        state, covariance = 0.02 * rng.standard_normal(3), 1e-6 * _spread(rng, 3)
        arguments = (state, covariance, 0.01, rng.uniform(2, 30), 0.03, rng.uniform(0, 0.5))
        _agree(oscillation(*arguments), plain_prediction.oscillation(*arguments))


@pytest.mark.parametrize("multiples", [[[12]], [[12], [12, 6, 24], [12, 36]]])
def test_lines_are_followed_and_removed_as_in_python(multiples: list[list[int]]) -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        t_ns = np.cumsum(rng.integers(900_000, 1_100_000, 400))
        t_ns[int(rng.integers(50, 350)) :] += int(rng.choice([0, 1_000_000, 5_000_000]))
        frequency_hz = rng.uniform(40, 180, len(multiples))
        t = 1e-9 * t_ns[:, None]
        values = 0.01 * rng.standard_normal((400, 6))
        for hz in frequency_hz:
            values += rng.standard_normal(6) * np.cos(2 * np.pi * 1.01 * hz * t + rng.uniform(0, 6, 6))
        values[int(rng.integers(0, 400)), 2] += 100.0
        compiled: LineStates = line_states(frequency_hz, multiples, np.full(6, 1e4), 1e3)
        plain = copied(compiled)
        for first, end in ((0, 250), (250, 251), (251, 400)):
            arguments = (t_ns[:end], values[:end], first, 1e-3)
            got = remove_lines(*arguments, compiled)
            with np.errstate(invalid="ignore"):  # before the first sample there is an infinite gap
                _agree(got, plain_lines.remove_lines(*arguments, plain), 1e-7)
        for name, actual, desired in zip(LineStates._fields, compiled, plain, strict=True):
            _agree(actual, desired, 1e-6, name)


@pytest.mark.parametrize("length", [2, 7, 100, 400])
def test_an_envelope_varies_as_in_numpy(length: int) -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        t_s, frequency_hz = np.cumsum(rng.uniform(0.9e-3, 1.1e-3, 400)), float(rng.uniform(20, 200))
        samples = rng.standard_normal(400) + 3.0 * np.cos(2.0 * np.pi * frequency_hz * t_s)
        arguments = (samples, t_s, frequency_hz, length)
        _agree(squared_envelope(*arguments), plain_lines.squared_envelope(*arguments))
    with pytest.raises(TypeError, match="lines_envelope"):
        squared_envelope(samples, t_s, frequency_hz, 401)


def _family(modes: int) -> Floats:
    """Log parameters of a family: the first mode with the gust's corners, then the further ones."""
    further = [[*np.log([27.0 + 9.0 * k, 0.02, 3e-3]), 0.3] for k in range(1, modes)]
    return np.concatenate([np.log([5.0, 0.04, 0.2, 2.0, 20.0]), *further])


def _problem(rng: np.random.Generator, modes: list[int]) -> tuple[Periodogram, LogNormalPrior, Floats]:
    samples = np.convolve(rng.standard_normal(1020), np.sin(0.13 * np.arange(60)) * 0.95 ** np.arange(60))[:1000]
    noise = 10.0 ** rng.uniform(-4, -2)
    periodogram = make_periodogram(samples, STEP_S, (0.25, 11.0, 120.0), lambda hz: np.full_like(hz, noise))
    start = np.concatenate([_family(count) for count in modes])
    mean = start + 0.3 * rng.standard_normal(len(start))
    sigma = rng.uniform(0.1, 2.0, len(start))
    reach = rng.choice([0.2, 4.0])
    prior = LogNormalPrior(
        mean, sigma, mean - reach * sigma, mean + reach * sigma, rng.uniform(4, 7, len(modes)), parameter_index(modes)
    )
    return periodogram, prior, np.clip(start, prior.low, prior.high)


@pytest.mark.parametrize("modes", [[1], [2], [3], [2, 2]])
def test_the_whittle_fit_is_that_of_numpy(modes: list[int]) -> None:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        periodogram, prior, start = _problem(rng, modes)
        problem = (periodogram, prior, start)
        _agree(whittle.expected_power(*problem), plain_whittle.expected_power(*problem))
        assert whittle.neg_log_likelihood(*problem) == pytest.approx(
            plain_whittle.neg_log_likelihood(*problem), rel=1e-9
        )
        assert whittle.neg_log_posterior(*problem) == pytest.approx(plain_whittle.neg_log_posterior(*problem), rel=1e-9)
        for got, expected in zip(
            whittle.gradient_and_fisher(*problem), plain_whittle.gradient_and_fisher(*problem), strict=True
        ):  # fmt: skip
            _agree(got, expected, 1e-7)
        fitted = whittle.fit(*problem, 3)
        log_params, best, information = plain_whittle.improve(*problem, 3)
        np.testing.assert_allclose(fitted.log_params, log_params, rtol=1e-5, atol=1e-6)
        assert fitted.neg_log_posterior == pytest.approx(best, rel=1e-7)
        np.testing.assert_allclose(fitted.log_sigma, np.sqrt(np.diag(np.linalg.inv(information))), rtol=1e-4)


@pytest.mark.parametrize("modes", [1, 2, 4])
def test_a_family_s_spectrum_and_its_slopes_are_those_of_numpy(modes: int) -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        periodogram, _, log_params = _problem(rng, [modes])
        arguments = (log_params, periodogram.grid, 5.3)
        _agree(spectra.acceleration_density(*arguments), plain_spectrum.acceleration_density(*arguments))
        _agree(spectra.acceleration_gradient(*arguments), plain_spectrum.acceleration_gradient(*arguments), 1e-8)
