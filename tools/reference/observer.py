"""The wing as the reference knows it: exact state space at 250 Hz, and every sensor as a linear view of the state.

States: ``[q, v, gust...]`` of every mode (q about the believed trim), the roll rate and acceleration, then biases.
Rigid motion is as good as arbitrary: forces are taken out by differences to the root; the roll acceleration has
3 rad/s^2 below 5 Hz, hundreds of times what the gyro cannot see. (White roll acceleration would be wrong: no sensor
could then know the roll rate inside a millisecond.)

A step holds four samples. Their averages are sufficient for slow axes; of the vertical axis the first moment is kept
too, for under a white gust the path inside the step would be lost with it (a tenth to a half of the accuracy of a
vertical-only node). The gust is felt by the accelerometer: process and measurement noise are correlated, exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.linalg

from tools.reference.discretise import Discrete, averages, stacked
from tools.reference.load import chain, intensity
from tools.reference.spec import GRAVITY_MPS2, SAMPLE_S, TruthSpec
from tools.reference.truth import frequency_factor

Floats = npt.NDArray[np.float64]
SAMPLES_PER_STEP = 4
REFERENCE_STEP_S = SAMPLES_PER_STEP * SAMPLE_S
MEAN = np.full(SAMPLES_PER_STEP, 1.0 / SAMPLES_PER_STEP)
MOMENT = (np.arange(SAMPLES_PER_STEP) - (SAMPLES_PER_STEP - 1) / 2) / SAMPLES_PER_STEP
_ROLL_ACCELERATION_RADPS2, _ROLL_CORNER_RADPS = 3.0, 2 * np.pi * 5.0
_BIASES = ("z_left", "z_right", "z_root", "y_left", "y_right", "p_root", "p_left", "p_right", "r_root")


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the states are, and the basis that every measurement is a combination of."""

    modes: int
    chain_sizes: tuple[int, ...]
    biases: tuple[str, ...]

    def q(self, mode: int) -> int:
        """Index of a mode's deflection; its rate follows."""
        return sum(self.chain_sizes[:mode])

    @property
    def p(self) -> int:
        """Index of the roll rate; the roll acceleration follows."""
        return sum(self.chain_sizes)

    def bias(self, name: str) -> int:
        """Index of a bias."""
        return self.p + 2 + self.biases.index(name)

    @property
    def size(self) -> int:
        """Number of states."""
        return self.p + 2 + len(self.biases)

    def basis(self, kind: str, mode: int = 0) -> int:
        """Index in the basis: mean ``q``, ``v``, ``a``, first moment ``a1`` of a mode; ``p``, ``alpha``, ``alpha1``."""
        order = {"q": 0, "v": 1, "a": 2, "a1": 3}
        if kind in order:
            return order[kind] * self.modes + mode
        return 4 * self.modes + ("p", "alpha", "alpha1").index(kind)

    @property
    def basis_size(self) -> int:
        """Length of the basis."""
        return 4 * self.modes + 3


@dataclass(frozen=True, slots=True)
class Dynamics:
    """One segment's exact discretisation; ``push`` and ``push_view`` are the answer to a load factor excess of 1.

    ``fine`` and ``fine_push`` carry the state over one sample.
    """

    step: Discrete
    push: Floats
    push_view: Floats
    fine: Floats
    fine_push: Floats


def layout_of(spec: TruthSpec) -> Layout:
    """States that the sensors of ``spec`` call for."""
    tips = spec.left.sends
    wanted = [name for name in _BIASES if name.endswith("root") or name[0] in tips]
    if "y" not in tips:
        wanted.remove("r_root")
    return Layout(len(spec.modes), (2 + len(spec.gust.poles_hz),) * len(spec.modes), tuple(wanted))


def dynamics(spec: TruthSpec, layout: Layout, t_s: float) -> Dynamics:
    """Discretise the system in force at ``t_s`` over one step."""
    A, B, C, D, W, load = _continuous(spec, layout, t_s)
    fine = averages(A, B, C, D, W, SAMPLE_S)
    rows = _reduction(layout)
    step = stacked(fine, SAMPLES_PER_STEP).project(rows)
    return Dynamics(step, *_held_input(A, C, load, rows), fine.F, _held_push(A, load))


def initial_covariance(spec: TruthSpec, layout: Layout) -> Floats:
    """Stationary modes, an unknown roll rate, biases at their prior."""
    A, B, _, _, W, _ = _continuous(spec, layout, 0.0)
    P = np.zeros((layout.size, layout.size))
    n = layout.p
    P[:n, :n] = scipy.linalg.solve_continuous_lyapunov(A[:n, :n], -(B @ W @ B.T)[:n, :n])
    P[n, n], P[n + 1, n + 1] = 10.0, _ROLL_ACCELERATION_RADPS2**2
    P[n + 2 :, n + 2 :] = _bias_covariance(spec, layout)
    return P


def _continuous(spec: TruthSpec, layout: Layout, t_s: float) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats]:
    """``A, B, C, D, W`` with the rows of ``C`` as q, v, a of every mode, p, alpha; and the load-factor input."""
    n, modes = layout.size, layout.modes
    A, B = np.zeros((n, n)), np.zeros((n, modes + 1 + len(layout.biases)))
    C, D = np.zeros((3 * modes + 2, n)), np.zeros((3 * modes + 2, B.shape[1]))
    W = np.zeros((B.shape[1], B.shape[1]))
    load = np.zeros(n)
    for i, mode in enumerate(spec.modes):
        at, size = layout.q(i), layout.chain_sizes[i]
        frequency = mode.frequency_hz * frequency_factor(spec, i, t_s)
        A[at : at + size, at : at + size], b, row = chain(frequency, mode.damping, spec.gust)
        B[at : at + size, i] = b
        W[i, i] = intensity(mode, spec.gust)
        C[i, at] = C[modes + i, at + 1] = 1.0
        C[2 * modes + i, at : at + size], D[2 * modes + i, i] = row, b[1]
    stiffness = -A[1, 0]
    load[1] = stiffness * spec.bend_per_g_m
    z_root = layout.bias("z_root")
    A[1, z_root] = C[2 * modes, z_root] = load[1] / GRAVITY_MPS2  # the root's bias hides in the measured load factor
    roll, turn = layout.p, layout.p + 1
    A[roll, turn] = B[turn, modes] = C[3 * modes, roll] = C[3 * modes + 1, turn] = 1.0
    A[turn, turn] = -_ROLL_CORNER_RADPS
    W[modes, modes] = 2 * _ROLL_CORNER_RADPS * _ROLL_ACCELERATION_RADPS2**2
    slow = slice(turn + 1, n)
    time_s = spec.root.bias_time_s
    A[slow, slow] = -np.eye(len(layout.biases)) / time_s
    B[slow, modes + 1 :] = np.eye(len(layout.biases))
    W[modes + 1 :, modes + 1 :] = _bias_covariance(spec, layout) * 2 / time_s
    return A, B, C, D, W, load


def _bias_covariance(spec: TruthSpec, layout: Layout) -> Floats:
    """Prior of the biases; a lateral bias is that of tip minus root, so the two share the root's part."""
    sensors = dict(zip(("root", "left", "right"), spec.sensors, strict=True))
    covariance = np.zeros((len(layout.biases),) * 2)
    for i, name in enumerate(layout.biases):
        axis, place = name.split("_")
        sensor = sensors[place]
        sigma = sensor.gyro_bias_sigma_radps if axis in "pr" else sensor.accel_bias_sigma_mps2
        covariance[i, i] = sigma**2
        if axis == "y":
            shared = [k for k, other in enumerate(layout.biases) if other[0] == "y"]
            covariance[i, shared] += spec.root.accel_bias_sigma_mps2**2
    return covariance


def _reduction(layout: Layout) -> Floats:
    """From the outputs of four samples to the basis."""
    modes = layout.modes
    outputs = 3 * modes + 2
    rows = np.zeros((layout.basis_size, SAMPLES_PER_STEP * outputs))
    for sample in range(SAMPLES_PER_STEP):
        block = rows[:, sample * outputs : (sample + 1) * outputs]
        block[: 3 * modes, : 3 * modes] = np.eye(3 * modes) * MEAN[sample]
        block[3 * modes : 4 * modes, 2 * modes : 3 * modes] = np.eye(modes) * MOMENT[sample]
        block[layout.basis("p"), 3 * modes] = MEAN[sample]
        block[layout.basis("alpha"), 3 * modes + 1] = MEAN[sample]
        block[layout.basis("alpha1"), 3 * modes + 1] = MOMENT[sample]
    return rows


def _held_push(A: Floats, load: Floats) -> Floats:
    n = len(A)
    system = np.zeros((n + 1, n + 1))
    system[:n, :n], system[:n, n] = A, load
    return np.asarray(scipy.linalg.expm(system * SAMPLE_S)[:n, n])


def _held_input(A: Floats, C: Floats, load: Floats, rows: Floats) -> tuple[Floats, Floats]:
    """Answer of the state and of the basis to a unit load-factor excess held over the step."""
    n, m = len(A), len(C)
    system = np.zeros((n + m + 1, n + m + 1))
    system[:n, :n], system[n : n + m, :n] = A, C
    system[:n, -1] = load
    # acceleration of the symmetric mode contains the load directly
    direct = np.zeros(m)
    direct[(m - 2) // 3 * 2] = load[1]
    system[n : n + m, -1] = direct
    exponential = scipy.linalg.expm(system * SAMPLE_S)
    state, outputs = np.zeros(n), []
    for _ in range(SAMPLES_PER_STEP):
        both = exponential @ np.concatenate([state, np.zeros(m), [1.0]])
        outputs.append(both[n : n + m] / SAMPLE_S)
        state = both[:n]
    return state, rows @ np.concatenate(outputs)
