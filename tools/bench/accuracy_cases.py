"""The cases of the accuracy table: which truths, how often, and what must hold."""

from __future__ import annotations

from dataclasses import dataclass, replace

from tools.bench.accuracy_belief import Perturbation, second_mode
from tools.reference.rigid import LEVEL, RigidMotion, flight
from tools.reference.spec import DRYDEN, FIVE_TWENTY, TWO_EIGHT, WHITE, GustShape, ModeSpec, SensorSpec, TruthSpec

FREQUENCIES_HZ = (3.0, 5.0, 10.0, 20.0)
DAMPINGS = (0.02, 0.05, 0.12)
SHAPES = (WHITE, DRYDEN, TWO_EIGHT, FIVE_TWENTY)
_RMS_M = {3.0: 0.008, 5.0: 0.005, 10.0: 0.002, 20.0: 0.0007}
_ANTISYMMETRIC_RATIO = 1.28
_TRIM_AT_5_HZ_M = 0.0149
SUITES = (
    "six-axis",
    "vertical",
    "slope",
    "drift",
    "drift-vertical",
    "second-unknown",
    "flight",
    "priors",
    "priors-flight",
)


@dataclass(frozen=True, slots=True)
class Cell:
    """One truth with the seeds that fly it."""

    suite: str
    spec: TruthSpec
    perturbation: Perturbation
    seeds: tuple[int, ...]

    @property
    def label(self) -> str:
        """Suite, frequency, damping, gust and second mode."""
        mode = self.spec.symmetric
        second = "+2nd" if self.spec.second_symmetric else ""
        return f"{self.suite} {mode.frequency_hz:g} Hz {mode.damping:g} {self.spec.gust.name}{second}"


def cells(suite: str, seeds: int, duration_s: float) -> list[Cell]:
    """Give the cells of one suite, with ``seeds`` runs in all; the pooled suites take twice as many.

    With 50 seeds the pooled suites meet every combination of frequency, damping, gust and second mode once.
    """
    if suite in ("six-axis", "vertical"):
        return _pooled(suite, 2 * seeds, duration_s)
    return _gathered(suite, [_special(suite, i, duration_s) for i in range(seeds)])


def _pooled(suite: str, runs: int, duration_s: float) -> list[Cell]:
    """Run i takes frequency i mod 4, and then combination i // 4 of damping, gust and second mode."""
    rows = []
    for i in range(runs):
        k = i // 4
        spec = _spec(
            FREQUENCIES_HZ[i % 4],
            DAMPINGS[k % 3],
            SHAPES[k // 3 % 4],
            second=(k // 12 + k) % 2 == 1,
            duration_s=duration_s,
            sends="z" if suite == "vertical" else "xyzpqr",
        )
        rows.append((spec, Perturbation(), 1000 * SUITES.index(suite) + i))
    return _gathered(suite, rows)


def _special(suite: str, i: int, duration_s: float) -> tuple[TruthSpec, Perturbation, int]:
    seed = 10_000 * (1 + SUITES.index(suite)) + i
    frequency, damping, shape = FREQUENCIES_HZ[i % 4], DAMPINGS[i // 4 % 3], SHAPES[i // 12 % 4]
    if suite == "slope":
        return _spec(5.0, 0.03, SHAPES[i % 4], duration_s=duration_s), Perturbation(), seed
    if suite.startswith("drift"):
        sends = "z" if suite.endswith("vertical") else "xyzpqr"
        spec = _spec(frequency, damping, shape, duration_s=duration_s, sends=sends)
        return replace(spec, drift_per_s=0.01 if i % 2 else -0.01), Perturbation(), seed
    if suite == "second-unknown":
        return _spec(frequency, damping, shape, second=True, duration_s=duration_s), Perturbation(second="none"), seed
    motion = flight(i % 4) if "flight" in suite else LEVEL
    if suite == "flight":
        return _spec(frequency, damping, shape, motion=motion, duration_s=duration_s), Perturbation(), seed
    frequency = (3.0, 5.0, 10.0)[i % 3]
    shape = (DRYDEN, TWO_EIGHT, FIVE_TWENTY)[i // 3 % 3]
    return _with_prior_errors(_spec(frequency, 0.03, shape, motion=motion, duration_s=duration_s)), Perturbation(), seed


def _spec(
    frequency_hz: float,
    damping: float,
    shape: GustShape,
    *,
    second: bool = False,
    duration_s: float,
    sends: str = "xyzpqr",
    motion: RigidMotion = LEVEL,
) -> TruthSpec:
    first = ModeSpec(frequency_hz, damping, _RMS_M[frequency_hz])
    trim = _TRIM_AT_5_HZ_M * (5.0 / frequency_hz) ** 2
    return TruthSpec(
        symmetric=first,
        antisymmetric=replace(first, frequency_hz=_ANTISYMMETRIC_RATIO * frequency_hz),
        gust=shape,
        trim_bend_m=trim,
        bend_per_g_m=trim,
        motion=motion,
        second_symmetric=second_mode(first) if second else None,
        duration_s=duration_s,
        left=SensorSpec(-1.0, sends),
        right=SensorSpec(1.0, sends),
    )


def _with_prior_errors(spec: TruthSpec) -> TruthSpec:
    """Draw the errors of config/airframes/nadir-2m.toml."""
    root = replace(spec.root, accel_scale_sigma=0.005, gyro_scale_sigma=0.003, misalignment_sigma_rad=0.003)
    tip = {"accel_scale_sigma": 0.005, "gyro_scale_sigma": 0.005, "misalignment_sigma_rad": 0.005}
    return replace(
        spec,
        root=root,
        left=replace(spec.left, time_offset_sigma_s=0.0002, **tip),
        right=replace(spec.right, time_offset_sigma_s=0.0002, **tip),
        slope_sigma_ratio=0.01,
        trim_sigma_m=0.0002,
        bend_per_g_sigma_m=0.0004,
    )


def _gathered(suite: str, rows: list[tuple[TruthSpec, Perturbation, int]]) -> list[Cell]:
    """Put the seeds of equal truths together, for they share one reference run."""
    seeds: dict[tuple[TruthSpec, Perturbation], list[int]] = {}
    for spec, perturbation, seed in rows:
        seeds.setdefault((spec, perturbation), []).append(seed)
    return [Cell(suite, spec, perturbation, tuple(truth_seeds)) for (spec, perturbation), truth_seeds in seeds.items()]
