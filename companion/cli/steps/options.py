"""Options that several commands share."""

from __future__ import annotations

import argparse
import contextlib
import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from companion.adapters.recordings.recording import Recording
from companion.adapters.recordings.recording_factory import open_recording
from companion.cli.terminal.progress import say
from companion.errors import ConfigError
from companion.params.files import load_airframe
from companion.params.persist import load_stored
from companion.params.settings import Settings
from companion.params.toml import read_toml, settings_of

_RESULTS = (".html", ".json", ".mcap", ".toml")  # never tables of a laboratory's folder (convention)


def add_settings(parser: argparse.ArgumentParser) -> None:
    """``--settings FILE`` and ``--set NAME=VALUE``."""
    parser.add_argument("--settings", type=Path, metavar="FILE", help="TOML file of NAME = value lines (see params)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", dest="changes", help="one setting; may be repeated"
    )


def add_recording(
    parser: argparse.ArgumentParser, text: str = ".mcap, .tlog, .BIN, .ulg, or a folder with accel.csv"
) -> None:
    """``recording`` and ``--airframe NAME``."""
    parser.add_argument("recording", type=Path, help=text)
    parser.add_argument("--airframe", metavar="NAME", help="needed for logs that are not our own; see config/airframes")


def open_given(options: argparse.Namespace) -> Recording:
    """Open the recording that the options of :func:`add_recording` name."""
    return open_recording(options.recording, load_airframe(options.airframe) if options.airframe else None)


def read_settings(options: argparse.Namespace, flown: Settings | None = None) -> Settings:
    """The settings in force: defaults, the file, what a ground station has set, the command line; the last one wins.

    With a recording, the settings ``flown`` stand in the place of the defaults, unless a file is given.
    """
    if flown is not None and options.settings is None and not options.changes:
        return flown  # whatever an earlier version took
    base = Settings() if flown is None or options.settings is not None else flown
    settings = base.with_values(_from_file(options.settings))
    clash = settings.conflict()
    if clash is not None and options.settings is not None:
        raise ConfigError(f"{options.settings}: {clash.text}")
    settings = _stored(getattr(options, "parameters", None), settings)
    for change in options.changes:
        settings = settings.replace(*named_value("--set", change))
    clash = settings.conflict()
    if clash is not None:
        raise ConfigError(f"{clash.text}: change one of them (--set, --settings)")
    return settings


def named_value(option: str, text: str) -> tuple[str, float]:
    """Name and value of a setting that ``option`` gives as NAME=VALUE; raise :class:`ConfigError` for another text."""
    name, equals, value = text.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError as error:
        what = "give NAME=VALUE with a number" if equals else "give NAME=VALUE"
        raise ConfigError(f"{option} {text}: {what}") from error


def _stored(path: Path | None, settings: Settings) -> Settings:
    """Put in what was kept of a ground station's changes; what is damaged there is told and not used."""
    if path is None:
        return settings
    stored = load_stored(path)
    for problem in stored.problems:
        say(problem)
    values, problems = settings.agreeing(stored.values)
    for problem in problems:
        say(f"{path}: {problem}")
    if values:
        listed = ", ".join(f"{name} {value:g}" for name, value in sorted(values.items()))
        say(f"set from a ground station: {listed} (kept in {path})")
    return settings.with_values(values)


def check_output(path: Path | None, option: str, inputs: Sequence[Path] = ()) -> None:
    """Refuse a file that cannot be written, or is read, before the work whose result it is to hold.

    Raises
    ------
    ConfigError
        Its folder is missing or not writable, it is a folder itself, or one of ``inputs`` or a table in one.
    """
    if path is None or str(path) == "-":
        return
    read = (path,) if path.suffix.lower() in _RESULTS else (path, path.parent)
    if path.exists() and any(entry.exists() and entry.samefile(each) for entry in inputs for each in read):
        raise ConfigError(f"{option} {path}: is what is read, and would be overwritten; name another file")
    if path.is_dir():
        raise ConfigError(f"{option} {path}: is a folder; name a file")
    if not path.parent.is_dir():
        raise ConfigError(f"{option} {path}: no folder {path.parent}")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise ConfigError(f"{option} {path}: cannot be written (permission denied)")


def check_ending(path: Path | None, option: str, ending: str) -> None:
    """Refuse a file whose name says that it holds something else; ``-`` and devices have no ending."""
    if path is not None and path.suffix.lower() not in ("", ending):
        raise ConfigError(f"{option} {path}: what is written there ends in {ending}")


def check_new(path: Path | None, option: str) -> None:
    """Refuse a file that exists: whatever was measured or written into it would be lost. Devices are no files."""
    if path is not None and path.is_file():
        raise ConfigError(f"{option} {path}: exists already, and would be lost; name a new file")


def check_earlier(path: Path, airframe: str | None) -> None:
    """Refuse to write over an earlier result that this one, which starts from ``airframe``, does not go on from."""
    base = Path(airframe or "")
    if path.exists() and not (base.exists() and base.samefile(path)):
        raise ConfigError(
            f"{path}: exists already, and what was measured for it would be lost; "
            f"give --airframe {path} to go on from it, or name another folder (--out)"
        )


def make_folder(path: Path, option: str = "--out") -> None:
    """Make the folder that results go into.

    Raises
    ------
    ConfigError
        It cannot be made or written.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{option} {path}: cannot be made: {error.strerror}") from error
    if not os.access(path, os.W_OK):
        raise ConfigError(f"{option} {path}: cannot be written (permission denied)")


@contextlib.contextmanager
def result_folder(path: Path, option: str = "--out") -> Iterator[None]:
    """As :func:`make_folder`; what was made here and stayed empty goes away again."""
    made = [folder for folder in (path, *path.parents) if not folder.exists()]
    make_folder(path, option)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):  # one that holds something stays, and so do those around it
            for folder in made:
                folder.rmdir()


def state_file(name: str) -> Path:
    """Where a file that outlives a run belongs: by the XDG rules, or as systemd says.

    A user without a home gets a temporary folder: what is set is kept over restarts of a process, not over runs.
    """
    if state := os.environ.get("XDG_STATE_HOME"):
        return Path(state) / "spanwise" / name
    if state := os.environ.get("STATE_DIRECTORY"):
        return Path(state.split(":")[0]) / name
    try:
        return Path.home() / ".local" / "state" / "spanwise" / name
    except RuntimeError:
        return Path(tempfile.mkdtemp(prefix="spanwise-")) / name


def _from_file(path: Path | None) -> dict[str, float]:
    if path is None:
        return {}
    return settings_of(read_toml(path), str(path))
