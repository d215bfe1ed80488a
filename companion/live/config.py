"""Where the live view is served, and for whom; picklable."""

from __future__ import annotations

import contextlib
import ipaddress
import os
import secrets
from dataclasses import dataclass
from pathlib import Path

from companion.errors import ConfigError
from companion.live.networks import open_addresses

DEFAULT_PORT = 8765  # the one that Foxglove and Lichtblick offer (convention)
DEFAULT_ADDRESS = f"127.0.0.1:{DEFAULT_PORT}"
_TOKEN_BYTES = 16  # convention: 128 bits, which nobody guesses
_HIGHEST_PORT = 65_535  # of TCP (by definition)


@dataclass(frozen=True, slots=True)
class LiveConfig:
    """Address of the live view.

    ``token`` is asked of everyone where the address is reachable from outside, and on loopback of pages of another
    origin; None admits local pages alone. ``folder`` has the recordings that may be fetched, and takes the page's own.
    ``token_file`` holds the token, for a sentence that says where it is to be looked up.
    """

    host: str
    port: int
    token: str | None
    folder: Path
    token_file: Path | None = None

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach the address."""
        return is_loopback(self.host)

    @property
    def urls(self) -> list[str]:
        """Addresses of the page that can be opened, with the token where one is needed."""
        hosts = [f"[{host}]" if ":" in host else host for host in open_addresses(self.host)]
        suffix = "" if self.is_loopback or self.token is None else f"?token={self.token}"
        return [f"http://{host}:{self.port}/{suffix}" for host in hosts]

    @property
    def token_place(self) -> str:
        """Where the token is kept, in the words of a person at this computer; "" where there is no file."""
        if self.token_file is None:
            return ""
        with contextlib.suppress(ValueError, RuntimeError):
            return f"~/{self.token_file.relative_to(Path.home())}"
        return str(self.token_file)


def parse_address(text: str) -> tuple[str, int]:
    """Take ``HOST:PORT``, ``HOST``, ``:PORT`` or ``PORT`` apart; an absent host is loopback.

    Raises
    ------
    ConfigError
        The port is none.
    """
    host, colon, port = text.rpartition(":")
    if text.isdecimal():
        host, port = "", text
    elif not colon or (text.count(":") > 1 and not host.endswith("]")):
        host, port = text, str(DEFAULT_PORT)
    if not port.isdecimal() or not 0 <= int(port) <= _HIGHEST_PORT:
        raise ConfigError(f"--live {text}: give HOST:PORT, as in {DEFAULT_ADDRESS}")
    host = host.strip("[]") or "127.0.0.1"
    if "/" in host or host.endswith((".mcap", ".tlog")):
        raise ConfigError(f"--live {text}: is no address; put --live behind the recording, or give HOST:PORT")
    return host, int(port)


def is_loopback(host: str) -> bool:
    """Whether a host's name or number means this machine alone."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def live_config(text: str, folder: Path, token_file: Path) -> LiveConfig:
    """Read ``--live``; beyond loopback a token is read from its file, which is made where there is none.

    Raises
    ------
    ConfigError
        The address is none, or the token's file cannot be read or written.
    """
    host, port = parse_address(text)
    token = _stored_token(token_file) if token_file.is_file() or not is_loopback(host) else None
    return LiveConfig(host, port, token, folder, token_file)


def _stored_token(path: Path) -> str:
    try:
        if not path.is_file():
            path.parent.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(descriptor, "w", encoding="ascii") as file:
                file.write(secrets.token_urlsafe(_TOKEN_BYTES) + "\n")
        token = path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: the live view's token cannot be read or written: {error}") from error
    if len(token) < _TOKEN_BYTES:
        raise ConfigError(f"{path}: the live view's token has under {_TOKEN_BYTES} letters; remove the file")
    return token
