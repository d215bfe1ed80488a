"""Diagnosis beside other people's libraries, on the same measured data: sdypy-EMA on mAEWing1, sysidentpy on DROPBEAR.

sdypy-EMA (least squares complex frequency, common denominator) finds the mode near 9.3 Hz in each run of the vibration
test; sysidentpy (FROLS, polynomial NARX) foretells one trial of the beam from another, with and without the roller
among its inputs. Neither is needed by Spanwise: ``pip install sdypy-EMA
sysidentpy`` where a comparison is wanted.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import os
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from companion.adapters.recordings.tables.mapped_table import files_of, read_mapped
from companion.adapters.recordings.tables.mapping import load_mapping
from companion.diagnosis.free_decay.laws import Extension, Law, NeighbourMode, laws_for
from companion.diagnosis.free_decay.likelihood import filter_all, fit_best_of
from companion.diagnosis.free_decay.model import FreeDecayModel, key_of
from companion.diagnosis.free_decay.record import FreeDecay, RawFreeDecay, prepare, quiet_samples
from companion.diagnosis.modal_tests.vibration import VibrationRun, mode_of, responses
from companion.records import Floats

_DATA = Path(os.environ.get("SPANWISE_DATA", Path(__file__).resolve().parents[3] / "shared")) / "measured"
_NEAR_HZ, _AROUND_HZ = 9.3, 0.4
_ORDERS = (30, 50)
_DAMPINGS = (0.003, 0.03)
_AHEAD = 5
_LAGS = 8


def frequencies(folder: Path) -> list[dict[str, object]]:
    """The mode near 9.3 Hz by run: ours with its sigma, and the median of sdypy-EMA's poles over model orders."""
    mapping = load_mapping("maewing1-gvt")
    rows: list[dict[str, object]] = []
    for path in files_of(folder, mapping):
        table = read_mapped(path, mapping)
        accelerations_mps2 = np.stack([v for name, v in table.channels.items() if name.startswith("response_")], 1)
        f_hz, frf = responses(table.channels["input_n"], accelerations_mps2, 2000.0, (0.0, 40.0))
        inside = f_hz > 4.0
        ours = mode_of(VibrationRun("", f_hz[inside], frf[:, inside]), _NEAR_HZ)
        poles_hz, _ = ema_poles_hz(f_hz, frf, (4.0, 35.0), _ORDERS, _NEAR_HZ, _AROUND_HZ, _DAMPINGS)
        theirs = float(np.median(poles_hz)) if poles_hz else float("nan")
        rows.append(
            {"run": path.stem, "ours_hz": ours.frequency_hz, "sigma_hz": ours.frequency_sigma_hz, "ema_hz": theirs}
        )
    return rows


def ema_poles_hz(
    f_hz: Floats,
    frf: Any,
    band_hz: tuple[float, float],
    orders: tuple[int, int],
    near_hz: float,
    around_hz: float,
    dampings: tuple[float, float],
) -> tuple[list[float], int]:
    """Frequencies of sdypy-EMA's poles near one, Hz, over its model orders, and how many orders there are."""
    model_of = importlib.import_module("sdypy.EMA").Model
    model = model_of(frf=frf, freq=f_hz, lower=band_hz[0], upper=band_hz[1], pol_order_high=orders[1])
    model.get_poles(show_progress=False)
    poles_hz = [
        float(f)
        for order in range(orders[0], len(model.pole_freq))
        for f, zeta in zip(model.pole_freq[order], model.pole_xi[order], strict=True)
        if abs(f - near_hz) < around_hz and dampings[0] < zeta < dampings[1]
    ]
    return poles_hz, len(model.pole_freq) - orders[0]


def prediction_errors(folder: Path) -> list[dict[str, object]]:
    """Error of one trial predicted 5 samples ahead by what was learned on another, as a share of the signal."""
    mapping = load_mapping("dropbear8")
    tables = [read_mapped(path, mapping) for path in files_of(folder, mapping)[:2]]
    raws = [
        RawFreeDecay(t.path.stem, t.t_s, -t.channels["left_z_mps2"], {"roller": t.channels["roller_position_v"]})
        for t in tables
    ]
    assert mapping.band_hz is not None
    learned, judged = prepare(raws, mapping.band_hz)[0]
    belief = mapping.belief["frequency_hz"], mapping.belief["damping"]
    follow, bend, fade = [law for law in laws_for(["roller"]) if isinstance(law, Law) and law.channel]
    rows = [
        {"by": "ours, constant frequency", "share": _ours(learned, judged, belief, [])},
        {"by": "ours, following the roller", "share": _ours(learned, judged, belief, [follow])},
        {"by": "ours, following it on a bent line", "share": _ours(learned, judged, belief, [follow, bend])},
        {"by": "ours, as diagnosed", "share": _ours(learned, judged, belief, [follow, bend, NeighbourMode(), fade])},
    ]
    if importlib.util.find_spec("sysidentpy") is not None:
        rows.append({"by": "sysidentpy, AR", "share": _narx(learned, judged, roller=False, degree=1)})
        rows.append({"by": "sysidentpy, NARX degree 2 with the roller", "share": _narx(learned, judged, True, 2)})
        rows.append({"by": "sysidentpy, NARX degree 3 with the roller", "share": _narx(learned, judged, True, 3)})
    return rows


def _ours(learned: FreeDecay, judged: FreeDecay, belief: Any, laws: list[Extension]) -> float:
    mask = [np.ones(len(learned.t_s), dtype=np.bool_)]
    model = FreeDecayModel([learned], *belief, laws)
    start = model.centres
    start[0] = np.log(31.0)
    for law, value in zip(laws, (0.13, 0.015), strict=False):
        assert isinstance(law, Law)
        start[model.index(key_of(law))] = value
    if len(laws) > 2:
        start[model.index("second log frequency")] = np.log(25.0)
        start[model.index("second log participation")] = -3.0
    values = fit_best_of(model, start[None, :], mask).values
    (filtered,) = filter_all(FreeDecayModel([judged], *belief, laws), [values[None, :]], _AHEAD)
    assert filtered.ahead is not None
    return _relative_error(judged, filtered.ahead[0], np.arange(_AHEAD, len(judged.t_s)))


def _narx(learned: FreeDecay, judged: FreeDecay, roller: bool, degree: int) -> float:
    frols = importlib.import_module("sysidentpy.model_structure_selection").FROLS
    polynomial = importlib.import_module("sysidentpy.basis_function").Polynomial
    least_squares = importlib.import_module("sysidentpy.parameter_estimation").LeastSquares
    scale = float(learned.up_mps2.std())
    model = frols(
        ylag=_LAGS,
        xlag=1,
        n_info_values=30,
        order_selection=True,
        info_criteria="bic",
        estimator=least_squares(),
        basis_function=polynomial(degree=degree),
    )
    with warnings.catch_warnings(action="ignore"):
        inputs = [float(roller) * record.channels["roller"][:, None] for record in (learned, judged)]
        model.fit(X=inputs[0], y=learned.up_mps2[:, None] / scale)
        predicted = model.predict(X=inputs[1], y=judged.up_mps2[:, None] / scale, steps_ahead=_AHEAD)
    predicted = np.asarray(predicted).ravel()
    # it starts anew from what was measured every 5 samples: the last of each stretch is 5 ahead
    last = np.arange(model.max_lag + _AHEAD - 1, len(predicted), _AHEAD)
    return _relative_error(judged, predicted * scale, last)


def _relative_error(judged: FreeDecay, predicted: Floats, which: Any) -> float:
    still = which[quiet_samples(judged, _AHEAD)[which]]
    error, signal = (judged.up_mps2 - predicted)[still], judged.up_mps2[still]
    return float(np.sqrt(np.sum(error**2) / np.sum(signal**2)))


def main(arguments: list[str]) -> int:
    """Print both tables."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench libraries", description=__doc__)
    parser.add_argument("--data", type=Path, default=_DATA, help="folder of the measured data")
    folder = parser.parse_args(arguments).data
    if not folder.is_dir():
        print(f"{folder} is not here: nothing to compare on")
        return 0
    print("mAEWing1, the mode near 9.3 Hz by run")
    if importlib.util.find_spec("sdypy") is None:
        print("  sdypy-EMA is not installed")
    else:
        for row in frequencies(folder / "maewing1-gvt"):
            print("  {run:10s} ours {ours_hz:.3f} ± {sigma_hz:.3f} Hz   sdypy-EMA {ema_hz:.3f} Hz".format(**row))
    print("DROPBEAR, slow10/test1 predicted 32 ms ahead by what was learned on test0: error, share of the signal")
    for row in prediction_errors(folder / "dropbear8" / "slow10"):
        print("  {by:44s} {share:.3f}".format(**row))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
