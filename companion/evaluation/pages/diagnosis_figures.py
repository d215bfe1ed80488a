"""The pictures of a diagnosis's page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from companion.diagnosis.flights.outcome import FlightDiagnosis
from companion.diagnosis.flights.views import autocorrelation, backbone, force_map
from companion.diagnosis.model.expectation import Expectation
from companion.diagnosis.model.flight_model import FlightModel
from companion.records import Floats
from companion.reporting.plotting import AFTER, BEFORE, DATA, INK, VERMILLION, dots, headline, new_figure

_NEEDED_Z = 4.4  # one in 10^5, the level that the screen asks for (convention)
_SHOWN = 16  # candidates that are legible side by side (choice)
_SPECTRUM_BINS = 160  # points of a legible line (choice)
_LOAD_VARIES = 0.02  # rms g: below, the flight was level (choice)
_WIDTHS = {BEFORE: 3.0, AFTER: 1.2}  # one lies on the other where they agree, and both are seen
Fits = Sequence[tuple[Expectation, str, str]]


def fits_of(diagnosis: FlightDiagnosis) -> list[tuple[Expectation, str, str]]:
    """Fits to draw: the believed model, and the extended one where there is one; with colour and label."""
    fits = [(diagnosis.null.state.expectations[0], BEFORE, "believed model, fitted")]
    if len(diagnosis.final.terms) > len(diagnosis.null.terms):
        fits.append((diagnosis.final.state.expectations[0], AFTER, "extended model"))
    return fits


def spectra(fits: Fits, model: FlightModel) -> Any:
    """Each tip's spectrum, and the phase of right against left."""
    sides = model.observations.sides
    figure, axes = _figure(3.5, len(sides) + (1 if len(sides) == 2 else 0))
    f_hz, data = model.band_hz, model.data_in_band()
    for channel, (axis, side) in enumerate(zip(axes, sides, strict=False)):
        thin, power = _averaged(f_hz, 2.0 * np.abs(data[channel]) ** 2)
        axis.loglog(thin, np.sqrt(power), color=DATA, lw=1.8, label="recorded")
        for fitted, colour, label in fits:
            modelled = np.sqrt(2.0 * fitted.spectrum[channel, channel].real)
            axis.loglog(f_hz, modelled, color=colour, lw=_WIDTHS[colour], label=label)
        axis.set(title=f"{side.name.lower()} tip", xlabel="frequency, Hz", ylabel="" if channel else "m/s² per √Hz")
    axes[0].legend(fontsize=8, frameon=False)
    if len(sides) == 2:
        thin, cross = _averaged(f_hz, data[0] * data[1].conj())
        axes[-1].semilogx(thin, np.degrees(np.angle(cross)), ".", ms=3, color=DATA)
        for fitted, colour, _ in fits:
            axes[-1].semilogx(f_hz, np.degrees(np.angle(fitted.spectrum[0, 1])), color=colour, lw=_WIDTHS[colour])
        axes[-1].set(title="left against right, phase", xlabel="frequency, Hz", ylabel="degrees", ylim=(-185, 185))
    return figure


def innovations(fits: Fits, model: FlightModel) -> Any:
    """Autocorrelation of what is left, the symmetric mode by amplitude, and the force that is missing."""
    figure, axes = _figure(3.3, 4)
    for fitted, colour, label in fits:
        diagnosis = autocorrelation(model, fitted)
        axes[0].plot(diagnosis.lag_s, diagnosis.values.T, color=colour, lw=0.8, label=label)
        axes[0].axhspan(-diagnosis.bound, diagnosis.bound, color=DATA, alpha=0.15, lw=0)
        spine = backbone(model, fitted)
        millimetres = 1e3 * spine.amplitude_m
        axes[1].errorbar(millimetres, spine.frequency_hz, spine.frequency_sigma_hz, color=colour, fmt="o-", ms=3, lw=1)
        axes[2].errorbar(millimetres, spine.work, spine.work_sigma, color=colour, fmt="o-", ms=3, lw=1)
    axes[0].set(title="Innovations: autocorrelation", xlabel="lag, s", ylabel="correlation")
    axes[1].set(title="Backbone: frequency", xlabel="amplitude, mm", ylabel="frequency, Hz")
    axes[2].set(title="Damping that is missing", xlabel="amplitude, mm", ylabel="work of the residual, rms")
    missing = force_map(model, fits[0][0])
    reach = float(np.nanmax(np.abs(missing.force))) or 1.0
    edges = missing.edges
    image = axes[3].pcolormesh(edges, edges, missing.force, cmap="RdBu_r", vmin=-reach, vmax=reach)
    axes[3].set(title="Force that is missing", xlabel="deflection, rms", ylabel="speed, rms")
    figure.colorbar(image, ax=axes[3], shrink=0.85, label="of the force's rms")
    return figure


def ranges(fits: Fits, model: FlightModel) -> Any:
    """The range residual as toe, over time and against what it might follow."""
    toe = model.observations.toe
    assert toe is not None
    load = np.interp(toe.t_s, model.observations.t_s, model.observations.load_factor)
    varies = float(np.std(load)) > _LOAD_VARIES
    figure, axes = _figure(3.1, 5 if varies else 4, sharey=True)
    for fitted, colour, label in fits:
        residual = 1e3 * fitted.toe_residual_rad
        sigma = np.full(len(residual), 1e3 * model.belief.match_sigma_rad())
        deflection = 1e3 * np.interp(toe.t_s, model.observations.t_s, fitted.q_m[0])
        speed = 1e3 * np.interp(toe.t_s, model.observations.t_s, fitted.qdot_mps[0])
        distance = 1.0 / toe.inverse_m
        for axis, values in zip(axes, (toe.t_s, deflection, speed, distance, load), strict=False):
            dots(axis, values, residual, sigma, colour, label)
    names = ("time of exposure, s", "deflection, mm", "its rate, mm/s", "distance, m", "load factor")
    for axis, name in zip(axes, names, strict=False):
        axis.set(xlabel=name)
    axes[0].set(ylabel="range residual as toe, mrad")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=len(labels), fontsize=8, frameon=False)
    headline(figure, "Range residual as relative toe, ±1 sigma")
    return figure


def screening(diagnosis: FlightDiagnosis) -> Any:
    """Strength of the leading effects, and how far each can be told from the others."""
    shown = diagnosis.screening.candidates[:_SHOWN]
    figure = new_figure(11.5, 4.8)
    bars, matrix = figure.subplots(1, 2, width_ratios=(1.2, 1))
    names = [entry.name + (f" ({entry.term.channel})" if entry.term.channel else "") for entry in shown]
    named = {cause.term.effect.name for cause in diagnosis.causes}
    bars.barh(range(len(shown)), [e.z for e in shown], color=[AFTER if e.name in named else DATA for e in shown])
    bars.set_yticks(range(len(shown)), names, fontsize=8)
    bars.invert_yaxis()
    bars.axvline(_NEEDED_Z, color=VERMILLION, lw=1, ls="--")
    bars.set_title("Strength of each named effect alone (dashed: needed)", fontsize=10)
    bars.set_xlabel("sigma of its efficient score")
    _plain(bars)
    corner = np.abs(diagnosis.screening.correlation[: len(shown), : len(shown)])
    image = matrix.imshow(corner, vmin=0, vmax=1, cmap="Blues")
    matrix.set_xticks(range(len(shown)), names, rotation=90, fontsize=7)
    matrix.set_yticks(range(len(shown)), [""] * len(shown))
    for i, j in np.argwhere(corner > 0.95):
        if i != j:
            matrix.plot(j, i, "o", ms=3, color="white")
    matrix.set_title("Confusion on this recording, |ρ| (dots: one group)", fontsize=10)
    figure.colorbar(image, ax=matrix, shrink=0.8)
    return figure


def gains(gain: dict[str, Any]) -> Any:
    """Range error on blocks that were not fitted, before and after; ``gain`` as the JSON has it."""
    before_after = {float(key): (entry["before"], entry["after"]) for key, entry in gain["range_rms_m"].items()}
    toe = gain["toe_rms_rad"]["before"], gain["toe_rms_rad"]["after"]
    figure, (axis,) = _figure(2.8, 1)
    distances = np.linspace(5.0, 1.05 * max(before_after), 100)
    scale = next(rms / distance**2 for distance, (rms, _) in before_after.items()) / toe[0]
    for rms, colour, label in ((toe[0], BEFORE, "believed model"), (toe[1], AFTER, "extended model")):
        axis.plot(distances, scale * rms * distances**2, color=colour, lw=_WIDTHS[colour], label=label)
    for distance, pair in before_after.items():
        axis.plot([distance] * 2, pair, "o", ms=4, color=INK)
        axis.annotate(f"{pair[0]:.2f} → {pair[1]:.2f} m", (distance, max(pair)), (-6, 6), textcoords="offset points",
                      ha="right", fontsize=8)  # fmt: skip
    axis.set(xlabel="distance, m", ylabel="range error, m rms")
    axis.legend(fontsize=8, frameon=False)
    return figure


def _figure(height: float, columns: int, width: float = 11.5, sharey: bool = False) -> tuple[Any, Any]:
    figure = new_figure(width, height)
    axes = np.atleast_1d(figure.subplots(1, columns, sharey=sharey))
    for axis in axes:
        axis.grid(alpha=0.25)
        axis.title.set_fontsize(10)
        _plain(axis)
    return figure, axes


def _plain(axis: Any) -> None:
    axis.spines[["top", "right"]].set_visible(False)
    axis.tick_params(labelsize=8)


def _averaged(f_hz: Floats, power: Any) -> tuple[Any, Any]:
    """Average over logarithmic bins."""
    edges = np.unique(np.searchsorted(f_hz, np.geomspace(f_hz[0], f_hz[-1], _SPECTRUM_BINS)))[:-1]
    count = np.diff(np.append(edges, len(f_hz)))
    return np.add.reduceat(f_hz, edges) / count, np.add.reduceat(power, edges) / count
