"""Lines of motors and propellers: found, told from modes, taken out of the samples, the wing's motion left alone."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter

from companion.core.tracking.line_peaks import ChannelWindow, find_lines
from companion.core.tracking.line_removal import PARTS, line_states, remove_lines
from companion.core.tracking.line_search import KnownLines, SampleRing, channels_at, turned_lines
from companion.core.tracking.spread_work import SPREAD_S, Result, SpreadWork, Stages
from companion.core.tracking.streams import SampleBuffer
from companion.core.tracking.tracker import WingTracker
from companion.params.settings import Settings
from companion.records import Floats, Ints, Station
from sitl_tests.unit.tracking_samples import EPOCH_NS, batch, plain_airframe

RATE_HZ = 1000.0
WEIGHT = np.ones(6)
NOISE_MPS2 = 0.016  # of a sample of an ICM-42688: 70 ug/sqrt(Hz)


def stamps(seconds: float) -> Ints:
    return np.asarray(np.arange(round(seconds * RATE_HZ)) * 1_000_000, dtype=np.int64)


def wing(t_s: Floats) -> Floats:
    """Vertical force of a wing at 5 Hz and 5 m/s^2 under gravity, m/s^2."""
    return np.asarray(-9.81 + 5.0 * np.cos(2.0 * np.pi * 5.0 * t_s))


def samples(t_ns: Ints, vertical: Floats) -> Floats:
    noise = NOISE_MPS2 * np.random.default_rng(1).standard_normal((len(t_ns), 6))
    noise[:, 2] += vertical
    return noise


def channels_of(t_ns: Ints, values: Floats) -> list[ChannelWindow]:
    ring = SampleRing(RATE_HZ)
    ring.add(t_ns, values)
    return channels_at([ring], int(t_ns[-1]) + 1)


def completed(stages: Stages[Result]) -> Result:
    return SpreadWork(stages).finish()


def found_in(vertical: Floats, t_ns: Ints) -> list[float]:
    return [peak.frequency_hz for peak in completed(find_lines(channels_of(t_ns, samples(t_ns, vertical))))]


def wandering(t_s: Floats, frequency_hz: float, by_hz: float) -> Floats:
    """Phase of a line whose frequency swings by ``by_hz`` within four seconds, rad."""
    return np.asarray(2.0 * np.pi * frequency_hz * t_s + by_hz * 4.0 * np.sin(2.0 * np.pi * t_s / 4.0))


def test_a_line_is_found_where_it_is() -> None:
    t_ns = stamps(2.5)
    t_s = t_ns * 1e-9
    (frequency_hz,) = found_in(wing(t_s) + 0.05 * np.cos(2.0 * np.pi * 98.33 * t_s), t_ns)
    assert frequency_hz == pytest.approx(98.33, abs=0.05)


def test_a_line_whose_rpm_wanders_is_found() -> None:
    t_ns = stamps(2.5)
    t_s = t_ns * 1e-9
    (frequency_hz,) = found_in(wing(t_s) + 0.5 * np.cos(wandering(t_s, 80.0, 0.3)), t_ns)
    assert frequency_hz == pytest.approx(80.0, abs=0.7)


@pytest.mark.parametrize(("apart_hz", "second"), [(3.0, 1.0), (2.3, 0.5), (5.0, 0.2), (-4.0, 1.0)])
def test_two_propellers_of_nearly_the_same_rpm_have_two_lines(apart_hz: float, second: float) -> None:
    """In transforms of a quarter of a second they are one line that beats, as unsteady as noise."""
    t_ns = stamps(2.5)
    t_s = t_ns * 1e-9
    lines = np.cos(2.0 * np.pi * 83.1 * t_s) + second * np.cos(2.0 * np.pi * (83.1 + apart_hz) * t_s + 1.0)
    assert sorted(found_in(wing(t_s) + lines, t_ns)) == pytest.approx(sorted([83.1, 83.1 + apart_hz]), abs=0.1)


def test_engines_that_shake_a_wing_each_have_two_lines() -> None:
    t_ns = stamps(2.5)
    t_s = t_ns * 1e-9
    channels = [
        channel
        for f_hz in (83.1, 85.5)
        for channel in channels_of(t_ns, samples(t_ns, wing(t_s) + np.cos(2.0 * np.pi * f_hz * t_s)))
    ]
    lines_hz = sorted(peak.frequency_hz for peak in completed(find_lines(channels)))
    assert lines_hz == pytest.approx([83.1, 85.5], abs=0.1)


def test_two_lines_that_beat_leave_the_samples() -> None:
    """Two engines 3 Hz apart, from the search to the samples that the wing's model reads."""
    t_ns = stamps(6.0)
    t_s = t_ns * 1e-9
    line = 1.5 * (np.cos(2.0 * np.pi * 83.0 * t_s) + np.cos(2.0 * np.pi * 86.0 * t_s + 1.0))
    dirty = samples(t_ns, wing(t_s) + line)
    shafts = KnownLines()
    for end in (2500, 3500):  # in one window alone noise in a narrow band may look like two lines
        completed(shafts._search(channels_of(t_ns[:end], dirty[:end]), {}))
    leaders_hz = np.array(list(shafts.leader_hz.values()))
    states = line_states(leaders_hz, list(shafts.multiples.values()), WEIGHT, RATE_HZ)
    remainder = remove_lines(t_ns, dirty, 0, 1.0 / RATE_HZ, states) - samples(t_ns, wing(t_s))
    assert np.std(remainder[2000:, 2]) < 0.1 * np.std(line)


def test_a_wing_without_motors_has_no_line() -> None:
    t_ns = stamps(2.5)
    assert found_in(wing(t_ns * 1e-9), t_ns) == []


def shaken_mode(t_ns: Ints, frequency_hz: float, damping: float, seed: int) -> Floats:
    """White load through a mode, in units of its rms."""
    omega = 2.0 * np.pi * frequency_hz / RATE_HZ
    decay = np.exp(-damping * omega)
    load = np.random.default_rng(seed).standard_normal(len(t_ns))
    response = lfilter([1.0], [1.0, -2.0 * decay * np.cos(omega), decay**2], load)
    return np.asarray(response / response.std())


def test_a_lightly_damped_mode_is_no_line() -> None:
    """One percent of damping at 70 Hz: a peak 1.4 Hz wide, 30 dB above its surroundings."""
    t_ns = stamps(6.0)
    alone = sum(len(found_in(5.0 * shaken_mode(t_ns, 70.0, 0.01, seed) + wing(t_ns * 1e-9), t_ns)) for seed in range(8))
    assert alone <= 1, "two seconds hold some eight independent envelopes: one of them may look steady"


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_second_mode_above_45_hz_is_no_shaft_for_a_minute(seed: int) -> None:
    """One search in sixty took it for one whose rpm wanders from 45 to 62 Hz, and the toe was off by 0.2 mrad."""
    t_ns, shafts = stamps(60.0), KnownLines()
    values = samples(t_ns, wing(t_ns * 1e-9) + 2.0 * shaken_mode(t_ns, 54.0, 0.02, seed))
    for end in range(2500, len(t_ns), 1000):
        completed(shafts._search(channels_of(t_ns[end - 2500 : end], values[end - 2500 : end]), {}))
        assert not shafts.leader_hz, end


@pytest.mark.parametrize("lines", [(80.0,), (80.0, 160.0)])
def test_lines_leave_the_samples_and_the_wing_stays(lines: tuple[float, ...]) -> None:
    t_ns = stamps(6.0)
    t_s = t_ns * 1e-9
    line = sum((2.0 * np.cos(k + wandering(t_s, f, 0.3)) for k, f in enumerate(lines)), np.zeros(len(t_s)))
    dirty, clean = samples(t_ns, wing(t_s) + line), samples(t_ns, wing(t_s))
    states = line_states(np.array(lines), [[PARTS]] * len(lines), WEIGHT, RATE_HZ)
    left = (remove_lines(t_ns, dirty, 0, 1.0 / RATE_HZ, states) - clean)[1000:, 2]
    assert np.std(left) < 0.15 * np.std(line)
    slow = np.exp(-2j * np.pi * 5.0 * t_s[1000:]) @ left * 2.0 / len(left)
    assert abs(slow) < 1e-3 * 5.0
    assert abs(left.mean()) < 1e-3


def test_the_spacing_of_calls_changes_nothing() -> None:
    t_ns = stamps(1.0)
    values = samples(t_ns, np.cos(2.0 * np.pi * 80.0 * t_ns * 1e-9))
    at_once = remove_lines(t_ns, values, 0, 1.0 / RATE_HZ, line_states(np.array([80.0]), [[PARTS]], WEIGHT, RATE_HZ))
    states, parts = line_states(np.array([80.0]), [[PARTS]], WEIGHT, RATE_HZ), []
    for first in range(0, 1000, 37):
        end = min(first + 37, 1000)
        parts.append(remove_lines(t_ns[:end], values[:end], first, 1.0 / RATE_HZ, states))
    assert np.array_equal(np.concatenate(parts), at_once)


def test_a_lie_and_a_gap_do_not_unlock_it() -> None:
    t_ns = stamps(4.0)
    line = np.cos(2.0 * np.pi * 80.0 * t_ns * 1e-9)
    values = samples(t_ns, line)
    values[2000, 2] += 1e6
    sent = (t_ns < 3_000_000_000) | (t_ns >= 3_050_000_000)
    left = remove_lines(
        t_ns[sent], values[sent], 0, 1.0 / RATE_HZ, line_states(np.array([80.0]), [[PARTS]], WEIGHT, RATE_HZ)
    )[:, 2]
    assert np.std(left[2010:2200]) < 0.1
    assert np.std(left[3000:]) < 0.1


def test_an_axis_that_is_not_sent_has_no_line() -> None:
    t_ns = stamps(2.5)
    assert completed(find_lines(channels_of(t_ns, np.zeros((len(t_ns), 6))))) == []


def test_a_line_stays_in_lock_when_rpm_jumps() -> None:
    """From 85 to 93 Hz and back within 0.6 s each, as a pull-up's throttle does it; the harmonic goes with it."""
    t_ns = stamps(6.0)
    t_s = t_ns * 1e-9
    shaft_hz = 85.0 + 8.0 * np.clip((t_s - 2.0) / 0.6, 0.0, 1.0) - 8.0 * np.clip((t_s - 4.0) / 0.6, 0.0, 1.0)
    turn_rad = 2.0 * np.pi * np.cumsum(shaft_hz) / RATE_HZ
    line = 2.0 * np.cos(turn_rad) + np.cos(2.0 * turn_rad + 1.0)
    dirty, clean = samples(t_ns, wing(t_s) + line), samples(t_ns, wing(t_s))
    states = line_states(np.array([85.0]), [[PARTS, 2 * PARTS]], WEIGHT, RATE_HZ)
    residual = (remove_lines(t_ns, dirty, 0, 1.0 / RATE_HZ, states) - clean)[1000:, 2]
    blocks = np.std(residual.reshape(-1, 500), axis=1)
    assert np.all(blocks < 0.15 * np.std(line))


def known_after(
    *searches_hz: tuple[float, ...], followed: dict[int, tuple[float, float]] | None = None
) -> dict[int, float]:
    """Known lines after searches of two-second windows with these steady lines."""
    known_lines = KnownLines()
    for lines in searches_hz:
        t_ns = stamps(2.5)
        vertical = sum((np.cos(2.0 * np.pi * f * t_ns * 1e-9) for f in lines), wing(t_ns * 1e-9))
        ring = SampleRing(RATE_HZ)
        ring.add(t_ns, samples(t_ns, vertical))
        completed(known_lines.search([ring], int(t_ns[-1]) + 1, followed or {}))
    return known_lines.leader_hz


def test_a_peak_near_a_followed_line_is_that_line() -> None:
    assert known_after((85.0,), (88.5,)) == {0: pytest.approx(85.0, abs=0.1)}


def test_a_line_found_elsewhere_twice_begins_anew() -> None:
    assert known_after((85.0,), (90.0,), (90.0,)) == {1: pytest.approx(90.0, abs=0.1)}


def test_a_followed_line_is_where_it_is_followed() -> None:
    assert known_after((85.0,), (), followed={0: (91.0, 0.0)}) == {0: 91.0}


def test_two_motors_have_two_lines() -> None:
    assert sorted(known_after((85.0, 90.0), (85.0, 90.0)).values()) == pytest.approx([85.0, 90.0], abs=0.1)


def test_a_line_that_is_gone_is_dropped() -> None:
    assert known_after((85.0,), (), (), (), (), ()) == {}


def shaft_turns(t_s: Floats, shaft_hz: float) -> Floats:
    """Turns of a shaft whose rate swings by 3 % within four seconds, rad."""
    return np.asarray(2.0 * np.pi * shaft_hz * (t_s + 0.03 * 4.0 / (2.0 * np.pi) * np.sin(2.0 * np.pi * t_s / 4.0)))


def test_weak_lines_of_a_wandering_shaft_are_found() -> None:
    """A hundredth of the leader, at half its frequency and at one and a half times; not one of another shaft."""
    t_ns = stamps(2.5)
    t_s = t_ns * 1e-9
    turn_rad = shaft_turns(t_s, 70.0)
    weak = 0.05 * (np.cos(0.5 * turn_rad) + np.cos(1.5 * turn_rad + 1.0) + np.cos(2.6 * turn_rad))
    channels = channels_of(t_ns, samples(t_ns, wing(t_s) + 5.0 * np.cos(turn_rad) + weak))
    (leader, *_) = completed(find_lines(channels))
    assert leader.frequency_hz == pytest.approx(70.0, rel=0.03)
    assert sorted(completed(turned_lines(leader, channels))) == [PARTS // 2, 3 * PARTS // 2]


def test_broadband_vibration_has_no_turned_lines() -> None:
    t_ns = stamps(2.5)
    t_s = t_ns * 1e-9
    for seed in range(5):
        broadband = 0.4 * np.random.default_rng(seed).standard_normal(len(t_s))
        channels = channels_of(t_ns, samples(t_ns, wing(t_s) + 5.0 * np.cos(shaft_turns(t_s, 70.0)) + broadband))
        assert completed(turned_lines(completed(find_lines(channels))[0], channels)) == {}


def test_lines_of_one_shaft_are_one_shaft() -> None:
    known_lines = KnownLines()
    for seconds in (2.5, 3.5):
        t_ns = stamps(seconds)
        turn_rad = shaft_turns(t_ns * 1e-9, 70.0)
        values = samples(t_ns, wing(t_ns * 1e-9) + 5.0 * np.cos(turn_rad) + np.cos(2.0 * turn_rad))
        ring = SampleRing(RATE_HZ)
        ring.add(t_ns, values)
        completed(known_lines.search([ring], int(t_ns[-1]) + 1, {}))
    assert list(known_lines.multiples.values()) == [(PARTS, 2 * PARTS)]


@pytest.mark.parametrize("half_order", [True, False])
def test_a_bending_mode_s_second_harmonic_is_no_shaft(half_order: bool) -> None:
    """A mode of 25.1 Hz that hardly decays shows twice its frequency across; an engine has a weaker half order."""
    known_lines = KnownLines()
    for seconds in (2.5, 3.5):
        t_ns = stamps(seconds)
        swing = np.cos(np.outer(2.0 * np.pi * 25.12 * t_ns * 1e-9, (1.0, 2.0)))
        values = samples(t_ns, wing(t_ns * 1e-9))
        lateral, vertical, rate = (
            ((0.3, 1.0), (1.0, 3.0), (0.01, 0.02)) if half_order else ((0.3, 0.25), (10, 0), (0.2, 0))
        )
        for channel, amplitude in ((1, lateral), (2, vertical), (3, rate)):
            values[:, channel] += swing @ amplitude
        assert any(abs(peak.frequency_hz - 50.24) < 0.3 for peak in completed(find_lines(channels_of(t_ns, values))))
        ring = SampleRing(RATE_HZ)
        ring.add(t_ns, values)
        completed(known_lines.search([ring], int(t_ns[-1]) + 1, {}))
    assert list(known_lines.multiples.values()) == ([(PARTS, PARTS // 2)] if half_order else [])


def test_a_weak_line_turns_with_its_leader() -> None:
    """A line a hundredth of the leader's, in noise in which it alone could not be followed, leaves the samples."""
    t_ns = stamps(6.0)
    turn_rad = shaft_turns(t_ns * 1e-9, 70.0)
    weak = 0.1 * np.cos(2.0 * turn_rad)
    noise = samples(t_ns, wing(t_ns * 1e-9) + 0.4 * np.random.default_rng(2).standard_normal(len(t_ns)))
    dirty = noise.copy()
    dirty[:, 2] += 10.0 * np.cos(turn_rad) + weak
    states = line_states(np.array([70.0]), [[PARTS, 2 * PARTS]], WEIGHT, RATE_HZ)
    left = remove_lines(t_ns, dirty, 0, 1.0 / RATE_HZ, states)[2000:, 2]
    remainder = (left @ np.exp(2j * turn_rad[2000:])) / (np.exp(2j * turn_rad[2000:]) @ weak[2000:])
    assert abs(remainder) < 0.2, "of the weak line's amplitude"


def chopped(t_s: Floats) -> Floats:
    """Phase of a shaft whose throttle is closed and opened again: 65 to 33 Hz and back at 20 Hz a second, rad."""
    rate_hz = np.interp(t_s, [0.0, 5.0, 6.6, 9.0, 10.6], [65.0, 65.0, 33.0, 33.0, 65.0])
    return np.asarray(2.0 * np.pi * np.cumsum(rate_hz) / RATE_HZ)


@pytest.mark.parametrize("gust_mps2", [0.0, 20.0])
def test_a_shaft_is_followed_while_the_throttle_is_closed_and_opened(gust_mps2: float) -> None:
    """From above the search's band to idle and back, in two axes; gusts that shake the third stronger hide nothing."""
    t_ns = stamps(14.0)
    turn_rad = chopped(t_ns * 1e-9)
    shaken = gust_mps2 * np.random.default_rng(3).standard_normal(len(t_ns))
    values = samples(t_ns, wing(t_ns * 1e-9) + shaken)
    line = 3.0 * np.cos(turn_rad)
    values[:, :2] += line[:, None]
    stream, known_lines, clean = SampleBuffer(plain_airframe().left), KnownLines(), []
    for end in range(200, len(t_ns) + 1, 200):
        cut = slice(end - 200, end)
        stream.add(batch(Station.LEFT, EPOCH_NS + t_ns[cut], values[cut]), 0)
        cleaned = stream.plain(EPOCH_NS + int(t_ns[cut][-1]))
        clean.append(cleaned.values[-190:, 1])
        if end % 1000 == 0:
            before = known_lines.multiples
            search = known_lines.search([stream.ring], EPOCH_NS + int(t_ns[end - 1]) + 1, stream.followed_shafts())
        elif end % 1000 == round(1000 * SPREAD_S) and end > 1000:
            completed(search)
            known_lines.follow(stream.followed_shafts())
            if known_lines.multiples != before:
                stream.follow_lines(known_lines.leader_hz, known_lines.multiples)
            stream.anchor_lines(known_lines.leader_hz)
        stream.forget(EPOCH_NS + int(t_ns[end - 1]) - 100_000_000)
    assert list(known_lines.leader_hz) == [0], "the shaft that was found first"
    assert known_lines.leader_hz[0] == pytest.approx(65.0, abs=1.0)
    assert max(np.std(stretch) for stretch in clean[25:]) < 0.25 * np.std(line)


def test_tips_that_gusts_shake_follow_the_shaft_that_the_root_holds() -> None:
    """An engine slows from 92 to 40 Hz in 4.5 s and runs up again, and the tips' gusts hide it.

    Left to themselves, their loops lost it, and it was dropped: the root of 333 Hz did not count.
    """
    t_ns, rng = stamps(16.0), np.random.default_rng(4)
    t_s = t_ns * 1e-9
    rpm_hz = np.interp(t_s, [0.0, 6.0, 10.5, 12.0, 15.0], [92.0, 92.0, 40.0, 40.0, 80.0])
    line = np.cos(2.0 * np.pi * np.cumsum(rpm_hz) / RATE_HZ)
    airframe = plain_airframe()
    slow = dataclasses.replace(airframe.root, rate_hz=1000.0 / 3.0)
    tracker = WingTracker(dataclasses.replace(airframe, root=slow), Settings(adapt=0))
    gust_mps2 = np.where(t_s < 5.0, 0.1, 10.0) * rng.standard_normal((2, len(t_s)))
    for first in range(0, len(t_ns), 60):
        for station, amplitude_mps2 in ((Station.ROOT, 1.0), (Station.LEFT, 5.0), (Station.RIGHT, 4.0)):
            span = slice(first, first + 60, 3 if station is Station.ROOT else 1)
            values = rng.normal(size=(len(t_ns[span]), 6)) * np.repeat([NOISE_MPS2, 0.0011], 3)
            values[:, 2] += amplitude_mps2 * line[span] - 9.80665
            if station is not Station.ROOT:
                values[:, 2] += gust_mps2[station - 1, span]
            tracker.add(batch(station, EPOCH_NS + t_ns[span], values))
        tracker.process_until(EPOCH_NS + int(t_ns[span][-1]))
        if first % 1020 == 0 and first > 6_000:
            followed = [stream.followed_shafts() for stream in tracker._streams]
            assert [list(shafts) for shafts in followed] == [[0]] * 3, "the shaft that was found first"
            frequency_hz, ratio = np.array([shafts[0] for shafts in followed]).T
            assert ratio[0] > 1.0
            assert min(ratio[1:]) < 1.0
            assert frequency_hz == pytest.approx(rpm_hz[first], abs=3.0)


def test_a_station_that_fell_silent_leads_no_shaft() -> None:
    """It kept the frequency that it saw last, beside which each search began another shaft."""
    t_ns, rng = stamps(12.0), np.random.default_rng(4)
    t_s = t_ns * 1e-9
    rpm_hz = 80.0 + 5.0 * np.clip(t_s - 5.0, 0.0, 4.0)
    line = np.cos(2.0 * np.pi * np.cumsum(rpm_hz) / RATE_HZ)
    tracker = WingTracker(plain_airframe(), Settings(adapt=0))
    for first in range(0, len(t_ns), 100):
        span = slice(first, first + 100)
        for station, amplitude_mps2 in ((Station.ROOT, 0.3), (Station.LEFT, 3.0), (Station.RIGHT, 1.0)):
            values = rng.normal(size=(100, 6)) * np.repeat([NOISE_MPS2, 0.0011], 3)
            values[:, 2] += amplitude_mps2 * line[span] - 9.80665
            if station is not Station.LEFT or t_s[first] < 4.0:
                tracker.add(batch(station, EPOCH_NS + t_ns[span], values))
        tracker.process_until(EPOCH_NS + int(t_ns[span][-1]))
    (leader_hz,) = tracker._lines._lines.leader_hz.values()
    assert leader_hz == pytest.approx(100.0, abs=0.3)


def test_what_shakes_one_axis_does_not_come_out_in_another_that_has_the_line() -> None:
    """Through the phase of their common line the wing's 1.5 m/s^2 at 28 Hz left 1.7 mm/s^2 across, in step with it."""
    n, rng = 12_000, np.random.default_rng(2)
    t_s = np.arange(n) * 1e-3
    values = 0.0157 * rng.standard_normal((n, 6)) * np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])
    values[:, 1] += 2.3 * np.cos(2.0 * np.pi * 80.0 * t_s + 1.0)
    values[:, 2] += 3.0 * np.cos(2.0 * np.pi * 80.0 * t_s) + 1.5 * np.sin(2.0 * np.pi * 28.0 * t_s)
    states = line_states(np.array([80.0]), [[PARTS]], np.array([2e6, 2e6, 2e6, 4e8, 4e8, 4e8]), 1000.0)
    clean = remove_lines(np.round(t_s * 1e9).astype(np.int64), values, 0, 1e-3, states)[4000:]
    turned = np.exp(-2j * np.pi * 28.0 * t_s[4000:])
    across, up = (2.0 * abs(np.mean(clean[:, axis] * turned)) for axis in (1, 2))
    assert up == pytest.approx(1.5, rel=0.01)
    assert across < 0.0008


def test_a_wing_that_swings_far_more_than_a_weak_line_does_not_draw_it() -> None:
    """A second mode of 25 m/s^2 at 28 Hz, a line of 0.7 at 68 Hz: the loop left the line and took the mode out."""
    n, rng = 12_000, np.random.default_rng(0)
    t_s = np.arange(n) * 1e-3
    load, decay, omega = rng.standard_normal(n), np.exp(-0.02 * 2.0 * np.pi * 0.028), 2.0 * np.pi * 0.028
    mode = np.zeros(n)
    for k in range(2, n):
        mode[k] = load[k] + 2.0 * decay * np.cos(omega) * mode[k - 1] - decay**2 * mode[k - 2]
    wing_mps2 = 25.0 * mode / mode.std() + 40.0 * np.cos(2.0 * np.pi * 5.0 * t_s)
    turn_rad = wandering(t_s, 68.0, 0.5)
    line = np.array([0.1, 0.2, 0.7, 0.006, 0.0, 0.0]) * np.cos(turn_rad[:, None] + np.arange(6))
    values = line + rng.standard_normal((n, 6)) * np.repeat([0.05, 0.003], 3)
    values[:, 2] += wing_mps2
    values[:, 3] += 0.02 * wing_mps2
    states = line_states(np.array([68.0]), [[PARTS]], np.repeat([0.05, 0.003], 3) ** -2.0, RATE_HZ)
    removed = (values - remove_lines(np.arange(n) * 1_000_000, values, 0, 1.0 / RATE_HZ, states))[2000:]
    assert np.std(removed[:, 0]) == pytest.approx(np.std(line[:, 0]), rel=0.03)
    assert np.std(removed[:, 3]) < 0.1 * np.std(values[:, 3])


def test_a_blade_pass_that_is_stronger_than_the_shaft_holds_the_lock() -> None:
    """Followed by the leader alone, both lines stayed in the samples, whose noise was 1.8 to 3 times too large."""
    rng, n, noise = np.random.default_rng(0), 30_000, 0.25
    wander = lfilter([np.sqrt(1e-3)], [1.0, -(1.0 - 5e-4)], rng.standard_normal(n))  # over two seconds, to 1 % of rpm
    phase = 2.0 * np.pi * np.cumsum(74.0 * (1.0 + 0.01 * wander)) * 1e-3
    values = 0.01 * rng.standard_normal((n, 6))
    for channel, size in enumerate((0.7, 0.5, 1.0)):
        both = 0.6 * np.cos(phase + channel) + 0.8 * np.cos(2.0 * phase + 2.0 * channel)
        values[:, channel] = size * both + noise * rng.standard_normal(n)
    weight = np.array([noise**-2.0] * 3 + [1e4] * 3)
    states = line_states(np.array([74.0]), [(PARTS, 2 * PARTS)], weight, 1000.0)
    clean = remove_lines(1_000_000 * np.arange(n, dtype=np.int64), values, 0, 1e-3, states)
    assert (clean[5000:, :3].std(axis=0) < 1.15 * noise).all()
