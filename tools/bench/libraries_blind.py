"""Diagnosis beside sdypy-EMA on the blind trials of the diagnosis: what is hidden, what each of the two finds of it.

sdypy-EMA finds poles and names no causes. It is given what it wants, frequency responses: here the spectra of the
correlations of the two tips at positive lags, as for a structure that nobody's force was measured on. What can be asked
of it are the hidden modes' frequencies, and the first mode's where a shift is hidden.
"""

from __future__ import annotations

import importlib.util
import sys
from typing import Any

import numpy as np

from tools.bench.libraries import ema_poles_hz
from tools.trial_judge import judge_trial
from tools.trial_plan import Trial
from tools.trial_truths.cases import BELIEF, Hidden, Tables, fly

_SEED = 77
_DURATION_S = 60.0
_LAGS_S = 4.0
_RATE_HZ = 100.0
_ORDERS = (20, 40)
_DAMPINGS = (0.005, 0.12)
LABELS = (
    Hidden({"second-mode": 0.004}, extra={"second-mode.frequency_hz": 17.0}),
    Hidden({"second-mode": 0.004}, extra={"second-mode.frequency_hz": 29.0}),
    Hidden({"torsion-coupling": 0.0025}, extra={"torsion-coupling.frequency_hz": 14.0}),
    Hidden({"close-mode": 0.7}, extra={"close-mode.ratio": 0.09}),
    Hidden({"frequency-shift": -0.09}),
    Hidden({"cubic-stiffness": 700.0}),
)


def run() -> list[dict[str, Any]]:
    """One row for each recording: what is hidden, what the diagnosis says, the pole of sdypy-EMA that comes nearest."""
    rows = []
    for label, tables in zip(LABELS, fly(list(LABELS), 20.0, _SEED, _DURATION_S), strict=True):
        judged = judge_trial(Trial("single", label), tables, leave_out=False)
        ((name, size),) = label.effects.items()
        rows.append(
            {
                "hidden": f"{name} {size:g}",
                "expected_hz": _expected_hz(label),
                "ours": f"{judged['verdict']}: {', '.join(judged['named']) or judged['nearest'] or '-'}",
                "ema_hz": _poles(tables, _expected_hz(label)),
            }
        )
    return rows


def _expected_hz(label: Hidden) -> float:
    """Where a pole should be because of what is hidden."""
    first_hz = float(BELIEF["frequency_hz"][0])
    ((name, size),) = label.effects.items()
    if name == "frequency-shift":
        return first_hz * (1.0 + size)
    return float(label.extra.get(f"{name}.frequency_hz", first_hz * (1.0 + label.extra.get(f"{name}.ratio", 0.0))))


def _poles(tables: Tables, near_hz: float) -> float:
    """Median of the poles within 4 % over the model orders; nan where there are fewer than in half of these."""
    f_hz, frf = _half_spectra(tables)
    poles_hz, orders = ema_poles_hz(f_hz, frf, (2.0, 40.0), _ORDERS, near_hz, 0.04 * near_hz, _DAMPINGS)
    return float(np.median(poles_hz)) if len(poles_hz) > 0.5 * orders else float("nan")


def _half_spectra(tables: Tables) -> tuple[Any, Any]:
    """Frequencies (f,) and (4, f): of all correlations at positive lags, decimated to 100 Hz by means."""
    ratio = round(1000.0 / _RATE_HZ)
    complete = tables.force_z_mps2[: len(tables.t_s) // ratio * ratio]
    up = -(complete - complete.mean(0)).reshape(-1, ratio, 2).mean(1)
    lags = round(_LAGS_S * _RATE_HZ)
    spectrum = np.fft.rfft(up, 2 * len(up), axis=0)
    spectra = []
    for i, k in np.ndindex(2, 2):
        correlation = np.fft.irfft(spectrum[:, i] * spectrum[:, k].conj())[:lags] / len(up)
        spectra.append(np.fft.rfft(correlation * np.exp(-3.0 * np.arange(lags) / lags)))
    return np.fft.rfftfreq(lags, 1.0 / _RATE_HZ), np.array(spectra)


def main() -> int:
    """Print the comparison."""
    if importlib.util.find_spec("sdypy") is None:
        print("sdypy-EMA is not installed")
        return 0
    print("blind trials, 20 dB, 60 s: what is hidden, where its pole should be, what is found")
    for row in run():
        print("  {hidden:26s} {expected_hz:6.2f} Hz   ours {ours:32s} sdypy-EMA {ema_hz:6.2f} Hz".format(**row))
    return 0


if __name__ == "__main__":
    sys.exit(main())
