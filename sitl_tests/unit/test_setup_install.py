"""``spanwise setup`` on fake boards: the files as they should be, nothing twice, nothing left after --undo."""

from __future__ import annotations

import configparser
import json
import os
import re
import shlex
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import companion
from companion.cli.main import build_parser, main
from companion.setup import install as installing
from companion.setup import tree as trees
from sitl_tests.unit.setup_boards import BOARDS, CMDLINE, CONFIG, WANTS, fake_board, snapshot, write

UNIT = "etc/systemd/system/spanwise.service"
DEFAULTS = "etc/default/spanwise"
BUFFERS = "etc/sysctl.d/80-spanwise.conf"
RULES = "etc/udev/rules.d/80-spanwise.rules"
ROUTER = "etc/mavlink-router/main.conf"
ROUTER_UNIT = "etc/systemd/system/mavlink-router.service.d/spanwise.conf"
MANIFEST = "var/lib/spanwise-setup/manifest.json"


def setup(root: Path, *options: str) -> int:
    return main(["setup", "--root", str(root), "--yes", *options])


@pytest.fixture(params=BOARDS)
def board(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[str, Path]:
    root = tmp_path / "root"
    root.mkdir()
    return request.param, fake_board(root, request.param)


@pytest.fixture
def pi5(tmp_path: Path) -> Path:
    root = tmp_path / "pi5"
    root.mkdir()
    return fake_board(root, "pi5")


def test_the_files_are_there_and_the_checks_show_their_figures(
    board: tuple[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    kind, root = board
    assert setup(root) == 0
    said = capsys.readouterr().out
    uart = {"pi4": "/dev/ttyAMA0", "pi5": "/dev/ttyAMA0", "jetson": "/dev/ttyTHS1", "plain": "/dev/ttyACM0"}[kind]
    figures = (
        f"UART {uart}",
        "8.4 GB (1.5 GB wanted)",
        "GB free (2 GB wanted)",
        "dialout, gpio, video, plugdev: all exist",
    )
    for figure in (*figures, "3.11 or newer"):
        assert figure in said
    assert "mend" not in said
    made = set(snapshot(root)) - {"var", "var/lib"}
    assert {UNIT, DEFAULTS, RULES, BUFFERS, MANIFEST} <= made
    assert ROUTER not in made
    assert (
        f'SPANWISE_LINKS="--connect {uart},921600 --connect /dev/spanwise-left,921600' in (root / DEFAULTS).read_text()
    )
    assert "SupplementaryGroups=dialout gpio video plugdev\n" in (root / UNIT).read_text()
    for name in (UNIT, DEFAULTS, RULES, BUFFERS):
        assert stat.S_IMODE((root / name).stat().st_mode) == 0o644
        assert "@BOARD@" not in (root / name).read_text()
    assert stat.S_IMODE((root / MANIFEST).stat().st_mode) == 0o600


def test_the_uart_is_freed(board: tuple[str, Path]) -> None:
    kind, root = board
    setup(root)
    if kind.startswith("pi"):
        config = (root / "boot/firmware/config.txt").read_text()
        assert config.startswith(CONFIG)
        added = config.removeprefix(CONFIG).splitlines()
        assert added[1:-1] == [
            "[all]",
            "enable_uart=1",
            {"pi4": "dtoverlay=disable-bt", "pi5": "dtparam=uart0=on"}[kind],
        ]
        words = (root / "boot/firmware/cmdline.txt").read_text()
        assert words == CMDLINE.replace("console=serial0,115200 ", "")
        assert stat.S_IMODE((root / "boot/firmware/cmdline.txt").stat().st_mode) == 0o755
    assert (root / WANTS / "hciuart.service").is_symlink() is (kind == "pi5")
    assert not (root / WANTS / "nvgetty.service").is_symlink()


def test_a_uart_that_no_link_uses_stays_as_it_is(pi5: Path) -> None:
    setup(pi5, "--link", "udpin:0.0.0.0:14550")
    assert (pi5 / "boot/firmware/config.txt").read_text() == CONFIG
    assert (pi5 / "boot/firmware/cmdline.txt").read_text() == CMDLINE
    setup(pi5, "--link", "/dev/ttyAMA0,921600")
    assert "enable_uart=1" in (pi5 / "boot/firmware/config.txt").read_text()
    setup(pi5, "--link", "udpin:0.0.0.0:14550")
    assert (pi5 / "boot/firmware/config.txt").read_text() == CONFIG, "what is needed no more is put back"


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("console=tty1 console=serial0,115200 rootwait\n", "console=tty1 rootwait\n"),
        ("rootwait console=ttyAMA0,115200n8\n", "rootwait \n"),
        ("console=tty1 netconsole=serial0 rootwait", "console=tty1 netconsole=serial0 rootwait"),
        ("console=serial0,9600 console=ttyS0 a=b", "a=b"),
    ],
)
def test_only_words_of_a_console_on_the_uart_leave_the_kernel_s_line(pi5: Path, before: str, after: str) -> None:
    path = write(pi5, "boot/firmware/cmdline.txt", before)
    setup(pi5)
    assert path.read_text() == after
    setup(pi5, "--undo")
    assert path.read_text() == before


def test_the_boot_files_of_an_older_system_are_found(tmp_path: Path) -> None:
    root = fake_board(tmp_path, "pi4")
    os.rename(root / "boot/firmware/config.txt", root / "boot/config.txt")
    os.rename(root / "boot/firmware/cmdline.txt", root / "boot/cmdline.txt")
    setup(root)
    assert "dtoverlay=disable-bt" in (root / "boot/config.txt").read_text()


def test_undo_leaves_the_tree_as_it_was(board: tuple[str, Path]) -> None:
    _, root = board
    before = snapshot(root)
    setup(root, "--router", "--cameras", "oak:CAM_B,CAM_C", "--trigger", "serial:/dev/spanwise-trigger")
    assert snapshot(root) != before
    assert setup(root, "--undo") == 0
    assert snapshot(root) == before


def test_undo_after_the_service_was_enabled_and_after_an_upgrade(board: tuple[str, Path]) -> None:
    _, root = board
    before = snapshot(root)
    setup(root)
    setup(root, "--cameras", "oak:CAM_B,CAM_C", "--serial-left", "AB01")
    (root / WANTS / "spanwise.service").symlink_to(f"/{UNIT}")
    setup(root, "--undo")
    assert snapshot(root) == before


def test_a_second_run_changes_nothing(board: tuple[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    _, root = board
    setup(root, "--router", "--airframe", "nadir-2m", "--serial-left", "AB01")
    stamps = {path: path.lstat().st_mtime_ns for path in root.rglob("*")}
    after = snapshot(root)
    capsys.readouterr()
    assert setup(root) == 0, "the answers of the first time are kept"
    assert snapshot(root) == after
    assert {path: path.lstat().st_mtime_ns for path in root.rglob("*")} == stamps
    assert "as they should be" in capsys.readouterr().out


def test_a_dry_run_shows_the_lines_and_writes_nothing(pi5: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = snapshot(pi5)
    assert setup(pi5, "--dry-run") == 0
    said = capsys.readouterr().out
    for line in ("+enable_uart=1", "-console=serial0,115200", "+Type=notify", "nothing was written"):
        assert line in said
    assert snapshot(pi5) == before
    setup(pi5)
    after = snapshot(pi5)
    setup(pi5, "--undo", "--dry-run")
    assert snapshot(pi5) == after


def test_an_upgrade_keeps_what_the_person_changed_and_lays_the_new_one_beside(
    pi5: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    setup(pi5)
    edited_defaults = (pi5 / DEFAULTS).read_text().replace('SPANWISE_MORE=""', 'SPANWISE_MORE="--set RNG_MAX=150"')
    (pi5 / DEFAULTS).write_text(edited_defaults)
    setup(pi5)
    assert (pi5 / DEFAULTS).read_text() == edited_defaults
    assert not (pi5 / f"{DEFAULTS}.spanwise-new").exists(), "nothing new to lay beside it"
    capsys.readouterr()
    setup(pi5, "--cameras", "oak:CAM_B,CAM_C")
    assert (pi5 / DEFAULTS).read_text() == edited_defaults
    assert 'SPANWISE_CAMERAS="--cameras oak:CAM_B,CAM_C"' in (pi5 / f"{DEFAULTS}.spanwise-new").read_text()
    assert "ours, beside your spanwise" in capsys.readouterr().out
    setup(pi5, "--undo")
    assert (pi5 / f"{DEFAULTS}.spanwise-saved").read_text() == edited_defaults
    assert not (pi5 / DEFAULTS).exists()
    assert not (pi5 / f"{DEFAULTS}.spanwise-new").exists()


def test_a_file_of_before_is_never_overwritten(pi5: Path) -> None:
    write(pi5, ROUTER, "[General]\n# mine\n")
    before = snapshot(pi5)
    setup(pi5, "--router")
    assert (pi5 / ROUTER).read_text() == "[General]\n# mine\n"
    assert "BlockSrcCompOut = 200,201" in (pi5 / f"{ROUTER}.spanwise-new").read_text()
    setup(pi5, "--undo")
    assert snapshot(pi5) == before


def test_undo_takes_the_edit_alone_out_of_a_boot_file_that_was_changed_since(pi5: Path) -> None:
    setup(pi5)
    config, words = pi5 / "boot/firmware/config.txt", pi5 / "boot/firmware/cmdline.txt"
    config.write_text(config.read_text() + "dtparam=i2c_arm=on\n")
    words.write_text(words.read_text().replace("rootwait", "rootwait quiet"))
    setup(pi5, "--undo")
    assert config.read_text() == CONFIG + "dtparam=i2c_arm=on\n"
    assert words.read_text() == CMDLINE.replace("rootwait", "rootwait quiet")


def test_undo_finds_its_lines_in_a_boot_file_that_an_editor_saved_with_other_line_ends(pi5: Path) -> None:
    setup(pi5)
    config = pi5 / "boot/firmware/config.txt"
    config.write_bytes(config.read_bytes().replace(b"\n", b"\r\n"))
    setup(pi5)
    assert config.read_bytes().count(b"enable_uart=1") == 1
    config.write_bytes(config.read_bytes().replace(b"\r\n", b"\n").replace(b"\n", b"\r\n"))
    setup(pi5, "--undo")
    assert config.read_bytes() == CONFIG.replace("\n", "\r\n").encode()


def test_the_router_keeps_the_nodes_off_autopilot_and_radio(pi5: Path) -> None:
    write(pi5, "usr/bin/mavlink-routerd", "", 0o755)
    setup(pi5)
    text = (pi5 / ROUTER).read_text()
    for section in ("[UartEndpoint autopilot]", "[UdpEndpoint ground]"):
        assert "BlockSrcCompOut = 200,201" in text.split(section)[1].split("\n\n")[0]
    assert "BlockMsgIdOut = 105" in text.split("[UdpEndpoint ground]")[1]
    assert "Block" not in text.split("[UdpEndpoint spanwise]")[1].split("\n\n")[0], "the service gets everything"
    assert 'SPANWISE_LINKS="--connect udpin:127.0.0.1:14550 --connect /dev' in (pi5 / DEFAULTS).read_text()
    setup(pi5, "--link", "/dev/ttyAMA0,460800")
    assert "Device = /dev/ttyAMA0\nBaud = 460800" in (pi5 / ROUTER).read_text()
    assert 'SPANWISE_LINKS="--connect udpin:127.0.0.1:14550"' in (pi5 / DEFAULTS).read_text()


def test_the_trim_flight_listens_where_the_router_sends_and_flies_the_service_s_airframe(
    pi5: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(pi5, "usr/bin/mavlink-routerd", "", 0o755)
    setup(pi5, "--airframe", "sitl-plane")
    (flown,) = [line for line in capsys.readouterr().out.splitlines() if "mission_scripts.calibrate_target" in line]
    words = shlex.split(flown)
    assert words[words.index("--airframe") + 1] == "sitl-plane"
    _, address, port = words[words.index("--connect") + 1].split(":")
    lines = (pi5 / ROUTER).read_text().split("[UdpEndpoint missions]")[1].split("\n\n")[0].splitlines()
    assert {"Mode = Normal", f"Address = {address}", f"Port = {port}", "BlockSrcCompOut = 200,201"} <= set(lines)


def test_without_a_router_the_trim_flight_has_a_radio_of_its_own(pi5: Path, capsys: pytest.CaptureFixture[str]) -> None:
    setup(pi5)
    (flown,) = [line for line in capsys.readouterr().out.splitlines() if "mission_scripts.calibrate_target" in line]
    assert "--connect /dev/ttyUSB0,57600 --airframe /etc/spanwise/wing.toml" in flown


def test_a_node_that_is_missing_does_not_take_the_router_down(pi5: Path) -> None:
    """It ends when one serial device cannot be opened: only the autopilot's is its own, and it is started again."""
    setup(pi5, "--router")
    text, defaults = (pi5 / ROUTER).read_text(), (pi5 / DEFAULTS).read_text()
    assert re.findall(r"^\[UartEndpoint (.*)\]$", text, re.MULTILINE) == ["autopilot"]
    assert re.findall(r"^Device = (.*)$", text, re.MULTILINE) == ["/dev/ttyAMA0"]
    for side in ("left", "right"):
        assert f"--connect /dev/spanwise-{side},921600" in defaults, "Spanwise opens it again when it comes"
    assert "--connect /dev/ttyAMA0" not in defaults
    added = configparser.ConfigParser()
    added.read(pi5 / ROUTER_UNIT)
    assert added["Unit"]["StartLimitIntervalSec"] == "0"
    assert added["Service"]["RestartSec"] == "1"
    setup(pi5, "--no-router")
    assert not (pi5 / ROUTER_UNIT).exists()


def test_devices_have_names_by_their_serial_numbers_and_owners_that_exist(pi5: Path) -> None:
    setup(pi5, "--serial-left", "FT4ABCDE", "--serial-trigger", "E6614103E7")
    rules = (pi5 / RULES).read_text()
    (left,) = [line for line in rules.splitlines() if 'SYMLINK+="spanwise-left"' in line]
    assert 'ATTRS{serial}=="FT4ABCDE"' in left
    assert 'ATTRS{serial}=="spanwise-right"' in rules
    assert 'ATTRS{idVendor}=="03e7"' in rules
    rule_keys = ("SUBSYSTEM", "KERNEL", "ATTRS{", "ENV{", "MODE", "GROUP", "SYMLINK")
    for line in rules.splitlines():
        for clause in line.split(", ") if line and not line.startswith("#") else []:
            assert clause.startswith(rule_keys)
            assert clause.count('"') == 2
    write(pi5, "etc/group", "dialout:x:20:\nvideo:x:44:\n")
    setup(pi5)
    assert 'GROUP="gpio"' not in (pi5 / RULES).read_text()
    assert "SupplementaryGroups=dialout video\n" in (pi5 / UNIT).read_text()


@pytest.mark.parametrize(
    ("spoilt", "figure"),
    [
        ("etc/group", "2 of 4 exist, not gpio, plugdev"),
        ("proc/meminfo", "0.5 GB (1.5 GB wanted)"),
        ("opt/spanwise/bin/spanwise", "/opt/spanwise/bin/spanwise: not there"),
        ("opt/spanwise", "is closed to other users"),
    ],
)
def test_what_is_to_be_mended_is_told_with_its_figure(
    pi5: Path, spoilt: str, figure: str, capsys: pytest.CaptureFixture[str]
) -> None:
    contents = {"etc/group": "dialout:x:20:\nvideo:x:44:\n", "proc/meminfo": "MemTotal:  500000 kB\n"}
    if spoilt in contents:
        write(pi5, spoilt, contents[spoilt])
    elif spoilt.endswith("bin/spanwise"):
        (pi5 / spoilt).unlink()
    else:
        (pi5 / spoilt).chmod(0o700)
    assert setup(pi5) == 4
    said = capsys.readouterr().out
    assert figure in said
    assert said.count("  mend ") == 1


@pytest.mark.parametrize(("home", "file", "code"), [(0o700, 0o644, 4), (0o755, 0o600, 4), (0o755, 0o644, 0)])
def test_an_airframe_that_the_service_s_user_cannot_read_is_to_be_mended(
    pi5: Path, home: int, file: int, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(pi5, "home/pi/wing.toml", "", file)
    path.parent.chmod(home)
    assert setup(pi5, "--airframe", "/home/pi/wing.toml") == code
    closed = path if file == 0o600 else path.parent
    assert (f"/home/pi/wing.toml: {closed} is closed to other users" in capsys.readouterr().out) is (code == 4)


@pytest.mark.parametrize("folder", ["/tmp", "/var/tmp"])
def test_an_airframe_that_the_service_has_no_sight_of_is_to_be_mended(
    pi5: Path, folder: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whoever wrote the file there may read it; PrivateTmp puts another folder in its place for the service."""
    write(pi5, f"{folder}/wing.toml", "", 0o644)
    assert setup(pi5, "--airframe", f"{folder}/wing.toml") == 4
    assert "PrivateTmp=yes" in (pi5 / UNIT).read_text()
    assert f"{folder}/wing.toml: the service has folders of its own" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--link", "serial"], "'serial' is not a connection"),
        (["--airframe", "my wing"], "airframe 'my wing': letters"),
        (["--airframe", "my-wing.toml"], "give the whole path, as /etc/spanwise/wing.toml"),
        (["--link", "/dev/serial0,921600"], "is not always the UART of pins 8 and 10; give /dev/ttyAMA0"),
        (["--airframe", 'a";reboot;"'], "letters, digits"),
        (["--cameras", "oak"], "--cameras oak: not a camera pair"),
        (["--cameras", "nonsense:1"], "--cameras nonsense:1: not a camera pair"),
        (["--cameras", "oak:CAM_B"], "--cameras oak:CAM_B: name the left and the right one"),
        (["--cameras", "v4l2:0,1", "--trigger", "oak"], "fires DepthAI cameras only"),
        (["--link", "/dev/ttyAMA0,921600", "--link", "/dev/ttyAMA0,57600"], "/dev/ttyAMA0 is there twice"),
        (["--link", "udpin:0.0.0.0:1", "--link", "udpin:0.0.0.0:1"], "udpin:0.0.0.0:1 is there twice"),
        (["--trigger", "bell"], "--trigger bell: not a trigger"),
        (["--router", "--link", "udpin:0.0.0.0:14550"], "needs the autopilot's serial device first"),
        (["--undo"], "nothing to undo"),
    ],
)
def test_what_cannot_be_is_one_sentence_and_nothing_is_written(
    pi5: Path, options: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = snapshot(pi5)
    assert setup(pi5, *options) == 1
    said = capsys.readouterr().err
    assert sentence in said
    assert said.count("\n") == 1
    assert snapshot(pi5) == before


def test_without_a_terminal_nothing_is_written_unless_yes_is_said(
    pi5: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = snapshot(pi5)
    assert main(["setup", "--root", str(pi5)]) == 1
    assert "give --yes" in capsys.readouterr().err
    assert snapshot(pi5) == before


def test_at_a_terminal_it_asks_until_the_answers_fit(pi5: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said = iter(["", "nadir-2m", "oak", "-", "", "nadir-2m", "v4l2:/dev/video0,/dev/video2", "-", "y"])
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("builtins.input", lambda _: next(said))
    assert main(["setup", "--root", str(pi5)]) == 0
    assert next(said, None) is None
    defaults = (pi5 / DEFAULTS).read_text()
    assert 'SPANWISE_AIRFRAME="nadir-2m"' in defaults
    assert 'SPANWISE_CAMERAS="--cameras v4l2:/dev/video0,/dev/video2"' in defaults
    answers = json.loads((pi5 / MANIFEST).read_text())["answers"]
    assert answers == {"airframe": "nadir-2m", "cameras": "v4l2:/dev/video0,/dev/video2"}, "no suggestion is an answer"


def test_what_nobody_chose_follows_the_board_and_what_is_installed(tmp_path: Path) -> None:
    root = fake_board(tmp_path, "plain")
    setup(root, "--airframe", "nadir-2m")
    assert "--connect /dev/ttyACM0,921600" in (root / DEFAULTS).read_text()
    setup(root, "--board", "pi4")
    assert "--connect /dev/ttyAMA0,921600" in (root / DEFAULTS).read_text()
    write(root, "usr/bin/mavlink-routerd", "", 0o755)
    setup(root)
    defaults = (root / DEFAULTS).read_text()
    assert "--connect udpin:127.0.0.1:14550" in defaults
    assert "Device = /dev/ttyAMA0" in (root / ROUTER).read_text(), "the board that was named is kept"
    assert 'SPANWISE_AIRFRAME="nadir-2m"' in defaults


@pytest.mark.parametrize("writes", range(6))  # manifest, three files, two edits
def test_a_disk_that_fills_up_ends_in_a_sentence_and_the_tree_as_it_was(
    pi5: Path, writes: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    before = snapshot(pi5)
    left = [writes]
    replace = trees._replace

    def full(path: Path, file: trees.File) -> None:
        left[0] -= 1
        if left[0] == -1:  # what is taken back makes room again
            raise OSError(28, "No space left on device")
        replace(path, file)

    monkeypatch.setattr(trees, "_replace", full)
    assert setup(pi5) == 1
    said = capsys.readouterr().err
    assert "No space left on device" in said
    assert said.count("\n") == 1
    assert snapshot(pi5) == before


@pytest.fixture
def closed_to_us() -> Iterator[Path]:
    """A tree of root's, looked at by nobody, whose interpreter may be closed to that user: all is imported before."""
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as other:
        setup(fake_board(Path(other), "pi5"))
        root = fake_board(Path(folder), "pi5")
        root.chmod(0o755)
        is_root = os.geteuid() == 0
        if not is_root:
            (root / "etc").chmod(0o555)
            (root / "var").mkdir(mode=0o555)
        else:
            os.seteuid(65534)
        try:
            yield root
        finally:
            if is_root:
                os.seteuid(0)
            else:
                (root / "etc").chmod(0o755)
                (root / "var").chmod(0o755)


def test_without_permission_it_is_one_sentence(closed_to_us: Path, capsys: pytest.CaptureFixture[str]) -> None:
    needed = closed_to_us / "etc", Path(companion.__file__).parent
    if not all(os.access(folder, os.R_OK, effective_ids=True) for folder in needed):
        pytest.skip("temporary folders or the package are closed to other users here")
    capsys.readouterr()
    before = snapshot(closed_to_us)
    assert setup(closed_to_us) == 1
    said = capsys.readouterr().err
    assert "permission denied; use sudo" in said
    assert said.count("\n") == 1
    assert snapshot(closed_to_us) == before


def test_a_link_that_leads_out_of_the_tree_is_refused(pi5: Path, tmp_path: Path, capsys: Any) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (pi5 / "etc/default").symlink_to(outside)
    assert setup(pi5) == 1
    assert "leads out of" in capsys.readouterr().err
    assert list(outside.iterdir()) == []


@pytest.mark.parametrize("text", ["", "{}", '{"format": 99, "done": {}}', '{"format": 1, "done": {"a": 3}}'])
def test_a_damaged_manifest_is_told(pi5: Path, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    write(pi5, MANIFEST, text)
    before = snapshot(pi5)
    assert setup(pi5) == 1
    said = capsys.readouterr().err
    assert ("damaged" in said) or ("newer Spanwise" in said)
    assert snapshot(pi5) == before


def test_a_change_interrupted_before_its_end_can_be_undone(pi5: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a power cut leaves it: manifest and some files written, nothing taken back."""
    before = snapshot(pi5)
    monkeypatch.setattr(installing, "_take_back", lambda *_: None)
    replace, left = trees._replace, [3]

    def cut(path: Path, file: trees.File) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt
        replace(path, file)

    monkeypatch.setattr(trees, "_replace", cut)
    assert setup(pi5) == 130
    monkeypatch.setattr(trees, "_replace", replace)
    assert snapshot(pi5) != before
    assert setup(pi5, "--undo") == 0
    after = snapshot(pi5)
    made = set(after) - set(before)
    assert made <= {"etc/udev", "etc/udev/rules.d"}, "folders alone"
    assert {name: after[name] for name in before} == before


def test_a_uart_that_is_not_there_is_not_passed_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An image has no devices; a system that runs has, and this one's may not be plugged in."""
    root = fake_board(tmp_path, "plain")
    for device, is_absent in (("", False), ("dev/null", True), ("dev/ttyACM0", False)):
        if device:
            write(root, device, "")
        setup(root, "--dry-run")
        (line,) = (line for line in capsys.readouterr().out.splitlines() if "UART /dev/ttyACM0" in line)
        assert ("not there now; --link names another" in line) is is_absent


def test_every_next_step_is_a_command_that_the_program_takes(
    board: tuple[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    _, root = board
    setup(root)
    lines = [line.strip() for line in capsys.readouterr().out.split("next:")[1].splitlines()]
    ours = [line for line in lines if line.startswith("spanwise ")]
    assert [line.split()[1] for line in ours] == ["new-airframe", "doctor", "setup", "calibrate", "identify", "run"]
    for command in ours:
        words = shlex.split(command)[1:]
        assert build_parser(words[0]).parse_args(words).command == words[0]
    assert any(line.startswith("python -m mission_scripts.calibrate_target") for line in lines)


def test_what_is_installed_and_flown_is_the_calibrated_airframe(pi5: Path, capsys: pytest.CaptureFixture[str]) -> None:
    setup(pi5)
    lines = [line.strip() for line in capsys.readouterr().out.split("next:")[1].splitlines()]
    after = lines[next(n for n, line in enumerate(lines) if line.startswith("spanwise calibrate stereo")) + 1 :]
    read = build_parser("calibrate").parse_args(["calibrate", "stereo", "--square-m=1", "--airframe=a"])
    calibrated = str(read.out / "airframe.toml")
    assert f"sudo install -D -m 644 {calibrated} /etc/spanwise/wing.toml" in after
    words = {line.split()[1]: shlex.split(line)[1:] for line in after if line.startswith("spanwise ")}
    for name in ("identify", "run"):
        assert build_parser(name).parse_args(words[name]).airframe == calibrated
    assert build_parser("identify").parse_args(words["identify"]).out == read.out, "the modes go into the same file"
    assert not any("my-wing.toml" in line for line in after if "mission_scripts" not in line)


def test_two_adapters_with_one_number_are_refused(pi5: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert setup(pi5, "--serial-left", "FT4ABCDE", "--serial-right", "FT4ABCDE") == 1
    assert "two adapters cannot have the same" in capsys.readouterr().err
    assert not (pi5 / RULES).exists()
