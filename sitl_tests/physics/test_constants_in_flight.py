"""The constants that a flight teaches, in calm and in strong gusts: as far off as their sigmas say.

``python -m tools.bench world`` judges them over hundreds of flights.
"""

from __future__ import annotations

import dataclasses

import pytest

from companion.core.pipeline import start, step
from companion.params.airframe import Uncertain
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Tick
from companion.sim.flight.aircraft import FlightPlan
from companion.sim.flight.flight import build_flight
from companion.sim.flight.gust import GustKind
from companion.sim.flight.offline import HOST_EPOCH_NS
from tools.bench.apply import two_minutes
from tools.bench.slow import in_order
from tools.bench.world_constants import constants
from tools.bench.world_flight import fly
from tools.bench.world_rows import CampaignRow

pytestmark = pytest.mark.slow

CALM, STRONG = 203, 214  # flights whose gusts bend the tips by 3 and by 22 mm rms
WHITE = 9  # flight whose white gust bends them by 2 mm
STILL = 2, 4  # flights whose gusts bend by 2.5 and 8 mm rms the tips of an aircraft that itself does not move
LIGHTLY_DAMPED = 417  # flight whose second mode, damped to 0.6 %, moves beside a first one of 13 mm rms
TIPS = tuple(f"{tip}.{error}" for tip in ("left", "right") for error in ("kz", "mx", "mz"))
A_FEW_CLIPPED, MANY_CLIPPED = 731, 718  # flights in `rough` whose tips reach 16 g in 0.2 and 17 % of their samples
JUDGED = ("trim", "bend_per_g", "slope.symmetric", *TIPS)


@pytest.mark.parametrize(
    ("number", "sensors"),
    [
        pytest.param(CALM, "vertical", marks=pytest.mark.long),
        (STRONG, "6-axis"),
        pytest.param(CALM, "6-axis", marks=pytest.mark.long),
        pytest.param(STRONG, "vertical", marks=pytest.mark.long),
    ],
)
def test_what_a_flight_teaches_of_its_constants_is_within_its_sigmas(number: int, sensors: str) -> None:
    """Four sigmas; an error that was regressed on itself or a row that ignored its scale gave 5 to 12."""
    judged = fly(CampaignRow("ideal", "nadir-2m", sensors), number)["constants"]
    assert {"trim", "bend_per_g", "left.kz"} <= judged.keys()
    over = {name: (judged[name][0] - judged[name][2]) / judged[name][1] for name in JUDGED if name in judged}
    assert max(abs(value) for value in over.values()) < 4.0, over


def test_a_white_gust_is_no_misalignment_of_the_tips() -> None:
    """Five sigmas; the second mode's share of each step's load, left to the first, gave 16 of trim and 8 of ``mx``."""
    row = CampaignRow("ideal", "nadir-2m", "6-axis")
    flight = build_flight(row.belief(), row.seed(WHITE), plan=row.plan(), gust=GustKind.WHITE)
    state = start(flight.airframe, Settings())
    for record in in_order(flight, []):
        state, _ = step(state, record)
        if isinstance(record, Tick) and record.now_host_ns >= HOST_EPOCH_NS + 16_000_000_000:
            break
    judged = constants(state.tracker, flight.airframe, flight.real)
    over = {name: (estimate - true) / sigma for name, (estimate, sigma, true) in judged.items() if sigma > 0.0}
    assert max(abs(value) for name, value in over.items() if name in (*JUDGED, "shortening")) < 5.0, over


@pytest.mark.parametrize("number", STILL)
def test_a_body_that_does_not_move_teaches_no_trim(number: int) -> None:
    """Four sigmas; noise of the estimated roll acceleration in the derivatives gave 19 of the trim and 5 of ``mx``.

    No load factor tells a lateral bias from a lift here, and 41 mm of trim move the tip inboard as much as it tilts.
    Linearised at misalignments that were not yet known, the second flight gave 6 of ``mx``.
    """
    row = CampaignRow("ideal", "nadir-2m", "6-axis")
    airframe = row.belief()
    trimmed = dataclasses.replace(airframe.wing, trim_bend_m=Uncertain(0.041, 0.0041))
    airframe = dataclasses.replace(airframe, wing=trimmed)
    level = FlightPlan(26.0, heave_wobble_mps2=0.0, roll_wobble_rad=0.0, pitch_wobble_rad=0.0, yaw_wobble_rad=0.0)
    flight = build_flight(airframe, row.seed(number), plan=level)
    state = start(flight.airframe, Settings())
    for record in in_order(flight, []):
        state, _ = step(state, record)
    judged = constants(state.tracker, flight.airframe, flight.real)
    over = {name: (judged[name][0] - judged[name][2]) / judged[name][1] for name in ("trim", "left.mx", "right.mx")}
    assert judged["trim"][1] > 0.0003, judged["trim"]
    assert max(abs(value) for value in over.values()) < 4.0, over


def test_a_lightly_damped_second_mode_in_strong_gusts_is_no_propeller() -> None:
    """Twice its frequency, steady for two seconds, was followed as a shaft from 35 s on, the mode as its half order."""
    airframe = load_airframe("nadir-2m")
    flight = build_flight(airframe, LIGHTLY_DAMPED, plan=dataclasses.replace(two_minutes(), duration_s=40.0))
    state, distrusted = start(flight.airframe, Settings()), 0
    for record in in_order(flight, []):
        state, _ = step(state, record)
        if isinstance(record, Tick) and record.now_host_ns > HOST_EPOCH_NS + 15_000_000_000:
            distrusted += state.tracker.distrust is not None
    assert distrusted == 0


@pytest.mark.parametrize(
    ("number", "sensors"),
    [
        pytest.param(A_FEW_CLIPPED, "vertical", marks=pytest.mark.long),
        (MANY_CLIPPED, "6-axis"),
        pytest.param(MANY_CLIPPED, "vertical", marks=pytest.mark.long),
    ],
)
def test_what_clipped_accelerometers_teach_is_within_its_sigmas_and_no_range_is_wrong(
    number: int, sensors: str
) -> None:
    """Four sigmas; without the clipped peaks the damping was 8 to 15 off, a misalignment 25, and seven ranges wrong.

    With the slow force that clipping leaves in the spectral fit the damping was 6.5 off.
    """
    flown = fly(CampaignRow("rough", "nadir-2m", sensors), number)
    judged = flown["constants"]
    names = [name for name in judged if name.startswith(("frequency", "damping")) or name.endswith("mz")]
    over = {name: (judged[name][0] - judged[name][2]) / judged[name][1] for name in names}
    assert max(abs(value) for value in over.values()) < 4.0, over
    true_m, range_m, sigma_m, trusted = (
        [shot[flown["columns"].index(name)] for shot in flown["judged"]]
        for name in ("true_m", "range_m", "sigma_m", "trusted")
    )
    off = [
        abs(read - true) > max(5.0 * sigma, 0.05 * true)
        for true, read, sigma, published in zip(true_m, range_m, sigma_m, trusted, strict=True)
        if published
    ]
    assert len(off) > 100
    assert not any(off)
