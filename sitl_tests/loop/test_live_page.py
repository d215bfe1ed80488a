"""The page of the live view in a real browser, on a phone's screen and on a laptop's."""

from __future__ import annotations

import dataclasses
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("foxglove", reason="the extra live is not installed")

from companion.live.about import ViewKind
from companion.live.config import LiveConfig
from companion.live.door import listen
from companion.live.session import LiveSession, Subject
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import (
    Axis,
    ClockName,
    ClockState,
    CorrectedRange,
    Deflection,
    Firing,
    Frame,
    Health,
    MatchSet,
    ModeEstimate,
    ModeState,
    NoRange,
    Notice,
    ObstacleSectors,
    ParameterChange,
    Record,
    Reject,
    ServiceStatus,
    Shot,
    Side,
    Station,
    TriggerPlan,
    Validity,
)
from sitl_tests.loop.browser import Browser, browser_path

pytestmark = [pytest.mark.slow, pytest.mark.skipif(browser_path() is None, reason="no Chromium or Chrome is installed")]
S, MS = 1_000_000_000, 1_000_000
STEP_NS = 100 * MS
SIZES = {"phone": (390, 844), "laptop": (1440, 900)}


def mode(frequency_hz: float, t_s: float) -> ModeEstimate:
    phase_rad = math.remainder(2 * math.pi * frequency_hz * t_s, 2 * math.pi)
    return ModeEstimate(frequency_hz, 0.05, 0.03, 0.01, 0.006, 0.0002, phase_rad, 0.1, frequency_hz, 0.1, 0.0042)


def records_at(step: int) -> list[Record | Frame]:
    """A tenth of a second of a flight at 60 m, with everything that the page shows."""
    t_ns = 1_000 * S + step * STEP_NS
    symmetric, antisymmetric = mode(5.0, step * 0.1), mode(6.4, step * 0.1)
    q_m = np.array([0.015 + 0.006 * math.cos(symmetric.phase_rad), 0.006 * math.cos(antisymmetric.phase_rad)])
    pixels = np.random.default_rng(step).uniform((0, 0), (64, 48), (40, 2))
    middle_ns = np.array([t_ns, t_ns + 200_000])
    image = np.random.default_rng(1).integers(0, 255, (48, 64)).astype(np.uint8)
    viewed = np.zeros(72, bool)
    viewed[2:9] = True
    frames = [Frame(side, step, ClockName.HOST, int(middle_ns[side]), MS, 0, step, image) for side in Side]
    return [
        ModeState(t_ns, symmetric, antisymmetric, Validity.TRACKING, q_m, np.full(2, 1e-4), tuple(Station),
                  (Axis.ALL,) * 3),
        TriggerPlan(step, Firing.PEAK, t_ns + 20 * MS, t_ns + 28 * MS, MS, 0.4, t_ns + S, t_ns),
        Deflection(t_ns, q_m, np.zeros(2), np.zeros(2), np.eye(6), np.zeros(3), 0, 1e-4),
        Shot(step, t_ns + 20 * MS, t_ns + 20 * MS + 9_000),
        *frames,
        MatchSet(step, step, (ClockName.HOST,) * 2, middle_ns, MS, 0, pixels, pixels - 3.0, np.full(40, 0.1), t_ns),
        CorrectedRange(step, step, t_ns, 25, 60.25, 0.31, 0.0405, 0.0002, 27.1, 170, True, None),
        ObstacleSectors(t_ns, np.full(72, 33.5), np.full(72, 0.5), viewed, ~viewed & (np.arange(72) < 12), 1.0, 100.0),
        ClockState(ClockName.BOOT, t_ns, 5, 12.5, 400_000, step > 3),
        ServiceStatus(t_ns, Health.ACTIVE, "tracking", {"samples left": 100 * step, str(Reject.CRC): 7}),
    ]  # fmt: skip


@dataclasses.dataclass
class Flight:
    """A session that is fed until it is told to stop."""

    session: LiveSession
    url: str
    asked: list[tuple[str, float]]
    over: threading.Event

    @property
    def port(self) -> int:
        return int(self.url.split(":")[-1].strip("/"))

    def stop(self) -> None:
        """Feed it no more, and say its end."""
        self.over.set()
        self.session.end()


Records = Callable[[int], list[Record | Frame]]
REPLAY: dict[str, Any] = {
    "title": "flight.mcap", "ask": None, "kind": ViewKind.REPLAY, "is_recording": True, "has_images": False,
    "began_host_ns": 990 * S,
}  # fmt: skip


@contextmanager
def flying(folder: Path, port: int = 0, records: Records = records_at, **changes: Any) -> Iterator[Flight]:
    """A flight that the live view shows; ``changes`` are made to what it is told about it."""
    config = LiveConfig("127.0.0.1", port, None, folder)
    listening = listen(config)
    asked: list[tuple[str, float]] = []
    subject = Subject(load_airframe("nadir-2m"), Settings(), "test", ask=lambda *wish: asked.append(wish))
    session = LiveSession(config, dataclasses.replace(subject, **changes), listening)
    over = threading.Event()

    def fly() -> None:
        step = changes = 0
        session.publish(Notice(4, "node_left clock restarted; waiting for sync", 1_000 * S))
        while not over.wait(0.1):
            for record in records(step):
                session.publish(record)
            for name, value in asked[changes:]:
                session.publish(ParameterChange(name, value, 1_000 * S + step * STEP_NS))
            changes = len(asked)
            session.tend()
            step += 1

    thread = threading.Thread(target=fly)
    thread.start()
    try:
        yield Flight(session, f"http://127.0.0.1:{listening.getsockname()[1]}/", asked, over)
    finally:
        over.set()
        thread.join()
        session.close()
        listening.close()


@pytest.fixture
def flight(tmp_path: Path) -> Iterator[Flight]:
    with flying(tmp_path) as flown:
        yield flown


_LABELS_FIT = """[...document.querySelectorAll('#wing text.strong')].every(label => {
  label.textContent = '+25.9 mm';
  const box = label.getBBox();
  return box.x >= 0 && box.x + box.width <= 640;
})"""
_KEYS_WHOLE = "[...document.querySelectorAll('.legend .key')].every(key => key.getClientRects().length === 1)"


def text(browser: Browser, place: str) -> str:
    return str(browser.value(f"document.querySelector('{place}').textContent"))


@pytest.mark.parametrize("screen", SIZES)
def test_the_page_shows_the_flight(flight: Flight, screen: str, tmp_path: Path) -> None:
    width_px, height_px = SIZES[screen]
    with Browser(width_px, height_px) as browser:
        browser.open(flight.url)
        browser.until("document.getElementById('range-now')?.textContent.startsWith('60.25')")
        browser.until("document.getElementById('health').textContent === 'active'")
        assert "trusted" in text(browser, "#range-word")
        assert text(browser, "#rigid-now") == "27.1 m"
        assert text(browser, "#toe-now").startswith("+40.50")
        assert "node_left clock restarted" in text(browser, "#events")
        assert "7 checksum wrong" in text(browser, "#refusals")
        assert "nearest 33.5 m" in text(browser, "#sectors-word")
        browser.until("document.getElementById('link').textContent === 'live'")
        browser.until("document.querySelector('#clocks').textContent.includes('0.40 ms')")
        browser.until("document.querySelectorAll('#phase g circle').length > 5")
        browser.until("document.querySelector('#range-chart path[stroke-width=\"2\"]').getAttribute('d').length > 20")
        bent = "document.querySelector('#wing path[stroke-width=\"7\"]').getAttribute('d')"
        before = browser.value(bent)
        browser.until(f"{bent} !== {before!r}")
        browser.value("document.getElementById('images').scrollIntoView()")
        browser.until(
            "document.querySelector('#image-right image').getAttribute('href')?.startsWith('data:image/jpeg')"
        )
        browser.until("document.querySelector('#image-left path').getAttribute('d').length > 100")
        assert text(browser, "#matches") == "40 matched features"
        assert browser.value("document.documentElement.scrollWidth <= innerWidth"), "nothing is cut off at the side"
        assert browser.value(_LABELS_FIT), "the tips' labels lie inside the drawing"
        assert browser.value(_KEYS_WHOLE), "a key of a legend stands beside its word"
        browser.screenshot(tmp_path / f"{screen}.png")
        assert browser.complaints == []


def test_a_parameter_is_set_and_a_recording_made_from_the_page(flight: Flight) -> None:
    field = "[...document.querySelectorAll('.row')].find((row) => row.textContent.startsWith('RNG_MAX'))"
    with Browser(*SIZES["laptop"]) as browser:
        browser.open(flight.url)
        browser.until("document.querySelectorAll('.row').length > 20")
        set_to = (
            f"(({{field}}) => {{ field.value = '90'; field.onchange(); }})({{field: {field}.querySelector('input')}})"
        )
        browser.value(set_to)
        browser.until(f"{field}.classList.contains('changed')")
        assert flight.asked == [("RNG_MAX", 90.0)]
        browser.value(set_to.replace("'90'", "'1e9'"))
        browser.until("document.getElementById('toast').textContent.includes('RNG_MAX')")
        browser.until(f"{field}.querySelector('input').value === '90'")
        assert flight.asked == [("RNG_MAX", 90.0)], "what is out of range is not asked for"
        emptied = set_to.replace("'90'", "''").replace("RNG_MAX", "TRK_CALM")
        browser.value(emptied)
        browser.until(f"{field.replace('RNG_MAX', 'TRK_CALM')}.querySelector('input').value !== ''")
        browser.value(set_to.replace("'90'", "'91'"))
        browser.until("document.getElementById('toast').textContent.includes('91')")
        assert flight.asked == [("RNG_MAX", 90.0), ("RNG_MAX", 91.0)], "an emptied field is no 0"
        browser.until("!document.getElementById('record').hidden")
        browser.value("document.getElementById('record').click()")
        browser.until("document.getElementById('record').textContent === 'Stop recording'")
        browser.value("document.getElementById('record').click()")
        browser.until("document.querySelector('#files a')?.textContent === 'live.mcap'")


def test_the_page_says_that_nothing_comes_any_more(flight: Flight) -> None:
    with Browser(*SIZES["phone"]) as browser:
        browser.open(flight.url)
        browser.until("document.getElementById('health').textContent === 'active'")
        flight.session.close()
        browser.until("document.getElementById('health').textContent === 'no data'")
        assert "does not answer" in text(browser, "#reason")


ENDED = "document.getElementById('health').textContent === 'ended'"


def tops(browser: Browser, *places: str) -> list[float]:
    """Heights at which some cards stand."""
    return [float(browser.value(f"document.querySelector('{each}').getBoundingClientRect().top")) for each in places]


def without(*kinds: type) -> Records:
    return lambda step: [record for record in records_at(step) if not isinstance(record, kinds)]


@pytest.mark.parametrize("screen", SIZES)
def test_a_replay_says_what_it_is(tmp_path: Path, screen: str) -> None:
    with flying(tmp_path, records=without(Frame), **REPLAY) as replay, Browser(*SIZES[screen]) as browser:
        browser.open(replay.url)
        browser.until("document.getElementById('link').textContent === 'replay'")
        assert text(browser, "#image-word") == "this recording has no images"
        assert browser.value("document.querySelector('#images .pair').getBoundingClientRect().height") == 0
        assert "cannot be set" in text(browser, "#parameters-word")
        browser.until("document.getElementById('recording').textContent.startsWith('flight.mcap is shown')")
        browser.until("document.getElementById('time').textContent.startsWith('0:1')")
        assert text(browser, "#since") == "into the recording"
        assert browser.complaints == []


def test_a_demo_says_what_it_is(tmp_path: Path) -> None:
    with (
        flying(tmp_path, ask=None, kind=ViewKind.DEMO, is_recording=True) as demo,
        Browser(*SIZES["laptop"]) as browser,
    ):
        browser.open(demo.url)
        browser.until("document.getElementById('link').textContent === 'demo'")
        assert text(browser, "#parameters-word") == "the demo's parameters cannot be set"


@pytest.mark.parametrize("screen", SIZES)
def test_the_end_of_a_recording_is_no_failure(tmp_path: Path, screen: str) -> None:
    with flying(tmp_path, **REPLAY) as replay, Browser(*SIZES[screen]) as browser:
        browser.open(replay.url)
        browser.until("document.getElementById('range-now').textContent.startsWith('60.25')")
        browser.until("document.getElementById('health').textContent === 'active'")
        replay.over.set()
        time.sleep(0.3)
        for _ in range(3):  # as a flight that stops: what stands behind the last range is no range
            replay.session.publish(NoRange(1_001 * S, 25, Reject.STALE))
        browser.until("document.getElementById('range-word').textContent.startsWith('none')")
        replay.session.end()
        browser.until(ENDED)
        replay.session.close()
        browser.until("document.getElementById('range-chart').textContent.endsWith('end')")
        time.sleep(3.0)  # until the page has tried to connect again
        assert text(browser, "#reason") == "the recording has ended; these are its last values"
        assert text(browser, "#link") == "ended"
        assert text(browser, "#range-now").startswith("60.25")
        assert text(browser, "#range-word").startswith("last range: trusted")
        assert not browser.value("document.getElementById('range-now').classList.contains('withheld')")
        assert "now" not in text(browser, "main")
        at_end = text(browser, "#time")
        browser.screenshot(tmp_path / f"ended-{screen}.png")
        time.sleep(1.5)
        assert text(browser, "#time") == at_end
        colors = [f"getComputedStyle({place}).backgroundColor" for place in
                  ("document.getElementById('link-dot')", "document.getElementById('health')")]  # fmt: skip
        assert browser.value(f"{colors[0]} === {colors[1]}"), "both grey"
        ink = "getComputedStyle({}).color"
        said = "document.querySelector('#events li.warning span')"
        assert browser.value(f"{ink.format(said)} === {ink.format('document.body')}"), "a warning of then is no alarm"


def test_who_opens_the_page_after_the_end_is_told_so(tmp_path: Path) -> None:
    with flying(tmp_path, **REPLAY) as replay, Browser(*SIZES["phone"]) as browser:
        replay.stop()
        browser.open(replay.url)
        browser.until("document.getElementById('health')?.textContent === 'ended'")
        assert text(browser, "#reason") == "the recording has ended"


def test_the_page_goes_over_to_the_service_that_follows(tmp_path: Path) -> None:
    with Browser(*SIZES["phone"]) as browser:
        with flying(tmp_path) as first:
            browser.open(first.url)
            browser.until("document.getElementById('health')?.textContent === 'active'")
            first.stop()
            browser.until(ENDED)
            assert text(browser, "#reason") == "the service was stopped; these are its last values"
        with flying(tmp_path, first.port, title="second"):
            browser.until("document.getElementById('who').textContent === 'nadir-2m, second'")
            browser.until("document.getElementById('health').textContent === 'active'")


def test_on_a_phone_what_is_wrong_stands_right_below_the_range(tmp_path: Path) -> None:
    with flying(tmp_path, records=without(ObstacleSectors)) as flown, Browser(*SIZES["phone"]) as browser:
        browser.open(flown.url)
        browser.until("document.getElementById('events')?.textContent.includes('clock restarted')")
        order = tops(browser, ".range", ".events", ".health", ".wing", ".recordings", ".parameters")
        assert order == sorted(order)
        assert order[1] < SIZES["phone"][1], "on the first screen"
        assert browser.value("document.querySelector('.sectors').getBoundingClientRect().height") == 0
        rows = "[...document.querySelectorAll('.row')]"
        assert browser.value(f"{rows}.every((row) => row.querySelector('p').clientWidth > 0.95 * row.clientWidth)")


def test_obstacles_that_are_not_known_or_old_are_no_clear_sight(tmp_path: Path) -> None:
    none, ahead = np.zeros(72, bool), np.arange(72) < 7
    comes = ["nothing known"]

    def records(step: int) -> list[Record | Frame]:
        t_ns, rest = 1_000 * S + step * STEP_NS, without(ObstacleSectors, CorrectedRange)(step)
        (measured,) = (record for record in records_at(step) if isinstance(record, CorrectedRange))
        clear = ahead if comes[0] == "clear" else none
        sectors = ObstacleSectors(t_ns, np.full(72, 100.0), np.full(72, 0.5), none, clear, 1.0, 100.0)
        withheld = dataclasses.replace(measured, trusted=False, reject=Reject.STALE)
        return rest + {
            "nothing known": [measured, sectors], "clear": [measured, sectors], "too far": [withheld, sectors],
            "withheld": [withheld], "silent": [],
        }[comes[0]]  # fmt: skip

    word = "document.getElementById('sectors-word').textContent"
    is_old = "document.getElementById('obstacles').classList.contains('old')"
    with flying(tmp_path, records=records) as flown, Browser(*SIZES["phone"]) as browser:
        browser.open(flown.url)
        browser.until(f"{word} === 'nothing known'")
        comes[0] = "clear"
        browser.until(f"{word} === 'no obstacle in 7 sectors looked at'")
        for doubtful in ("withheld", "silent"):
            comes[0] = doubtful
            browser.until(is_old)
            assert text(browser, "#sectors-word").startswith("not known any more; last: no obstacle")
            comes[0] = "clear"
            browser.until(f"!{is_old}")
        comes[0] = "too far"
        browser.until(f"{word} === 'nothing known'")
        assert not browser.value(is_old), "a range that is withheld for itself takes no sectors with it"
        assert browser.complaints == []


def test_a_range_that_alone_is_trusted_is_drawn(tmp_path: Path) -> None:
    def lonely(step: int) -> list[Record | Frame]:
        return [
            dataclasses.replace(record, trusted=step % 40 == 5) if isinstance(record, CorrectedRange) else record
            for record in records_at(step)
        ]

    with flying(tmp_path, records=lonely) as flown, Browser(*SIZES["laptop"]) as browser:
        browser.open(flown.url)
        browser.until("document.querySelector('#range-chart .lone')?.getAttribute('d').match(/M/g)?.length > 1")
        labels = "[...document.querySelectorAll('#range-chart text')].map((label) => label.textContent)"
        assert browser.value(f"{labels}.includes('50 m')")
        browser.screenshot(tmp_path / "lone.png")
