"""Fake companions for the tests of ``spanwise setup``: small file trees that look like four boards."""

from __future__ import annotations

import stat
from pathlib import Path

CMDLINE = "console=serial0,115200 console=tty1 root=PARTUUID=1234abcd-02 rootfstype=ext4 fsck.repair=yes rootwait\n"
CONFIG = "# For more options see http://rptl.io/configtxt\ndtparam=audio=on\n\n[cm4]\notg_mode=1\n\n[all]\n"
_MODELS = {
    "pi4": "Raspberry Pi 4 Model B Rev 1.5",
    "pi5": "Raspberry Pi 5 Model B Rev 1.0",
    "jetson": "NVIDIA Jetson Orin Nano Developer Kit",
    "plain": "",
}
BOARDS = tuple(_MODELS)
WANTS = "etc/systemd/system/multi-user.target.wants"


def write(root: Path, name: str, text: str, mode: int = 0o644) -> Path:
    path = root / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(mode)
    return path


def fake_board(root: Path, kind: str) -> Path:
    """A tree with a board's name, memory, groups, boot files and services, and Spanwise in ``/opt``."""
    write(
        root, "etc/group", "".join(f"{name}:x:{i}:\n" for i, name in enumerate(("dialout", "gpio", "video", "plugdev")))
    )
    write(root, "proc/meminfo", "MemTotal:        8245432 kB\nMemFree:         7000000 kB\n")
    write(root, "opt/spanwise/bin/spanwise", "#!/bin/sh\n", 0o755)
    (root / WANTS).mkdir(parents=True)
    if _MODELS[kind]:
        write(root, "proc/device-tree/model", _MODELS[kind] + "\0")
    if kind.startswith("pi"):
        write(root, "boot/firmware/config.txt", CONFIG)
        write(root, "boot/firmware/cmdline.txt", CMDLINE, 0o755)
        (root / WANTS / "hciuart.service").symlink_to("/lib/systemd/system/hciuart.service")
    if kind == "jetson":
        (root / WANTS / "nvgetty.service").symlink_to("/etc/systemd/system/nvgetty.service")
    return root


def snapshot(root: Path) -> dict[str, tuple[int, bytes | str]]:
    """Everything below a folder: kind and permissions, and what it holds."""
    entries: dict[str, tuple[int, bytes | str]] = {}
    for path in sorted(root.rglob("*")):
        mode = path.lstat().st_mode
        content: bytes | str = ""
        if stat.S_ISLNK(mode):
            content = str(path.readlink())
        elif stat.S_ISREG(mode):
            content = path.read_bytes()
        entries[str(path.relative_to(root))] = (mode, content)
    return entries
