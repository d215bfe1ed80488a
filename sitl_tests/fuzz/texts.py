"""Texts that a user writes: airframes, mappings, settings, layouts, and the names of cameras and triggers."""

from __future__ import annotations

import argparse
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from companion.adapters.cameras.camera_factory import camera_factory
from companion.adapters.mavlink.decode.source_map import build_mapping
from companion.adapters.recordings.tables.mapped_recording import MappedRecording
from companion.adapters.recordings.tables.mapping import parse_mapping
from companion.adapters.triggers.trigger_factory import trigger_factory
from companion.calibration.vibration import read_vibration_test
from companion.cli.steps.options import read_settings
from companion.core.pipeline import start
from companion.errors import SpanwiseError
from companion.params.files import dump_airframe, load_airframe, parse_airframe, shipped_airframes
from companion.params.learned import load_latency
from companion.params.settings import Settings, tunables
from companion.params.shipped import shipped
from sitl_tests.fuzz import corpora, mutators
from sitl_tests.fuzz.recordings import TEXT_MAPPING, ending, read_all
from sitl_tests.fuzz.target import LIMIT_S, Ending, Violation

_LAYOUT = b"""
rate_hz = 2000.0
band_hz = [4.0, 35.5]
force = { column = 1, newton_per_volt = 9.4967 }
accelerometers = { columns = [2, 3], mps2_per_volt = 9.5396 }
[[points]]
number = 1
span_m = 0.454
aft_m = 0.483
edge = "leading"
[[points]]
number = 2
span_m = -0.454
aft_m = 0.483
edge = "leading"
[[runs]]
file = "a.mat"
points = [1, 2]
"""
_LATENCY = b"""
path = "gpio oak"
shots = 40
left_s = { value = 0.008, sigma = 0.001 }
right_s = { value = 0.008, sigma = 0.001 }
"""
_SPELLINGS = (
    b"oak:CAM_B,CAM_C", b"oak:1844/CAM_A,19443/CAM_A", b"v4l2:/dev/video0,/dev/video2", b"v4l2:0,1", b"folder:here",
    b"video:l.avi,r.avi", b"recording:a.mcap", b"none", b"mavlink", b"mavlink:relay,0", b"mavlink:servo,9,1900",
    b"serial:/dev/ttyACM0,115200", b"gpio:/dev/gpiochip0,17,low", b"oak", b"oak:41,38", b"RNG_MIN=4", b"MODE_SIGMA=0.1",
)  # fmt: skip


def _airframes() -> list[bytes]:
    folder = shipped("airframes")
    return [(folder / f"{name}.toml").read_bytes() for name in shipped_airframes()]


def _mappings() -> list[bytes]:
    folder = shipped("mappings")
    named = [entry.read_bytes() for entry in folder.iterdir() if entry.name.endswith(".toml")]
    return [*named, *[TEXT_MAPPING.encode()] * len(named)]


def _settings() -> list[bytes]:
    return ["".join(f"{row.name} = {row.default!r}\n" for row in tunables()).encode()]


class TextTarget:
    """A text of one kind, damaged and used."""

    limit_s = LIMIT_S

    def __init__(self, name: str, corpus: Callable[[], list[bytes]], use: Callable[[str, Path], None]) -> None:
        self.name, self._corpus, self._use = name, corpus, use
        self.counts: Counter[str] = Counter()

    def warm(self) -> None:
        for data in self._corpus():
            self.run(data)

    def case(self, rng: np.random.Generator) -> bytes:
        files = self._corpus()
        return mutators.mutate(files[int(rng.integers(len(files)))], rng, mutators.TEXT, 3)

    def run(self, data: bytes) -> Ending:
        folder = Path(tempfile.mkdtemp(prefix="spanwise-fuzz-"))
        try:
            (folder / "a.toml").write_bytes(data)
            return ending(lambda: self._use(str(folder / "a.toml"), folder))
        finally:
            shutil.rmtree(folder)


def _use_airframe(path: str, folder: Path) -> None:
    airframe = load_airframe(path)
    build_mapping(airframe)
    if parse_airframe(dump_airframe(airframe), "again") != airframe:
        raise Violation("an airframe that does not come back from TOML")
    start(airframe, Settings())


def _use_mapping(path: str, folder: Path) -> None:
    mapping = parse_mapping(_text(path), "lab.toml")
    (folder / "a.txt").write_bytes(corpora.text_tables()[0])
    read_all(MappedRecording(folder / "a.txt", mapping, load_airframe("nadir-2m")))


def _use_settings(path: str, folder: Path) -> None:
    options: dict[str, Any] = {"settings": Path(path), "changes": [], "parameters": Path(path)}
    read_settings(argparse.Namespace(**options))


def _use_layout(path: str, folder: Path) -> None:
    (folder / "a.mat").write_bytes(b"")
    read_vibration_test(
        Path(path), folder, lambda file: {"signalIn": np.random.default_rng(1).standard_normal((4000, 4))}
    )


def _use_latency(path: str, folder: Path) -> None:
    load_latency(Path(path))


def _use_spelling(path: str, folder: Path) -> None:
    word = Path(path).read_bytes().decode("utf-8", "surrogateescape").replace("\n", " ")
    refusals = 0
    for use in (
        lambda: camera_factory(word, load_airframe("nadir-2m"), triggered=True),
        lambda: trigger_factory(word),
        lambda: read_settings(argparse.Namespace(settings=None, changes=[word], parameters=None)),
    ):
        try:
            use()
        except SpanwiseError as error:
            refusals += 1
            last = error
    if refusals == 3:
        raise last


def _text(path: str) -> str:
    return Path(path).read_bytes().decode("utf-8", "replace")


TEXTS: dict[str, Callable[[], TextTarget]] = {
    "airframe": lambda: TextTarget("airframe", _airframes, _use_airframe),
    "mapping": lambda: TextTarget("mapping", _mappings, _use_mapping),
    "settings": lambda: TextTarget("settings", _settings, _use_settings),
    "layout": lambda: TextTarget("layout", lambda: [_LAYOUT], _use_layout),
    "latency": lambda: TextTarget("latency", lambda: [_LATENCY], _use_latency),
    "spelling": lambda: TextTarget("spelling", lambda: list(_SPELLINGS), _use_spelling),
}
