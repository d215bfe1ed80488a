"""Phase of a real beam while its support moves (DROPBEAR data set 8), from one accelerometer, judged by strain gauges.

The cantilever's roller support travels and its first bending frequency with it, 25 to 43 Hz. The accelerometer alone is
tracked, causally, with one setting for all files. The truth is the mean of two strain gauges, band-passed without phase
(18 to 55 Hz), its phase that of the analytic signal; first bending has strain and tip displacement in antiphase by the
gauges' polarity. The floor is the accelerometer treated off line in the same way, future samples included. The slow
series have no gauges: there the judge is the off-line accelerometer itself, and it says so.

Two things of physics stand between accelerometer and strain. In free decay the acceleration leads the negative
displacement by 2 zeta, which the tracker's model holds. And the accelerometer reads late: between 160 and 480 Hz,
outside the band that is judged, it lags the gauges by 7 deg at 200 Hz and 15 deg at 460 Hz, which is 0.10 ms, as its
upper corner makes one expect.

Medians are over all instants at which the truth can be read, and an instant without an estimate counts as 90 deg there;
the 90th percentile and the column "any" (wherever there is an estimate, readable or not) are over the estimates.

Frequencies and wander are the bands in which resonances are seen over the roller's travel; damping, load and settling
time were found by trying, on these very files. ``--leave-one-out`` asks what that was worth: every setting is halved
and doubled, for each file the best is chosen on the others alone and judged on the one that was left out; the spread
over all that were tried stands beside it.
"""

from __future__ import annotations

import dataclasses
import os
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.signal import butter, hilbert, sosfiltfilt

from companion.records import Floats, Reject
from tools.bench.single_sensor_ekf import Resonance, SingleSensorModeEkf

DATA = Path(os.environ.get("SPANWISE_DATA", Path(__file__).resolve().parents[3] / "shared")) / "measured" / "dropbear8"
# first, second and third bending, over the whole travel of the roller; the same for every file
RESONANCES = (
    Resonance(frequency_hz=31.0, wander=0.25, settle_s=1.0, damping=0.005, load=0.5),
    Resonance(frequency_hz=195.0, wander=0.13, settle_s=0.3, damping=0.01, load=30.0),
    Resonance(frequency_hz=450.0, wander=0.08, settle_s=0.3, damping=0.02, load=30.0),
)
FIXED = (Resonance(31.0, 0.001, 1.0, 0.005, 0.5), *RESONANCES[1:])
LEADS_S = (0.0, 0.010)
TARGETS_DEG = (2.0, 3.5)
_AVERAGE = 5  # 5 kHz to 1 kHz
_NOISE_MPS2 = 0.002  # at rest, averaged
_SENSOR_LAG_S = 1.0e-4
_MPS2_PER_VOLT = 0.980665  # PCB 393B05: 10 V/g
_BAND_HZ = (18.0, 55.0)
_READABLE_V = 0.002  # amplitude of strain: the gauges read in steps of 1.2 mV
_FIRST_S, _LAST_S = 0.5, 0.1  # edges of the judge's filter
_EVERY = 5  # ms from phase to phase where many settings are tried


@dataclass(frozen=True, slots=True)
class Trial:
    """One file: ``strain_v`` (n, gauges), gauges 0 or 2."""

    name: str
    rate_hz: float
    acceleration_mps2: Floats
    strain_v: Floats
    support_v: Floats


@dataclass(frozen=True, slots=True)
class Followed:
    """Answers of a tracker at its steps: (k, leads) phases and sigmas, NaN where refused; (k,) index into the trial."""

    at: npt.NDArray[np.int64]
    phase_rad: Floats
    sigma_rad: Floats
    frequency_hz: Floats


@dataclass(frozen=True, slots=True)
class Score:
    """Phase errors of one trial, degrees; per lead where a pair. ``within`` are shares inside 1 and 2 sigma."""

    name: str
    judge: str
    judged: float
    median_deg: tuple[float, float]
    p90_deg: tuple[float, float]
    any_deg: tuple[float, float]
    fixed_deg: tuple[float, float]
    floor_deg: float
    gauges_deg: float
    frequency_hz: float
    within: tuple[float, float]
    refused: float


def load(path: Path) -> Trial:
    """Read one text file; columns by their names in its header."""
    with path.open(encoding="latin-1") as lines:
        head = [next(lines).rstrip("\n") for _ in range(9)]
    rate_hz = float(next(line for line in head if line.startswith("Sampling Frequency")).rsplit("-", 1)[1])
    columns = head[5].split("\t")
    values = np.loadtxt(path, skiprows=9)
    gauges = [index for index, name in enumerate(columns) if name.startswith("SG_")]
    place = {name.replace(" ", ""): index for index, name in enumerate(columns)}
    acceleration = values[:, place["LowGAccel"]] * _MPS2_PER_VOLT
    return Trial(
        f"{path.parent.name}/{path.stem}", rate_hz, acceleration, values[:, gauges], values[:, place["PinLoc"]]
    )


def follow(trial: Trial, resonances: tuple[Resonance, ...] = RESONANCES, every: int = 1) -> Followed:
    """Run the tracker over a trial, sample by sample; ask for the phase at ``every`` so many of them."""
    steps = len(trial.acceleration_mps2) // _AVERAGE
    averaged = trial.acceleration_mps2[: steps * _AVERAGE].reshape(steps, _AVERAGE).mean(axis=1)
    late_s = 0.5 * (_AVERAGE - 1) / trial.rate_hz + _SENSOR_LAG_S
    tracker = SingleSensorModeEkf(resonances, trial.rate_hz / _AVERAGE, _NOISE_MPS2, sensor_lag_s=late_s)
    said = np.full((3, steps, len(LEADS_S)), np.nan)
    for step, value in enumerate(averaged):
        tracker.add(float(value))
        if step % every:
            continue
        for column, lead_s in enumerate(LEADS_S):
            estimate = tracker.phase(lead_s)
            if not isinstance(estimate, Reject):
                said[:, step, column] = estimate.phase_rad, estimate.phase_sigma_rad, estimate.frequency_hz
    asked = slice(None, None, every)
    at = np.arange(steps)[asked] * _AVERAGE + _AVERAGE - 1
    return Followed(at, said[0, asked], said[1, asked], said[2, asked, 0])


def analytic(samples: Floats, rate_hz: float) -> npt.NDArray[np.complex128]:
    """Analytic signal of the first bending band, filtered forward and backward: no phase, future samples used."""
    sections = butter(4, _BAND_HZ, "bandpass", output="sos", fs=rate_hz)
    return np.asarray(hilbert(sosfiltfilt(sections, samples - samples.mean())), dtype=np.complex128)


def offline_displacement(trial: Trial) -> npt.NDArray[np.complex128]:
    """The accelerometer treated off line: minus its analytic signal, advanced by the sensor's lag."""
    late = -analytic(trial.acceleration_mps2, trial.rate_hz)
    turn = np.gradient(np.unwrap(np.angle(late))) * trial.rate_hz * _SENSOR_LAG_S
    return np.asarray(late * np.exp(1j * turn), dtype=np.complex128)


def displacement_truth(trial: Trial) -> npt.NDArray[np.complex128]:
    """Displacement up to a real factor: from the gauges where there are any, else the off-line accelerometer."""
    if not trial.strain_v.shape[1]:
        return offline_displacement(trial)
    return -analytic(trial.strain_v.mean(axis=1), trial.rate_hz)


def judge(trial: Trial, followed: Followed, fixed: Followed) -> Score:
    """Compare with the truth of a trial."""
    truth, offline = displacement_truth(trial), offline_displacement(trial)
    gauges = trial.strain_v.shape[1] > 0
    error, readable = _errors(trial, followed, truth)
    simple, _ = _errors(trial, fixed, truth)
    inside = slice(round(_FIRST_S * trial.rate_hz), -round(_LAST_S * trial.rate_hz))
    legible = _readable(trial, truth)[inside]
    beside = _degrees(offline * np.conj(truth))[inside][legible]
    each = [analytic(trial.strain_v[:, k], trial.rate_hz) for k in range(2)] if gauges else []
    apart = _degrees(each[0] * np.conj(each[1]))[inside][legible] / np.sqrt(2.0) if gauges else np.array([np.nan])
    sigma = np.degrees(followed.sigma_rad[:, 0])
    held = readable[:, 0] & np.isfinite(error[:, 0])
    return Score(
        name=trial.name,
        judge="strain gauges" if gauges else "off-line accelerometer",
        judged=float(np.mean(legible)),
        median_deg=_median(error, readable),
        p90_deg=_pair(error, readable, 90.0),
        any_deg=_pair(error, np.isfinite(error), 50.0),
        fixed_deg=_median(simple, readable),
        floor_deg=float(np.median(np.abs(beside))) if gauges else float("nan"),
        gauges_deg=float(np.median(np.abs(apart))),
        frequency_hz=_frequency_error(trial, followed, truth, readable[:, 0]),
        within=(
            float(np.mean(np.abs(error[held, 0]) < sigma[held])),
            float(np.mean(np.abs(error[held, 0]) < 2.0 * sigma[held])),
        ),
        refused=float(np.mean(np.isnan(followed.phase_rad[readable[:, 0], 0]))),
    )


def run(folder: Path = DATA, only: str = "*") -> list[Score]:
    """Every file of the folder, judged."""
    scores = []
    for path in sorted(folder.glob(f"{only}/test*.txt")):
        trial = load(path)
        scores.append(judge(trial, follow(trial), follow(trial, FIXED)))
    return scores


def variants() -> dict[str, tuple[Resonance, ...]]:
    """Settings to choose among: those of this file, and each of them halved and doubled (of the upper two together)."""
    settings: dict[str, tuple[Resonance, ...]] = {"as they are": RESONANCES}
    for place, which in (("first", slice(0, 1)), ("upper", slice(1, 3))):
        for name in ("wander", "settle_s", "damping", "load"):
            for factor in (0.5, 2.0):
                changed = list(RESONANCES)
                changed[which] = [dataclasses.replace(r, **{name: factor * getattr(r, name)}) for r in changed[which]]
                settings[f"{place} {name} x {factor:g}"] = tuple(changed)
    return settings


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A file judged by settings that were chosen on the others; medians in degrees, per lead; (low, high) over all."""

    name: str
    chosen: str
    median_deg: tuple[float, float]
    range_deg: tuple[tuple[float, float], tuple[float, float]]


def leave_one_out(folder: Path = DATA) -> list[LeftOut]:
    """Choose among :func:`variants` by all gauge-judged files but one, judge that one; for each file."""
    trials = [load(path) for path in sorted(folder.glob("rand0/test*.txt"))]
    tried = variants()
    medians = np.array([[_medians(trial, resonances) for trial in trials] for resonances in tried.values()])
    rows = []
    for k, trial in enumerate(trials):
        others = np.delete(medians, k, axis=1) / np.array(TARGETS_DEG)
        best = int(np.argmin(others.sum(axis=(1, 2))))
        low, high = medians[:, k].min(axis=0), medians[:, k].max(axis=0)
        now, later = (float(value) for value in medians[best, k])
        spread = ((float(low[0]), float(high[0])), (float(low[1]), float(high[1])))
        rows.append(LeftOut(trial.name, list(tried)[best], (now, later), spread))
    return rows


def _medians(trial: Trial, resonances: tuple[Resonance, ...]) -> tuple[float, float]:
    error, readable = _errors(trial, follow(trial, resonances, every=_EVERY), displacement_truth(trial))
    return _median(error, readable)


def _errors(
    trial: Trial, followed: Followed, truth: npt.NDArray[np.complex128]
) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """(k, leads) phase errors in degrees, NaN where refused or outside the judge; and where the truth is readable."""
    error = np.full(followed.phase_rad.shape, np.nan)
    good = np.zeros(error.shape, dtype=bool)
    readable = _readable(trial, truth)
    first, last = round(_FIRST_S * trial.rate_hz), len(truth) - round(_LAST_S * trial.rate_hz)
    for column, lead_s in enumerate(LEADS_S):
        target = followed.at + round(lead_s * trial.rate_hz)
        inside = (followed.at >= first) & (target < last)
        phasors = np.exp(1j * followed.phase_rad[inside, column]) * np.conj(truth[target[inside]])
        error[inside, column] = _degrees(phasors)
        good[inside, column] = readable[target[inside]]
    return error, good


def _readable(trial: Trial, truth: npt.NDArray[np.complex128]) -> npt.NDArray[np.bool_]:
    """Where the judge itself can be read: strain of 2 mV; without gauges, what that is in acceleration."""
    least = _READABLE_V if trial.strain_v.shape[1] else _READABLE_V * 36.0 * _MPS2_PER_VOLT
    return np.asarray(np.abs(truth) > least)


def _frequency_error(
    trial: Trial, followed: Followed, truth: npt.NDArray[np.complex128], readable: npt.NDArray[np.bool_]
) -> float:
    """Median difference from the truth's own frequency over 50 ms (phase gained from 25 ms before to 25 ms after)."""
    half = round(0.025 * trial.rate_hz)
    phase = np.unwrap(np.angle(truth))
    steps = followed.at[readable]
    true_hz = (phase[steps + half] - phase[steps - half]) / (2.0 * np.pi * 2.0 * half / trial.rate_hz)
    return float(np.nanmedian(np.abs(followed.frequency_hz[readable] - true_hz)))


def _pair(error: Floats, where: npt.NDArray[np.bool_], percent: float) -> tuple[float, float]:
    first, second = (float(np.nanpercentile(np.abs(error[where[:, k], k]), percent)) for k in range(2))
    return first, second


def _median(error: Floats, readable: npt.NDArray[np.bool_]) -> tuple[float, float]:
    """Median of the absolute error where the truth is readable; no estimate counts as chance, 90 deg."""
    return _pair(np.where(np.isnan(error), 90.0, error), readable, 50.0)


def _degrees(phasors: npt.NDArray[np.complex128]) -> Floats:
    return np.asarray(np.degrees(np.angle(phasors)))


def main(arguments: list[str]) -> int:
    """Print the table; 1 where a gauge-judged file misses a target."""
    if not DATA.exists():
        print("measured/dropbear8 is not here (SPANWISE_DATA): nothing to judge")
        return 0
    if arguments[:1] == ["--leave-one-out"]:
        return _print_left_out(leave_one_out())
    head = ("file", "0 ms", "p90", "10 ms", "p90", "any 0", "any 10", "fixed f", "floor", "gauges", "f, Hz", "1s", "2s")
    print(
        "phase error, deg: median, 90th percentile; judged where the truth is readable, and wherever a phase is given"
    )
    print(f"{head[0]:14s}" + "".join(f"{name:>8s}" for name in head[1:]) + "  judged refused by")
    missed = False
    for score in run(only=arguments[0] if arguments else "*"):
        errors = [value for k in range(2) for value in (score.median_deg[k], score.p90_deg[k])]
        rest = [*score.any_deg, score.fixed_deg[0], score.floor_deg, score.gauges_deg, score.frequency_hz]
        cells = "".join(f"{value:8.2f}" for value in (*errors, *rest, *score.within))
        print(f"{score.name:14s}{cells}  {score.judged:6.2f} {score.refused:7.2f} {score.judge}", flush=True)
        by_gauges = not np.isnan(score.floor_deg)
        missed |= by_gauges and any(m > t for m, t in zip(score.median_deg, TARGETS_DEG, strict=True))
    return _print_verdict(missed=missed)


def _print_verdict(*, missed: bool) -> int:
    verdict = "missed" if missed else "held"
    print(f"targets by the gauges: {TARGETS_DEG[0]} deg at 0 ms, {TARGETS_DEG[1]} deg at 10 ms: {verdict}")
    return int(missed)


def _print_left_out(rows: list[LeftOut]) -> int:
    print("median phase error, deg, by settings chosen on the other files (lowest to highest over all settings tried)")
    for row in rows:
        cells = "   ".join(
            f"{lead * 1e3:2.0f} ms {median:.2f} ({low:.2f} to {high:.2f})"
            for lead, median, (low, high) in zip(LEADS_S, row.median_deg, row.range_deg, strict=True)
        )
        print(f"{row.name:14s} {cells}   {row.chosen}", flush=True)
    missed = any(m > t for row in rows for m, t in zip(row.median_deg, TARGETS_DEG, strict=True))
    return _print_verdict(missed=missed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
