"""The pages of a diagnosis on the bench: what the data show without a model, then evidence, gain and advice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from companion.diagnosis.free_decay.adequacy import autocorrelation, whitened
from companion.diagnosis.free_decay.likelihood import FreeDecayFit
from companion.diagnosis.free_decay.record import Scale
from companion.diagnosis.free_decay.recordings import FreeDecayDiagnosis
from companion.diagnosis.free_decay.views import backbone, restoring_force
from companion.diagnosis.modal_tests.frequency_changes import ChangedMode
from companion.diagnosis.modal_tests.recordings import ModalTestDiagnosis
from companion.diagnosis.modal_tests.vibration import VibrationRun
from companion.reporting.blocks import Advice, Block, Heading, Page, Paragraph, Table
from companion.reporting.embedding import embed
from companion.reporting.page import render
from companion.reporting.plotting import AFTER, BEFORE, DATA, new_figure, panels

_TWO_PI = 2.0 * np.pi  # by definition: radians of a turn


def ringing_page(diagnosis: FreeDecayDiagnosis, scales: Mapping[str, Scale], plain: dict[str, Any], what: str) -> str:
    """The page of recordings in which a structure rang."""
    body: list[Block] = [
        *_causes(plain),
        Heading("What was recorded, and where the model has its modes"),
        embed(_tracks(diagnosis), "spectrogram of each recording with the fitted frequencies"),
        *[
            embed(_against_channel(diagnosis, name, scale), f"frequency and damping against {name}")
            for name, scale in scales.items()
        ],
        embed(_backbones(diagnosis), "frequency and damping against amplitude"),
        Heading("What each law is worth alone"),
        Paragraph("Evidence and usefulness are two things: a law can win on likelihood and foretell nothing."),
        _alone(plain),
        Heading("What is left"),
        embed(_innovations(diagnosis), "autocorrelation of the innovations"),
        embed(_forces(diagnosis), "what spring and damper leave, over deflection and speed"),
        *_residual(plain),
    ]
    seconds = sum(float(recording.t_s[-1]) for recording in diagnosis.null.state.recordings)
    return rendered(plain, f"{what}: recordings: {len(plain['recordings'])}, {seconds:.0f} s, fitted jointly", body)


def vibration_page(
    diagnosis: ModalTestDiagnosis, runs: Sequence[VibrationRun], plain: dict[str, Any], what: str
) -> str:
    """The page of a vibration test."""
    body: list[Block] = [
        *[Advice(f"Record: {line}.") for line in plain["advice"]],
        Heading("Frequency by run"),
        embed(_by_run(diagnosis), "frequency of each mode by run"),
        *[embed(_by_constant(mode, runs), "frequency against what was set per run") for mode in diagnosis.changed[:1]],
        Heading("Responses"),
        embed(_responses(runs), "acceleration over force of every run"),
        Heading("Modes"),
        *_modes(plain),
        *[Paragraph(note) for note in plain["notes"]],
    ]
    return rendered(plain, f"{what}: {len(runs)} runs, fitted jointly", body)


def rendered(plain: dict[str, Any], subject: str, body: Sequence[Block]) -> str:
    """A page with the verdict on top."""
    verdict = plain["verdict"]
    page = Page(title=f"Diagnosis: {verdict}", headline=headline(plain), body=body, subject=subject, grade=verdict)
    return render(page)


def headline(plain: dict[str, Any]) -> str:
    """The verdict in one sentence."""
    nearest = f" (nearest: {plain['nearest']})" if plain.get("nearest") else ""
    return f"{plain['verdict'].replace('-', ' ')}{nearest}: {plain['reason']}"


def _causes(plain: dict[str, Any]) -> list[Block]:
    if not plain["causes"]:
        return []
    rows = []
    for cause in plain["causes"]:
        name = cause["name"] + (f" ({cause['channel']})" if cause["channel"] else "")
        values = "; ".join(
            f"{key} {entry['value']:.4g}" + (f" ± {entry['sigma']:.2g}" if entry["sigma"] else "") + f" {entry['unit']}"
            for key, entry in cause["parameters"].items()
        )
        gain = cause["gain"]
        worth = f"{100 * gain['share_of_signal'][0]:.1f} → {100 * gain['share_of_signal'][1]:.1f} %" if gain else "–"
        rows.append([name, values, f"{cause['log_bayes_factor']:.0f}", f"{cause['bic']:+.0f}", worth])
    heads = ["cause", "parameters", "log Bayes factor", "BIC", "held-out error, share of the signal"]
    return [Heading("Causes, strongest first"), Table(heads, rows)]


def _alone(plain: dict[str, Any]) -> Table:
    rows = []
    for entry in plain["screening"]:
        gain = entry["gain"]
        shares = [100.0 * value for value in gain["share_of_signal"]] if gain else []
        worth = f"{shares[0]:.0f} → {shares[1]:.0f} %" if gain else "–"
        gone = f"{100 * gain['interval'][0]:.0f} to {100 * gain['interval'][1]:.0f} %" if gain else "–"
        rows.append([entry["says"], f"{entry['log_odds']:.0f}", worth, gone])
    return Table(["law", "log Bayes factor", "held-out error", "of its square gone (95 %)"], rows)


def _residual(plain: dict[str, Any]) -> list[Block]:
    residual = plain["residual"]
    needed = [Advice(f"Needed and without a name: {line}.") for line in residual["unnamed"]] if residual else []
    tests = check_table(plain, "test (worst recording)", "constant frequency")
    return [*needed, tests, *[Paragraph(note) for note in plain["notes"]]]


def check_table(plain: dict[str, Any], test: str, believed: str) -> Table:
    """Adequacy tests before and after, under these names of the first two columns."""
    before = {_kind(entry): entry["z"] for entry in plain["adequacy"]["before"]}
    rows = [
        [entry["test"], f"{before[_kind(entry)]:+.1f}", f"{entry['z']:+.1f}",
         "passed" if entry["passed"] else "failed"]
        for entry in plain["adequacy"]["after"]
    ]  # fmt: skip
    return Table([test, believed, "extended", ""], rows)


def _kind(entry: dict[str, Any]) -> str:
    """A test's name without its recording."""
    return str(entry["test"]).partition(" (")[0]


def _tracks(diagnosis: FreeDecayDiagnosis) -> Any:
    recordings = diagnosis.final.state.recordings
    columns = min(len(recordings), 3)
    rows = -(-len(recordings) // columns)
    figure = new_figure(11, 2.7 * rows)
    axes = np.atleast_1d(figure.subplots(rows, columns, sharey=True)).ravel()
    for k, (axis, recording) in enumerate(zip(axes, recordings, strict=False)):
        axis.specgram(recording.up_mps2 + 1e-9, NFFT=64, noverlap=56, pad_to=512, Fs=recording.rate_hz, cmap="Greys",
                      vmin=-90, vmax=10)  # fmt: skip
        modes = diagnosis.final.state.modes(diagnosis.final.values[None, :], k).omega_radps[0] / _TWO_PI
        for mode, colour in zip(modes.T, (AFTER, BEFORE), strict=False):
            axis.plot(recording.t_s, mode, color=colour, lw=1.0)
        axis.set(title=recording.name, xlabel="time, s", ylabel="frequency, Hz" if k % columns == 0 else "")
    for axis in axes[len(recordings) :]:
        axis.set_visible(False)
    return figure


def _against_channel(diagnosis: FreeDecayDiagnosis, name: str, scale: Scale) -> Any:
    figure, (frequency, damping) = panels(3.6, 2)
    model = diagnosis.final.state
    for k, recording in enumerate(model.recordings):
        track = backbone(recording)
        at = scale.mean + scale.rms * track.channels[name]
        label = f"windows of {track.length_s:.2g} s" if k == 0 else None
        frequency.plot(at, track.frequency_hz, ".", ms=4, color=DATA, label=label)
        damping.semilogy(at, np.maximum(track.damping, 1e-4), ".", ms=4, color=DATA)
        modes = model.modes(diagnosis.final.values[None, :], k)
        order = np.argsort(recording.channels[name])
        channel = scale.mean + scale.rms * recording.channels[name][order]
        for j, colour in zip(range(modes.zeta.shape[2]), (AFTER, BEFORE), strict=False):
            label = ("first mode", "second mode")[j] if k == 0 else None
            frequency.plot(channel, modes.omega_radps[0, order, j] / _TWO_PI, color=colour, lw=1.2, label=label)
            damping.semilogy(channel, modes.zeta[0, order, j], color=colour, lw=1.2)
    frequency.set(xlabel=_named(name), ylabel="frequency, Hz")
    damping.set(xlabel=_named(name), ylabel="damping ratio")
    frequency.legend(fontsize=8)
    return figure


def _backbones(diagnosis: FreeDecayDiagnosis) -> Any:
    figure, (frequency, damping) = panels(3.2, 2)
    for recording in diagnosis.final.state.recordings:
        track = backbone(recording)
        frequency.semilogx(track.amplitude_mps2, track.frequency_hz, ".", ms=4, label=recording.name)
        damping.loglog(track.amplitude_mps2, np.maximum(track.damping, 1e-4), ".", ms=4)
    for axis in (frequency, damping):
        axis.minorticks_off()
    frequency.set(xlabel="amplitude, m/s²", ylabel="frequency, Hz", title="Backbone")
    damping.set(xlabel="amplitude, m/s²", ylabel="damping ratio")
    frequency.legend(fontsize=7)
    return figure


def _innovations(diagnosis: FreeDecayDiagnosis) -> Any:
    figure = new_figure(11, 3.0)
    series, lags = figure.subplots(1, 2, width_ratios=(1.6, 1))
    recordings = diagnosis.final.state.recordings
    stages: list[tuple[FreeDecayFit, str, str]] = [(diagnosis.null, BEFORE, "constant frequency")]
    stages += [(diagnosis.final, AFTER, "extended")] if diagnosis.accepted else []
    for fitted, colour, label in stages:
        white = whitened(fitted)
        series.plot(recordings[0].t_s, white[0].values, color=colour, lw=0.5, label=label)
        mean = np.mean([autocorrelation(recording.values, recording.quiet) for recording in white], axis=0)
        lags.plot(range(1, len(mean) + 1), mean, ".-", color=colour)
    bound = 2.0 / np.sqrt(sum(len(recording.t_s) for recording in recordings))
    lags.axhspan(-bound, bound, color="#00000022", lw=0)
    series.set(title=f"Innovations of {recordings[0].name}, in their sigma", xlabel="time, s", ylim=(-12, 12))
    lags.set(title="Autocorrelation between knocks", xlabel="lag, samples")
    series.legend(fontsize=8, loc="upper right")
    return figure


def _forces(diagnosis: FreeDecayDiagnosis) -> Any:
    figure = new_figure(11, 3.8)
    axes = figure.subplots(1, 2)
    image = None
    fits = ((diagnosis.null, "constant frequency"), (diagnosis.final, "extended"))
    for axis, (fitted, title) in zip(axes, fits, strict=True):
        q, v, left = restoring_force(fitted.state, fitted.values, 0)
        image = axis.pcolormesh(q, v, left.T, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
        axis.set(title=f"Left by spring and damper: {title}", xlabel="deflection, rms", ylabel="speed, rms")
    figure.colorbar(image, ax=axes, label="of the acceleration's rms")
    return figure


def _by_run(diagnosis: ModalTestDiagnosis) -> Any:
    shown = [recording.mode for recording in diagnosis.changed] or list(diagnosis.modes)
    figure, axes = panels(3.2, min(len(shown), 4))
    for axis, mode in zip(axes, shown, strict=False):
        axis.errorbar(mode.runs, mode.frequency_hz, 2.0 * mode.sigma_hz, fmt="o-", ms=4, color=AFTER, lw=0.8)
        axis.set(title=f"near {np.median(mode.frequency_hz):.2f} Hz", xlabel="run")
        axis.title.set_fontsize(10)
    axes[0].set_ylabel("frequency, Hz (± 2 sigma)")
    return figure


def _by_constant(leading: ChangedMode, runs: Sequence[VibrationRun]) -> Any:
    names = [recording.name for recording in leading.channels] or ["run_order"]
    figure, axes = panels(3.2, len(names), sharey=True)
    for axis, name in zip(axes, names, strict=True):
        at = [run.constants.get(name, k + 1.0) for k, run in enumerate(runs)]
        axis.errorbar(at, leading.mode.frequency_hz, 2.0 * leading.mode.sigma_hz, fmt="o", ms=4, color=AFTER)
        for x, y, run in zip(at, leading.mode.frequency_hz, runs, strict=True):
            axis.annotate(run.name, (x, y), fontsize=8, xytext=(4, 4), textcoords="offset points")
        axis.set(xlabel=f"{_named(name)} (numbers: runs)")
    axes[0].set_ylabel("frequency, Hz (± 2 sigma)")
    return figure


def _responses(runs: Sequence[VibrationRun]) -> Any:
    from matplotlib import colormaps

    figure, (axis,) = panels(3.6, 1)
    colours = colormaps["viridis"](np.linspace(0.0, 0.9, len(runs)))
    for run, colour in zip(runs, colours, strict=True):
        level = np.sqrt(np.mean(np.abs(run.response) ** 2, axis=0))
        axis.semilogy(run.frequency_hz, level, color=colour, lw=0.8, label=run.name)
    axis.set(xlabel="frequency, Hz", ylabel="m/s² per N, rms of the points")
    axis.legend(fontsize=7, ncols=2, title="run")
    return figure


def _modes(plain: dict[str, Any]) -> list[Block]:
    changes = sorted(plain["modes"], key=lambda mode: -abs(_change(mode)))
    rows = [
        [f"near {mode['near_hz']:.2f} Hz", f"{min(mode['frequency_hz']):.3f} to {max(mode['frequency_hz']):.3f} Hz",
         f"{100.0 * _change(mode):+.1f} %", f"{_in_sigmas(mode):.0f}"]
        for mode in changes
    ]  # fmt: skip
    moved = Table(["mode", "lowest to highest", "change between these two runs", "in its sigmas"], rows, 0)
    heads = ["run", *[f"near {mode['near_hz']:.2f} Hz" for mode in plain["modes"]]]
    by_run = [
        [run, *[f"{mode['frequency_hz'][k]:.3f} ± {mode['sigma_hz'][k]:.4f}" for mode in plain["modes"]]]
        for k, run in enumerate(plain["modes"][0]["runs"])
    ]
    return [moved, Heading("Every run"), Table(heads, by_run)]


def _extremes(mode: dict[str, Any]) -> tuple[int, int]:
    """Runs of the lowest and the highest frequency."""
    return int(np.argmin(mode["frequency_hz"])), int(np.argmax(mode["frequency_hz"]))


def _change(mode: dict[str, Any]) -> float:
    """From the first run of the lowest and the highest frequency to the later one, as a share."""
    low, high = _extremes(mode)
    ratio = float(mode["frequency_hz"][high] / mode["frequency_hz"][low])
    return (ratio - 1.0) * (1.0 if low < high else -1.0)


def _in_sigmas(mode: dict[str, Any]) -> float:
    low, high = _extremes(mode)
    apart = mode["frequency_hz"][high] - mode["frequency_hz"][low]
    return float(apart / np.hypot(mode["sigma_hz"][low], mode["sigma_hz"][high]))


def _named(channel: str) -> str:
    """A channel as an axis is labelled: its unit apart."""
    name, _, unit = channel.rpartition("_")
    return f"{name.replace('_', ' ')}, {unit}" if name and len(unit) <= 4 else channel.replace("_", " ")
