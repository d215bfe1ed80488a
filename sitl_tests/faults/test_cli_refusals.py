"""Every command with every bad input that it can get: one sentence and the exit code that the README lists."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from companion.cli.main import _COMMANDS, main
from sitl_tests.ports import free_port

BAD, USAGE, STOPPED = 1, 2, 130
RUN = ("run", "--airframe", "nadir-2m", "--connect", "udpin:127.0.0.1:0", "--for", "1")
DOCTOR = ("doctor", "--airframe", "nadir-2m", "--for", "1")
STEREO = ("calibrate", "stereo", "--airframe", "nadir-2m", "--square-m", "0.03")
LATENCY = ("calibrate", "latency", "--airframe", "nadir-2m")
NEW = ("new-airframe", "--semispan-m", "1", "--frequency-hz", "5", "--mass-kg", "3", "--focal-px", "800", "--defaults")

# words (with {tmp} for a folder, {missing} for what is not there, {file} for a file, {log} for one of noise), exit code
CASES: list[tuple[tuple[str, ...], int]] = [
    ((), USAGE),
    (("nonsense",), USAGE),
    *[((command, "--nonsense"), USAGE) for command in _COMMANDS],
    # run
    ((*RUN, "--for", "-1"), USAGE),
    ((*RUN, "--for", "nan"), USAGE),
    (("run", "--airframe", "nadir-2m"), USAGE),
    ((*RUN, "--airframe", "no-such"), BAD),
    ((*RUN, "--airframe", "{missing}.toml"), BAD),
    ((*RUN, "--airframe", "{tmp}"), BAD),
    ((*RUN, "--connect", "nonsense"), BAD),
    ((*RUN, "--connect", "udpin:127.0.0.1:99999"), BAD),
    ((*RUN, "--record", "{missing}/a.mcap"), BAD),
    ((*RUN, "--cameras", "nonsense"), BAD),
    ((*RUN, "--cameras", "folder:{missing}"), BAD),
    ((*RUN, "--cameras", "recording:{missing}"), BAD),
    ((*RUN, "--cameras", "video:{missing},{missing}"), BAD),
    ((*RUN, "--trigger", "nonsense"), BAD),
    ((*RUN, "--trigger", "serial:{missing}"), BAD),
    ((*RUN, "--trigger", "gpio:{missing},3"), BAD),
    ((*RUN, "--settings", "{missing}"), BAD),
    ((*RUN, "--settings", "{log}"), BAD),
    ((*RUN, "--set", "RNG_MIN"), BAD),
    ((*RUN, "--set", "RNG_MIN=nan"), BAD),
    ((*RUN, "--sign-key", "{missing}"), BAD),
    # demo, simulate, vehicle
    (("demo", "--duration", "-1"), USAGE),
    (("demo", "--duration", "inf"), USAGE),
    (("demo", "--seed", "-1"), USAGE),
    (("demo", "--airframe", "sitl-plane"), BAD),
    (("demo", "--out", "{file}"), BAD),
    (("simulate", "--out", "{file}"), BAD),
    (("simulate", "--out", "{file}/below"), BAD),
    (("simulate", "--out", "{tmp}", "--duration", "0"), USAGE),
    (("simulate", "--out", "{tmp}", "--seed", "9" * 30), USAGE),
    (("simulate", "--out", "{tmp}", "--effect", "nonsense"), BAD),
    (("simulate", "--out", "{tmp}", "--effect", "frequency-shift=-5"), BAD),
    (("simulate", "--out", "{tmp}", "--effect", "quantisation=-1"), BAD),
    (("simulate", "--out", "{tmp}", "--effect", "freeplay=-0.001"), BAD),
    (("simulate",), USAGE),
    (("vehicle", "--duration", "-5"), USAGE),
    (("vehicle", "--connect", "nonsense"), BAD),
    # replay
    (("replay", "{missing}"), BAD),
    (("replay", "{tmp}"), BAD),
    (("replay", "{log}"), BAD),
    (("replay", "{log}", "--airframe", "no-such"), BAD),
    (("replay", "{table}", "--airframe", "nadir-2m", "--out", "{missing}/a.mcap"), BAD),
    (("replay", "{table}", "--airframe", "nadir-2m", "--out", "{tmp}"), BAD),
    (("replay", "{table}", "--airframe", "nadir-2m", "--out", "/dev/full"), BAD),
    # paper
    (("paper", "--jobs", "0"), USAGE),
    (("paper", "--out", "{file}"), BAD),
    (("paper", "--json", "{missing}/a.json"), BAD),
    # doctor
    ((*DOCTOR,), USAGE),
    ((*DOCTOR, "--connect", "nonsense"), BAD),
    ((*DOCTOR, "--connect", "{missing}"), BAD),
    ((*DOCTOR, "--connect", "udpin:127.0.0.1:{taken}"), BAD),
    ((*DOCTOR, "--connect", "udpin:127.0.0.1:{free}", "--connect", "udpin:127.0.0.1:{free}"), BAD),
    ((*DOCTOR, "--connect", "tcpin:127.0.0.1:{free}", "--connect", "tcpin:127.0.0.1:{free}"), BAD),
    ((*DOCTOR, "--log", "{missing}"), BAD),
    ((*DOCTOR, "--log", "{log}"), BAD),
    ((*DOCTOR, "--log", "{log}", "--for", "-1"), USAGE),
    # diagnose
    (("diagnose",), USAGE),
    (("diagnose", "{missing}", "--airframe", "nadir-2m"), BAD),
    (("diagnose", "{table}", "--airframe", "nadir-2m", "--max-causes", "-1"), USAGE),
    (("diagnose", "{table}", "--airframe", "nadir-2m", "--json", "{missing}/a.json"), BAD),
    (("diagnose", "{table}", "--airframe", "nadir-2m", "--html", "{missing}/a.html"), BAD),
    (("diagnose", "{table}", "--airframe", "nadir-2m", "--html", "{tmp}"), BAD),
    (("diagnose", "{table}", "--airframe", "nadir-2m", "--apply", "{missing}/a.toml"), BAD),
    (("diagnose", "{table}", "--mapping", "nonsense"), BAD),
    (("diagnose", "{table}", "--mapping", "{missing}.toml"), BAD),
    (("diagnose", "{table}", "--airframe", "nadir-2m", "--json", "/dev/full"), BAD),
    # calibrate, identify
    (STEREO, BAD),
    ((*STEREO, "{missing}"), BAD),
    ((*STEREO, "{tmp}"), BAD),
    ((*STEREO, "{tmp}", "--squares", "1", "1"), USAGE),
    ((*STEREO, "{tmp}", "--square-m", "0"), USAGE),
    ((*STEREO, "{tmp}", "--square-m", "nan"), USAGE),
    ((*STEREO, "{tmp}", "--out", "{file}"), BAD),
    ((*STEREO, "--cameras", "folder:{missing}"), BAD),
    ((*STEREO, "--cameras", "sim", "--views", "0"), USAGE),
    ((*STEREO, "--cameras", "sim", "--for", "-1"), USAGE),
    (("calibrate", "mounting", "{missing}", "--airframe", "nadir-2m", "--square-m", "0.03"), BAD),
    ((*LATENCY, "{missing}"), BAD),
    ((*LATENCY, "{log}"), BAD),
    (("identify", "flight", "{missing}"), BAD),
    (("identify", "flight", "{table}", "--band", "-1", "5"), USAGE),
    (("identify", "flight", "{table}", "--band", "9", "5"), BAD),
    (("identify", "flight", "{table}", "--out", "{file}"), BAD),
    (("identify", "gvt", "{tmp}", "--layout", "{missing}"), BAD),
    (("identify", "gvt", "{tmp}", "--layout", "{log}"), BAD),
    # new-airframe, params
    ((*NEW, "--out", "{missing}/a.toml"), BAD),
    ((*NEW, "--out", "{tmp}"), BAD),
    ((*NEW, "--out", "{tmp}/a.toml", "--semispan-m", "nan"), BAD),
    (("new-airframe", "--out", "{tmp}/a.toml"), BAD),
    (("params", "--xml", "{missing}/a.xml"), BAD),
    (("params", "--xml", "{tmp}"), BAD),
    (("params", "--xml", "/dev/full"), BAD),
]


@pytest.fixture
def taken_port() -> Iterator[int]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        yield holder.getsockname()[1]


@pytest.mark.parametrize(("words", "expected"), CASES, ids=[" ".join(words)[:90] or "nothing" for words, _ in CASES])
def test_a_bad_input_is_one_sentence(
    words: tuple[str, ...],
    expected: int,
    tmp_path: Path,
    taken_port: int,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("a file\n")
    (tmp_path / "a.BIN").write_bytes(bytes(range(256)) * 9)
    (tmp_path / "table").mkdir()
    rows = "".join(f"{i / 500},-9.81,-9.80\n" for i in range(600))
    (tmp_path / "table" / "accel.csv").write_text("t_s,left_z_mps2,right_z_mps2\n" + rows)
    places = {
        "{tmp}": "folder", "{missing}": "no-such", "{file}": "file", "{log}": "a.BIN", "{table}": "table",
    }  # fmt: skip
    free = free_port()
    numbers = {"{taken}": str(taken_port), "{free}": str(free)}
    arguments = [
        _filled(word, {mark: str(tmp_path / name) for mark, name in places.items()} | numbers) for word in words
    ]
    try:
        code = main(arguments)
    except SystemExit as left:  # argparse's own way
        code = left.code  # type: ignore[assignment]
    stderr = capfd.readouterr().err
    assert code == expected, stderr
    assert Path("/dev/full").is_char_device(), "a device that cannot be written is not removed"
    assert "Traceback" not in stderr
    assert stderr.strip(), "something is said"
    if expected == BAD:
        sentences = [line for line in stderr.strip().splitlines() if line.startswith("spanwise")]
        assert len(sentences) == 1, stderr
        left_empty = [path for path in tmp_path.rglob("*") if path.is_dir() and not any(path.iterdir())]
        assert left_empty == [tmp_path / "folder"], "a refused command leaves no folder behind"


BENCH = {
    "forced": ("input_n", "response_m"),
    "vibration": ("input_n", "response_tip_mps2"),
    "limit-cycle": ("response_tip_mps2", "response_root_mps2"),
}


@pytest.mark.parametrize("kind", BENCH)
@pytest.mark.parametrize(
    ("fault", "complaint"),
    [("one row", "has 1 row"), ("dead", "never changes"), ("milliseconds", "unit of the time column")],
)
def test_a_bench_file_that_shows_nothing_is_one_sentence(
    kind: str, fault: str, complaint: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    columns = "".join(
        f'[columns.{letter}]\nchannel = "{name}"\n' for letter, name in zip("ab", BENCH[kind], strict=True)
    )
    mapping = tmp_path / "bench.toml"
    mapping.write_text(f'test = "{kind}"\nband_hz = [2.0, 20.0]\n[columns.t]\nchannel = "t_s"\n{columns}')
    rows, step = (1 if fault == "one row" else 3000), (5.0 if fault == "milliseconds" else 0.005)
    lines = [f"{i * step},{0 if fault == 'dead' else i % 7},{i % 11}" for i in range(rows)]
    (tmp_path / "run.csv").write_text("\n".join(["t,a,b", *lines]) + "\n")
    assert main(["diagnose", str(tmp_path / "run.csv"), "--mapping", str(mapping)]) == BAD
    stderr = capfd.readouterr().err
    assert complaint in stderr
    assert [line for line in stderr.splitlines() if line.startswith("spanwise")] == stderr.strip().splitlines()[-1:]


def _filled(word: str, places: dict[str, str]) -> str:
    return re.sub("|".join(map(re.escape, places)), lambda match: places[match[0]], word)


def spanwise(arguments: str, tmp_path: Path, **more: object) -> subprocess.CompletedProcess[str]:
    command = f"{sys.executable} -c 'import sys; from companion.cli.main import main; sys.exit(main())' {arguments}"
    script = f"set -o pipefail; {command}"
    return subprocess.run(
        ["bash", "-c", script], capture_output=True, text=True, cwd=tmp_path, timeout=120, check=False, **more
    )  # type: ignore[call-overload, no-any-return]


@pytest.mark.slow
@pytest.mark.parametrize("arguments", ["params", "params --json", "simulate --help"])
def test_a_closed_pipe_is_no_traceback(arguments: str, tmp_path: Path) -> None:
    done = spanwise(f"{arguments} | head -c 1 >/dev/null", tmp_path)
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr
    assert done.returncode in (0, BAD), "0 where all went into the pipe before it closed"


@pytest.mark.slow
def test_a_full_disk_under_standard_output_is_told(tmp_path: Path) -> None:
    done = spanwise("params > /dev/full", tmp_path)
    assert done.returncode == BAD
    assert done.stderr == "spanwise params: No space left on device\n"


@pytest.mark.slow
def test_ctrl_c_ends_with_130(tmp_path: Path) -> None:
    command = [sys.executable, "-c", "import sys; from companion.cli.main import main; sys.exit(main())"]
    flying = subprocess.Popen(
        [*command, "simulate", "--out", "flight", "--duration", "3000"],
        cwd=tmp_path, stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # ignored behind a shell's &
    )  # fmt: skip
    try:
        with pytest.raises(subprocess.TimeoutExpired):
            flying.wait(4.0)
        flying.send_signal(signal.SIGINT)
        _, stderr = flying.communicate(timeout=30)
    finally:
        flying.kill()
    assert flying.returncode == STOPPED
    assert stderr == "spanwise simulate: stopped\n"
