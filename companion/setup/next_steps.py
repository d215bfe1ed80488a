"""From the installed service to the first range: one line each, with the command that is typed."""

from __future__ import annotations

from dataclasses import dataclass

from companion.setup.choices import Choices

_AIRFRAME = "my-wing.toml"
_CALIBRATED = "out/calibrate"
_MISSION_LINK = "udpin:127.0.0.1:14540"  # convention: as the set-up writes it for the router
_MISSION_RADIO = "/dev/ttyUSB0,57600"  # chosen: a telemetry radio, for without a router the service has the only link


@dataclass(frozen=True, slots=True)
class NextStep:
    """A purpose and the command for it."""

    purpose: str
    command: str


def next_steps(choices: Choices, *, here: bool, restart: bool) -> list[NextStep]:
    """In their order; ``here``: the tree is this machine's; ``restart``: files of the boot partition were changed."""
    calibrated = f"{_CALIBRATED}/airframe.toml"  # as calibrate writes it, and identify once more
    links = " ".join(f"--connect {link}" for link in choices.listening)
    cameras, trigger = choices.cameras or "oak:CAM_B,CAM_C", choices.trigger or "serial:/dev/spanwise-trigger"
    reload = (
        "sudo systemctl daemon-reload && sudo udevadm control --reload && sudo udevadm trigger && "
        "sudo sysctl -q --system"
    )
    eyes = f"--cameras {cameras} --trigger {trigger}"
    system = [NextStep("the system reads the new files", reload)] if here else []
    if restart and here:
        system.append(NextStep("the UART is freed at the next start", "sudo reboot"))
    mission = _MISSION_LINK if choices.router else _MISSION_RADIO
    router = "sudo systemctl enable mavlink-router; sudo systemctl restart mavlink-router"
    if choices.router:
        system.append(NextStep("the router shares the autopilot out", router))
    steps = [
        *system,
        NextStep("first airframe file", f"spanwise new-airframe --out {_AIRFRAME}"),
        NextStep("nodes, rates and clocks: nothing left to fix", f"spanwise doctor {links} --airframe {_AIRFRAME}"),
        NextStep(
            "nodes, axes, signs and modes, by tapping, tilting and plucking: all pass",
            f"spanwise setup wing {links} --airframe {_AIRFRAME}",
        ),
        NextStep(
            "both lenses and the rotation between them",
            f"spanwise calibrate stereo --cameras {cameras} --squares 7 5 --square-m 0.3 --airframe {_AIRFRAME}",
        ),
        NextStep(
            "slopes and twists, where a vibration test was made: modes with their spread",
            f"spanwise identify gvt gvt/ --layout layout.toml --airframe {calibrated} --out {_CALIBRATED}",
        ),
    ]
    if "/" in choices.airframe:
        steps.append(NextStep("where the service finds it", f"sudo install -D -m 644 {calibrated} {choices.airframe}"))
    return [
        *steps,
        NextStep("first range: published, with its sigma", f"spanwise run {links} --airframe {calibrated} {eyes}"),
        NextStep(
            "the service, and its state in words", "sudo systemctl enable --now spanwise; systemctl status spanwise"
        ),
        NextStep(
            "trim flight, from a checkout of Spanwise (no wheel has missions): the bend of level flight; of a pair "
            "that looks ahead the toe, with --mark LAT,LON for --ground 0",
            f"python -m mission_scripts.calibrate_target --connect {mission} --airframe {choices.airframe} --ground 0",
        ),
    ]
