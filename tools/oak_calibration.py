"""A stereo calibration from an OAK device (or its JSON file) into an airframe file, or from an airframe into JSON.

    python -m tools.oak_calibration read device.json --airframe nadir-2m --out out/airframe.toml
    python -m tools.oak_calibration read --airframe nadir-2m --out out/airframe.toml
    python -m tools.oak_calibration write out/device.json --airframe out/airframe.toml

Without a file the connected device is read. What is written is not flashed: ``dai.Device.flashCalibration`` does that.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from pathlib import Path

from companion.adapters.cameras.oak import library
from companion.adapters.cameras.oak_calibration import cameras_from_handler, cameras_to_handler, handler_of
from companion.errors import DeviceError, SpanwiseError
from companion.params.airframe import Airframe
from companion.params.files import dump_airframe, load_airframe, parse_airframe


def read(file: Path | None, airframe: Airframe, sockets: tuple[str, str]) -> Airframe:
    """The airframe with the lenses and the relative pose of a calibration."""
    pair = airframe.camera_pair
    if file is not None:
        handler = handler_of(file)
    else:
        try:
            handler = library().Device().readCalibration()
        except RuntimeError as error:
            raise DeviceError(f"DepthAI camera: {error}") from error
    left, right = cameras_from_handler(handler, sockets, *pair)
    return dataclasses.replace(airframe, left_camera=left, right_camera=right)


def write(file: Path, airframe: Airframe, sockets: tuple[str, str]) -> None:
    """Write an airframe's pair as a DepthAI calibration file."""
    pair = airframe.camera_pair
    handler = library().CalibrationHandler()
    cameras_to_handler(handler, sockets, *pair)
    # eepromToJsonFile says nothing where it cannot write
    _put(file, json.dumps(handler.eepromToJson(), indent=4))


def _put(file: Path, text: str) -> None:
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise DeviceError(f"{file}: cannot be written: {error.strerror}") from error


def main(arguments: list[str] | None = None) -> int:
    """Run the program; 2 where something is wrong, with one sentence."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("read", "write"))
    parser.add_argument("file", type=Path, nargs="?", help="JSON file of a device")
    parser.add_argument("--airframe", required=True, metavar="NAME")
    parser.add_argument("--sockets", nargs=2, default=("CAM_B", "CAM_C"), metavar="SOCKET", help="left and right")
    parser.add_argument("--out", type=Path, default=Path("out/airframe.toml"), metavar="FILE")
    options = parser.parse_args(arguments)
    left, right = options.sockets
    try:
        if left == right:
            raise DeviceError(f"--sockets {left} {right}: name two")
        airframe = load_airframe(options.airframe)
        if options.what == "write":
            if options.file is None:
                parser.error("write needs a file")
            write(options.file, airframe, (left, right))
            print(f"wrote {options.file}")
        else:
            calibrated = read(options.file, airframe, (left, right))
            text = dump_airframe(calibrated)
            parse_airframe(text, f"{options.sockets[0]} as left, {options.sockets[1]} as right")
            _put(options.out, text)
            print(f"wrote {options.out}")
    except SpanwiseError as error:
        print(f"oak_calibration: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
