"""Report of one flight as a self-contained page: the verdict first, then every figure behind it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from companion.adapters.recordings.mcap.reader import McapRecording
from companion.adapters.recordings.recording import Recording
from companion.evaluation.flight_log import SPECTRUM_SEGMENT_S, FlightLog, Spectrum
from companion.evaluation.pages import flight_figures as figures
from companion.evaluation.published_ranges import PublishedRanges
from companion.evaluation.recording_info import stream_line
from companion.params.airframe import FAMILIES, Wing
from companion.params.files import shipped_airframes
from companion.params.settings import Settings
from companion.records import Station
from companion.reporting import page
from companion.reporting.blocks import Advice, Answers, Block, Heading, Page, Paragraph, Table
from companion.reporting.embedding import embed

_USABLE_SHARE = 0.5  # of the ranges; below, more were withheld than published (choice)
_FEW_SHARE = 0.9  # of the shots; where fewer gave a range, the others are named (choice)
_MODE_SIGMAS = 2.0  # so near the belief, a line may be a higher mode's (choice)
_LONG_SILENCE_S = 10.0  # an approach at 20 m/s covers 200 m in it (choice)
_LONG_WARM_UP_S = 30.0  # the service itself complains of a tracker that takes longer (choice)
_GRADES = {"usable": "good", "late": "fair", "with long silences": "poor", "often withheld": "poor"}
_VIBRATION = (
    "Vibration is the tip's swing at the mode's own frequency. The slow bend by gusts, load and trim is not in it; the "
    "rms by which gusts bend the demo's wing has that too, and is larger."
)
_BLUR = (
    "Predicted blur is the image's motion in one exposure by all that moves: the bending wing, the aircraft's turning, "
    "and its flight past the scene, which is most of it near the ground and is not counted before the first range. "
    "The blur that spanwise demo states is the wing's alone."
)
_REFUSED = "In brackets how many were refused or withheld; a mark is a message, which may stand for many samples."
_WITHOUT_FIGURES = "nothing to judge"


@dataclass(frozen=True, slots=True)
class FlightVerdict:
    """Whether the flight's ranges could be trusted: in a word, as the headline says it, and with the reasons."""

    word: str
    headline: str
    reasons: tuple[str, ...]

    @property
    def grade(self) -> str:
        """Class of the style sheet that colours the page's headline."""
        return _GRADES.get(self.word, "fair")


def verdict(recording: Recording, log: FlightLog) -> FlightVerdict:
    """Judge a flight by what it recorded itself; no truth is known."""
    total, published = len(log.ranges), log.trusted()
    if not log.estimated:
        return FlightVerdict(_WITHOUT_FIGURES, _not_estimated(recording), ())
    if not log.modes:
        return FlightVerdict(_WITHOUT_FIGURES, "No wing was tracked: nothing can be said of ranges", ())
    if not total:
        has_cameras = recording.airframe.left_camera is not None
        why = "the cameras gave no matched pair" if has_cameras else "the airframe has no cameras"
        return FlightVerdict(_WITHOUT_FIGURES, f"No range was measured: {why}", ())
    word = _word(log, len(published) / total)
    headline = f"{word.capitalize()}: {len(published)} of {total} ranges were published"
    headline += f" ({100 * len(published) / total:.0f} %)"
    if published:
        relative = np.median([entry.sigma_m / entry.range_m for entry in published])
        headline += f", median sigma {100 * relative:.1f} % of the range"
    reasons = tuple(f"{count} withheld: {reason}" for reason, count in log.withheld().most_common())
    return FlightVerdict(word, headline, reasons + _shots(log) + _waits(log.published))


def _not_estimated(recording: Recording) -> str:
    """Sentence for what was measured alone, with the command that estimates; only our own recordings name a wing."""
    name = recording.airframe.name if recording.airframe.name in shipped_airframes() else "FILE.toml"
    wing = "" if isinstance(recording, McapRecording) else f" --airframe {name}"
    command = f"spanwise replay {recording.path}{wing} --out NEW.mcap"
    return f"Nothing was estimated in this recording: {command} does, and report reads that"


def _word(log: FlightLog, published_ratio: float) -> str:
    if published_ratio < _USABLE_SHARE:
        return "often withheld"
    if log.published.longest_silence_s >= _LONG_SILENCE_S:
        return "with long silences"
    return "late" if (log.published.first_s or 0.0) >= _LONG_WARM_UP_S else "usable"


def _shots(log: FlightLog) -> tuple[str, ...]:
    """How many shots gave a range, where many did not."""
    shots, lost_images = log.info.service.shots, log.info.service.lost_images
    if len(log.ranges) >= _FEW_SHARE * shots:
        return ()
    text = f"{len(log.ranges)} ranges came of {shots} shots"
    if lost_images:
        text += f"; {lost_images} images never came: spanwise doctor --log says what to mend"
    return (text,)


def _waits(published: PublishedRanges) -> tuple[str, ...]:
    """How long no range came: before the first, and at the longest after it."""
    if published.first_s is None:
        return ()
    begin = "lift-off" if published.lifted_off else "the recording's begin"
    first = f"first published range exposed {published.first_s:.1f} s after {begin} (the wing is learned before)"
    return first, f"after it, the longest time without a range was {published.longest_silence_s:.1f} s"


def render(recording: Recording, log: FlightLog) -> str:
    """The page as HTML, with every picture inside."""
    judged = verdict(recording, log)
    what = f"{recording.path.name}, airframe {recording.airframe.name}, {log.info.duration_s:.0f} s of flight"
    what += ", cut off while recording" if isinstance(recording, McapRecording) and recording.cut else ""
    body = list(_body(recording, log, judged))
    return page.render(Page(f"Flight: {judged.word}", judged.headline, body, subject=what, grade=judged.grade))


def _body(recording: Recording, log: FlightLog, judged: FlightVerdict) -> Iterator[Block]:
    yield Answers(list(_answers(log, judged)))
    yield from _ranges(log)
    yield from _wing(log, recording.airframe.wing)
    yield from _triggers(log)
    yield from _clocks(log)
    yield from _refusals(log)
    yield Heading("Recording")
    rows = [(stream_line(station, stream),) for station, stream in sorted(log.info.streams.items())]
    yield Table(("sensor streams",), rows)
    notes = list(dict.fromkeys(notice.text for notice in [*log.notices, *recording.notices]))
    if notes:
        yield Table(("said during the flight, or of the file",), [(note,) for note in notes])
    yield _changed(recording.settings)
    yield Advice(f"What the model of the wing gets wrong on this flight: spanwise diagnose {recording.path.name}")


def _answers(log: FlightLog, judged: FlightVerdict) -> Iterator[tuple[str, str]]:
    if not log.estimated:
        return
    yield "Why not all ranges?", "; ".join(judged.reasons) or "none was withheld"
    yield "Was the wing tracked?", f"{100 * log.tracked_ratio():.0f} % of the time; {_modes_sentence(log)}"
    yield "What is the correction worth?", _rigid_sentence(log)
    yield "Was the service well?", log.info.service.answer()


def _rigid_sentence(log: FlightLog) -> str:
    """How far rigid stereo's readings were from the published ones, as medians."""
    pairs = [(entry.rigid_range_m, entry.range_m) for entry in log.trusted()]
    finite = [abs(rigid_m - range_m) / range_m for rigid_m, range_m in pairs if rigid_m > 0.0]
    if not finite:
        return "no published range to compare with"
    beyond = len(pairs) - len(finite)
    text = f"rigid stereo would have read {100 * float(np.median(finite)):.0f} % wrong (median)"
    return text + (f", and in {beyond} of {len(pairs)} pairs nothing at all" if beyond else "")


def _modes_sentence(log: FlightLog) -> str:
    """First modes as medians of the flight, as the fleet's table has them."""
    summaries = [(name, log.mode(name)) for name in FAMILIES]
    text = ", ".join(
        f"{name} {mode.frequency_hz:.2f} ±{mode.frequency_sigma_hz:.2f} Hz vibrating by {1e3 * mode.rms_m:.1f} mm rms"
        for name, mode in summaries
        if mode is not None
    )
    return f"{text} (medians)" if text else "no mode was identified"


def _ranges(log: FlightLog) -> Iterator[Block]:
    if log.ranges:
        yield Heading("Ranges")
        text = page.capitalised(_rigid_sentence(log))
        yield embed(figures.ranges(log, text), "rigid and corrected ranges over time")


def _wing(log: FlightLog, wing: Wing) -> Iterator[Block]:
    if not log.modes:
        return
    yield Heading("Wing")
    yield embed(figures.modes(log, _modes_sentence(log)), "modes over time", _VIBRATION)
    if log.info.streams:
        candidates = {station: log.spectrum(station) for station in Station}
        spectra = {station: spectrum for station, spectrum in candidates.items() if spectrum is not None}
        if spectra:
            yield embed(figures.spectra(log, spectra, lines_sentence(spectra, wing)), "spectra of root and tips")
        else:
            yield Paragraph(f"No spectra: they need {2 * SPECTRUM_SEGMENT_S:.0f} s of samples at a steady rate.")


def lines_sentence(spectra: Mapping[Station, Spectrum], wing: Wing) -> str:
    """Sharp lines of each station, which an engine, a propeller, a loose part or a higher mode makes."""
    lines_of_stations = []
    for station, spectrum in spectra.items():
        lines = spectrum.lines_hz()
        if lines:
            named = ", ".join(f"{line:.1f} Hz{_higher_mode(line, wing)}" for line in lines)
            lines_of_stations.append(f"{station.name.lower()} {named}")
    return f"Vibration lines: {'; '.join(lines_of_stations)}" if lines_of_stations else "No sharp line at root or tips"


def _higher_mode(line_hz: float, wing: Wing) -> str:
    """Name of the nearest higher bending mode that the airframe file believes to be there, in brackets; empty without.

    The nearest is that of the fewest sigmas; its line may still be another's.
    """
    higher = {name: mode.frequency_hz for name, mode in wing.modes.items() if name not in FAMILIES}
    sigmas = {name: abs(line_hz - belief.value) / belief.sigma for name, belief in higher.items() if belief.sigma > 0}
    nearest = min(sigmas, key=sigmas.__getitem__, default=None)
    if nearest is None or sigmas[nearest] > _MODE_SIGMAS:
        return ""
    return f" (perhaps the {nearest.replace('_', ' ')} mode)"


def _triggers(log: FlightLog) -> Iterator[Block]:
    outcomes = log.plan_outcomes()
    if not outcomes:
        return
    yield Heading("Triggers")
    yield Table(("end of a plan to fire", "plans"), [(name, str(count)) for name, count in outcomes.items()])
    if log.delays_s:
        median_us, late_us = 1e6 * np.percentile(log.delays_s, (50, 99))
        text = f"{len(log.delays_s)} shots, fired {median_us:.0f} µs after plan (median), {late_us:.0f} µs (99 %)"
        yield embed(figures.triggers(log, text), "trigger delay and predicted blur", _BLUR)


def _clocks(log: FlightLog) -> Iterator[Block]:
    if log.clocks:
        yield Heading("Clocks")
        synced = sum(state.synced for state in log.clocks) / len(log.clocks)
        text = f"Clocks in step {100 * synced:.0f} % of the time"
        yield embed(figures.clocks(log, text), "error bound of each clock")


def _refusals(log: FlightLog) -> Iterator[Block]:
    withheld = sum(log.withheld().values())
    if log.refused or withheld:
        yield Heading("Refusals")
        count = sum(refusal.count for refusal in log.refused)
        text = f"{count} samples and other records refused, {withheld} ranges withheld"
        yield embed(figures.refusals(log, text), "refusals over time by reason", _REFUSED)


def _changed(settings: Settings) -> Block:
    default = Settings().values()
    changed = [(name, f"{value:g}", f"{default[name]:g}") for name, value in settings.changed().items()]
    if not changed:
        return Paragraph("All settings had their defaults.")
    return Table(("setting that differs from its default", "value", "default"), changed)
