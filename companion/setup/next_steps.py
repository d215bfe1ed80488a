"""From the installed service to the first range: one line each, with the command that is typed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from companion.setup.choices import Choices

_AIRFRAME = "my-wing.toml"
_OUT = "out/calibrate"
_CALIBRATED = f"{_OUT}/airframe.toml"  # as calibrate writes it, and identify once more
_MISSION_LINK = "udpin:127.0.0.1:14540"  # convention: as the set-up writes it for the router
_MISSION_RADIO = "/dev/ttyUSB0,57600"  # chosen: a telemetry radio, for without a router the service has the only link


@dataclass(frozen=True, slots=True)
class NextStep:
    """A purpose and the command for it."""

    purpose: str
    command: str


def next_steps(choices: Choices, *, here: bool, restart: bool) -> list[NextStep]:
    """In their order; ``here``: the tree is this machine's; ``restart``: files of the boot partition were changed."""
    return [*_system(choices, here=here, restart=restart), *_calibration(choices), *_flights(choices)]


def _system(choices: Choices, *, here: bool, restart: bool) -> Iterator[NextStep]:
    """The system takes up what was installed."""
    if here:
        reload = (
            "sudo systemctl daemon-reload && sudo udevadm control --reload && sudo udevadm trigger && "
            "sudo sysctl -q --system"
        )
        yield NextStep("the system reads the new files", reload)
    if restart and here:
        yield NextStep("the UART is freed at the next start", "sudo reboot")
    if choices.router:
        router = "sudo systemctl enable mavlink-router; sudo systemctl restart mavlink-router"
        yield NextStep("the router shares the autopilot out", router)


def _calibration(choices: Choices) -> Iterator[NextStep]:
    """From an airframe file to a calibrated one where the service looks for it."""
    yield NextStep("first airframe file", f"spanwise new-airframe --out {_AIRFRAME}")
    yield NextStep(
        "nodes, rates and clocks: nothing left to fix", f"spanwise doctor {_links(choices)} --airframe {_AIRFRAME}"
    )
    yield NextStep(
        "nodes, axes, signs and modes, by tapping, tilting and plucking: all pass",
        f"spanwise setup wing {_links(choices)} --airframe {_AIRFRAME}",
    )
    yield NextStep(
        "both lenses and the rotation between them",
        f"spanwise calibrate stereo --cameras {_cameras(choices)} --squares 7 5 --square-m 0.3 --airframe {_AIRFRAME}",
    )
    yield NextStep(
        "slopes and twists, where a vibration test was made: modes with their spread",
        f"spanwise identify gvt gvt/ --layout layout.toml --airframe {_CALIBRATED} --out {_OUT}",
    )
    if "/" in choices.airframe:
        yield NextStep("where the service finds it", f"sudo install -D -m 644 {_CALIBRATED} {choices.airframe}")


def _flights(choices: Choices) -> Iterator[NextStep]:
    """The first range, the service, and the flight that corrects the bend in trim."""
    eyes = f"--cameras {_cameras(choices)} --trigger {choices.trigger or 'serial:/dev/spanwise-trigger'}"
    yield NextStep(
        "first range: published, with its sigma", f"spanwise run {_links(choices)} --airframe {_CALIBRATED} {eyes}"
    )
    yield NextStep(
        "the service, and its state in words", "sudo systemctl enable --now spanwise; systemctl status spanwise"
    )
    mission = _MISSION_LINK if choices.router else _MISSION_RADIO
    yield NextStep(
        "trim flight, from a checkout of Spanwise (no wheel has missions): the bend of level flight; of a pair "
        "that looks ahead the toe, with --mark LAT,LON for --ground 0",
        f"python -m mission_scripts.calibrate_target --connect {mission} --airframe {choices.airframe} --ground 0",
    )


def _links(choices: Choices) -> str:
    return " ".join(f"--connect {link}" for link in choices.listening)


def _cameras(choices: Choices) -> str:
    return choices.cameras or "oak:CAM_B,CAM_C"
