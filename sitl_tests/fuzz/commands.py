"""The commands that read a recording from end to end, ``replay`` and ``doctor --log``, fed with damaged recordings."""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from companion.cli import doctor, replay
from companion.cli.main import build_parser
from companion.records import Reject
from sitl_tests.fuzz import corpora, mutators
from sitl_tests.fuzz.mutators import Mutator
from sitl_tests.fuzz.recordings import BIN_WAYS, MCAP_WAYS, TLOG_WAYS, ULOG_WAYS, ending
from sitl_tests.fuzz.target import Ending, Violation


@dataclass(frozen=True, slots=True)
class _Format:
    """Recordings of one format: the file's suffix, valid ones, what damages them, and the airframe they need."""

    suffix: str
    corpus: corpora.Corpus
    ways: Sequence[Mutator]
    airframe: str | None = None


_EXECUTE: dict[str, Callable[[argparse.Namespace], int]] = {"replay": replay.execute, "doctor": doctor.execute}
_FORMATS = (
    _Format(".mcap", corpora.flown_mcaps, MCAP_WAYS),
    _Format(".tlog", corpora.tlogs, TLOG_WAYS, "sitl-plane"),
    _Format(".BIN", corpora.bins, BIN_WAYS, "sitl-plane"),
    _Format(".ulg", corpora.ulogs, ULOG_WAYS, "sitl-plane"),
)
_SHARES = (0.55, 0.15, 0.15, 0.15)


class CommandTarget:
    """A command over a damaged recording; it prints JSON, or raises one sentence, and contains no defect.

    Parameters
    ----------
    name : str
        Of the target.
    arguments : callable
        From the recording's path and the airframe that its format needs to the words of the command line.
    """

    limit_s = 40.0  # of estimation and analysis; the flights last 12 s

    def __init__(self, name: str, arguments: Callable[[Path, str | None], list[str]]) -> None:
        self.name, self._arguments = name, arguments
        self.counts: Counter[str] = Counter()

    def warm(self) -> None:
        for number, form in enumerate(_FORMATS):
            self.run(bytes([number]) + form.corpus()[0])

    def case(self, rng: np.random.Generator) -> bytes:
        number = int(rng.choice(len(_FORMATS), p=_SHARES))
        files = _FORMATS[number].corpus()
        data = files[int(rng.integers(len(files)))]
        return bytes([number]) + mutators.mutate(data, rng, _FORMATS[number].ways)

    def run(self, data: bytes) -> Ending:
        form = _FORMATS[data[0] % len(_FORMATS)]
        folder = Path(tempfile.mkdtemp(prefix="spanwise-fuzz-"))
        try:
            path = folder / f"a{form.suffix}"
            path.write_bytes(data[1:])
            return ending(lambda: self._use(self._arguments(path, form.airframe)))
        finally:
            shutil.rmtree(folder)

    def _use(self, words: list[str]) -> None:
        printed, said = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(said):
            code = _EXECUTE[words[0]](build_parser(words[0]).parse_args(words))
        self.counts[f"ended with code {code}"] += 1
        result = json.loads(printed.getvalue(), parse_constant=_not_json)
        rejected: dict[str, int] = result.get("rejected", {}) if isinstance(result, dict) else {}
        if str(Reject.INTERNAL_ERROR) in rejected:
            raise Violation(f"contained: {rejected}, {result.get('notices')}"[:1500])


def _not_json(word: str) -> Any:
    raise Violation(f"{word} is no JSON")


def _replay(path: Path, airframe: str | None) -> list[str]:
    return ["replay", str(path), "--json", *(["--airframe", airframe] if airframe else [])]


def _doctor(path: Path, airframe: str | None) -> list[str]:
    return ["doctor", "--log", str(path), "--json", "--airframe", airframe or "nadir-2m"]


COMMANDS: dict[str, Callable[[], CommandTarget]] = {
    "replay": lambda: CommandTarget("replay", _replay),
    "doctor": lambda: CommandTarget("doctor", _doctor),
}
