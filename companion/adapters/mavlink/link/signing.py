"""MAVLink 2 signing: only frames with our key, fresh and never seen before, get in; everything that we send is signed.

The check sits at the transport, before the recorder and the decoder: a recording holds what was accepted, and replays
without the key. Refused frames are counted by reason. pymavlink signs and checks inside its message parser and stores
no timestamps over a restart, so neither is possible there.

A signature's timestamp counts 10 us since 2015. It must increase within a stream (link id, system, component), and a
new stream may be a minute behind our own time at most (MAVLink 2 signing, "Timestamp handling"). Our time runs with the
monotonic clock, never behind anything accepted. A companion may have no clock of the day: our time and each stream's
newest timestamp are kept in a file twice a second, so that a power cut lets in again no more than came since. A stream
that is not in the file must be newer than our time in it. Without the file nothing comes in that is older than the key;
so a service does not start where the file cannot be written, and says so where that begins in flight.
"""

from __future__ import annotations

import enum
import hashlib
import hmac
import os
import threading
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from fastcrc.crc16 import mcrf4xx

from companion.adapters.mavlink.link.dialect import ID_OF
from companion.adapters.mavlink.link.scan import MAGIC_2, SIGNED, sender_of, split_frames
from companion.adapters.mavlink.link.transport import Transport
from companion.adapters.mavlink.link.udp import UdpIn
from companion.adapters.mavlink.vehicle.senders import Senders
from companion.errors import ConfigError
from companion.params.persist import write_atomically
from companion.ports import Clock
from companion.rate_limiter import RateLimiter
from companion.records import Notice
from companion.units import Severity

_KEY_BYTES = 32  # a SHA-256 hash (MAVLink signing)
_UNIT_NS = 10_000  # unit of a signature's timestamp (MAVLink signing)
_MINUTE = 60 * 100_000  # in units of 10 us: how far behind a new stream may be (MAVLink signing)
_SECOND = 100_000  # in units of 10 us (derived)
_RESTART = _SECOND
_SAVE_PERIOD_NS = 500_000_000  # chosen: twice a second, so that a power cut lets in again no more than came since
_EPOCH_S = 1_420_070_400  # 2015-01-01 (by definition)
_LARGEST = (1 << 48) - 1  # 48 bits of timestamp (MAVLink signing)
_MOST_STREAMS = 1024  # bound of memory
_SAY_PERIOD_NS = 10_000_000_000  # chosen: refused frames are told every ten seconds, not one by one
_UNKEPT_PERIOD_NS = 60_000_000_000  # chosen: nothing can be done about it in flight, and it must not be forgotten


class Refusal(enum.StrEnum):
    """Why a frame did not get in."""

    UNSIGNED = "unsigned"
    WRONG_KEY = "wrong key"
    REPLAYED = "replayed"
    STALE = "stale"


StreamKey = tuple[int, int, int]
"""Link id, system and component."""


@dataclass(frozen=True, slots=True)
class SigningTime:
    """State that must outlive a power cycle: our signing time, and the newest timestamp of each stream."""

    sent: int = 0
    streams: Mapping[StreamKey, int] = field(default_factory=dict)


class Signing:
    """Key, time and known streams, shared by all signed links of the service.

    ``secret`` is the key, 32 bytes. Our signing time begins at ``timestamp``, in 10 us. ``keeper`` gets twice a second
    what is to be kept over a restart; ``saved`` is what was kept: its streams go on behind it, and new ones begin
    behind its own time.
    """

    def __init__(
        self,
        secret: bytes,
        clock: Clock,
        timestamp: int = 0,
        keeper: StampKeeper | None = None,
        saved: SigningTime | None = None,
    ) -> None:
        if len(secret) != _KEY_BYTES:
            raise ConfigError(f"a signing key has {_KEY_BYTES} bytes, not {len(secret)}")
        self.refused: Counter[Refusal] = Counter()
        self.accepted = 0
        self._secret = secret
        self._clock = clock
        self._keeper = keeper
        self._saved = SigningTime() if saved is None else saved
        self._base = timestamp
        self._base_host_ns = clock.now_ns()
        self._saves = RateLimiter(_SAVE_PERIOD_NS)
        self._last_sent = 0
        self._streams: dict[StreamKey, int] = dict(self._saved.streams)
        self._floor = self._saved.sent
        self._warnings = RateLimiter(_SAY_PERIOD_NS)
        self._reported: Counter[Refusal] = Counter()

    def require_keeping(self) -> None:
        """Write once what was kept before, and wait for it.

        Raises
        ------
        ConfigError
            It cannot be written: after a restart recorded frames would come in again.
        """
        if self._keeper is not None:
            self._keeper.write(self._saved)
            if self._keeper.problem is not None:
                raise ConfigError(f"{self._keeper.problem}: make room, or move the key to where it can")

    def now(self) -> int:
        """Our signing time in 10 us."""
        return min(self._base + (self._clock.now_ns() - self._base_host_ns) // _UNIT_NS, _LARGEST)

    def sign(self, frame: bytes, link: int) -> bytes:
        """Sign one unsigned MAVLink 2 frame of any message; its checksum covers the flag, and changes with it."""
        self._last_sent = max(self.now(), self._last_sent + 1)
        self._keep()
        head = frame[:2] + bytes((frame[2] | SIGNED,)) + frame[3:-2]
        # CRCs are affine: what a flag changes does not depend on the CRC extra, which stands last
        crc = int.from_bytes(frame[-2:], "little") ^ mcrf4xx(frame[1:-2] + b"\0") ^ mcrf4xx(head[1:] + b"\0")
        body = head + crc.to_bytes(2, "little") + bytes((link & 0xFF,)) + self._last_sent.to_bytes(6, "little")
        return body + self._digest(body)

    def judge(self, frame: bytes) -> Refusal | None:
        """Say why a whole frame, whose checksum is right, may not come in; nothing, and take it, if it may."""
        refusal = self.examine(frame)
        if refusal is None:
            self.accept(frame)
        return refusal

    def examine(self, frame: bytes) -> Refusal | None:
        """Say the same of a frame of which something else decides yet whether it is taken."""
        refusal = self._refusal(frame)
        if refusal is not None and not (refusal is Refusal.UNSIGNED and _is_radio_status(frame)):
            self.refused[refusal] += 1
        return refusal

    def accept(self, frame: bytes) -> None:
        """Take a frame that may come in: from now on its stream must be newer."""
        stream, timestamp = _stamp_of(frame)
        self._streams[stream] = timestamp
        if timestamp > self.now():
            self._base, self._base_host_ns = timestamp, self._clock.now_ns()
        self.accepted += 1
        self._keep()

    def _refusal(self, frame: bytes) -> Refusal | None:
        if frame[0] != MAGIC_2 or not frame[2] & SIGNED:
            return Refusal.UNSIGNED
        if not hmac.compare_digest(self._digest(frame[:-6]), frame[-6:]):
            return Refusal.WRONG_KEY
        stream, timestamp = _stamp_of(frame)
        newest = self._streams.get(stream)
        if newest is not None and timestamp <= newest:
            return Refusal.REPLAYED
        oldest = max(self.now() - _MINUTE, self._floor + 1)
        if newest is None and (timestamp < oldest or len(self._streams) >= _MOST_STREAMS):
            return Refusal.STALE
        return None

    def _digest(self, signed: bytes) -> bytes:
        return hashlib.sha256(self._secret + signed).digest()[:6]

    def _keep(self) -> None:
        if self._keeper is None or not self._saves.take(self._clock.now_ns()):
            return
        self._keeper.keep(SigningTime(max(self.now(), self._last_sent), dict(self._streams)))

    def notices(self, now_host_ns: int) -> list[Notice]:
        """Sentences about what was refused since the last one, every 10 s, and about a time that is not kept."""
        notices: list[Notice] = []
        problem = None if self._keeper is None else self._keeper.problem
        if problem is not None and self._warnings.take(now_host_ns, problem, _UNKEPT_PERIOD_NS):
            notices.append(Notice(Severity.ERROR, f"{problem}: a restart lets old frames in", now_host_ns))
        fresh = self.refused - self._reported
        if fresh and self._warnings.take(now_host_ns):
            self._reported = Counter(self.refused)
            notices.append(Notice(Severity.WARNING, refusal_text(fresh), now_host_ns))
        return notices


def refusal_text(refused: Mapping[Refusal, int]) -> str:
    """The sentence about frames that were refused, by reason."""
    counts = ", ".join(f"{count} {reason}" for reason, count in sorted(refused.items()))
    advice = ": spell a link whose nodes cannot sign LINK,unsigned" if Refusal.UNSIGNED in refused else ""
    return f"signing refused {counts}{advice}"


def _stamp_of(frame: bytes) -> tuple[StreamKey, int]:
    """Stream of a signed frame and its timestamp, 10 us."""
    return (frame[-13], frame[5], frame[6]), int.from_bytes(frame[-12:-6], "little")


def _is_radio_status(frame: bytes) -> bool:
    """Whether a frame is a telemetry radio's RADIO_STATUS, which no radio can sign: dropped, and no news."""
    return sender_of(frame)[2] == ID_OF["RADIO_STATUS"]


class SignedTransport:
    """A transport whose bytes are checked on the way in and signed on the way out."""

    def __init__(self, inner: Transport, signing: Signing, link: int) -> None:
        self._inner = inner
        self._signing = signing
        self._link = link
        self._tail = b""
        self._judged_inside = isinstance(inner, UdpIn)  # it learns its peers from what is accepted
        if isinstance(inner, UdpIn):
            inner.judge = lambda frame: signing.examine(frame) is None
            inner.accept = signing.accept

    @property
    def senders(self) -> Senders | None:
        """Senders of the inner transport, where many can reach it."""
        return getattr(self._inner, "senders", None)

    @property
    def busy(self) -> bool:
        """Whether bytes wait in the inner transport."""
        return bool(getattr(self._inner, "busy", False))

    def fileno(self) -> int:
        """Descriptor to wait on, or -1 while there is none."""
        return self._inner.fileno()

    def receive(self, limit: int, now_host_ns: int) -> bytes:
        """Give the accepted frames of what has arrived."""
        data = self._inner.receive(limit, now_host_ns)
        return self._admit(data) if data and not self._judged_inside else data

    def send(self, data: bytes) -> bool:
        """Sign one frame and send it."""
        return self._inner.send(self._signing.sign(data, self._link))

    def close(self) -> None:
        """Release the device or socket."""
        self._inner.close()

    def _admit(self, data: bytes) -> bytes:
        pieces, self._tail = split_frames(self._tail + data)
        return b"".join(piece for piece, is_frame in pieces if is_frame and self._signing.judge(piece) is None)


# ------------------------------------------------------------------------------------------------ the key file


def load_signing(path: Path, clock: Clock) -> Signing:
    """Read a key file: 64 hexadecimal digits, or ``passphrase: ...`` as ground stations take it (hashed).

    Beside it, or in a service's state folder where systemd gives it one, ``<name>.stamp`` keeps the signing time.

    Raises
    ------
    ConfigError
        The file is missing, is no key, or others than its owner may read it.
    """
    try:
        text = path.read_text(encoding="utf-8").strip()
        mode = path.stat().st_mode
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot read the signing key {path}: {error}") from error
    if mode & 0o077:
        raise ConfigError(f"signing key {path} can be read by others: chmod 600 {path}")
    beside = path.with_name(path.name + ".stamp")
    state = os.environ.get("STATE_DIRECTORY")
    stamp = Path(state.split(":")[0]) / beside.name if state else beside
    key_time = SigningTime(max(0, int(path.stat().st_mtime) - _EPOCH_S) * _SECOND)
    saved = _read_stamp(stamp) or _read_stamp(beside) or key_time
    return Signing(_secret(text, path), clock, min(saved.sent + _RESTART, _LARGEST), StampKeeper(stamp), saved)


def _secret(text: str, path: Path) -> bytes:
    label, colon, phrase = text.partition(":")
    if colon and label.strip() == "passphrase" and phrase.strip():
        return hashlib.sha256(phrase.strip().encode()).digest()
    try:
        secret = bytes.fromhex(text)
    except ValueError:
        secret = b""
    if len(secret) != _KEY_BYTES:
        raise ConfigError(f"signing key {path}: give 64 hexadecimal digits, or 'passphrase: ...'")
    return secret


def _read_stamp(path: Path) -> SigningTime | None:
    """Read the saved state: our time in the first line, then a stream in each; None where the file cannot be read."""
    try:
        first, *lines = path.read_text(encoding="ascii").splitlines()
        sent = int(first)
        rows = [[int(word) for word in line.split()] for line in lines[:_MOST_STREAMS]]
        streams = {(link, system, component): timestamp for link, system, component, timestamp in rows}
    except (OSError, ValueError):
        return None
    return SigningTime(sent, streams) if 0 <= sent <= _LARGEST // 2 else None


class StampKeeper:
    """Writes the newest state, one write at a time; what comes during a write waits for the next occasion.

    ``problem`` says why the last write failed; None where it did not.
    """

    def __init__(self, path: Path) -> None:
        self.problem: str | None = None
        self._path = path
        self._writing: threading.Thread | None = None

    def keep(self, state: SigningTime) -> None:
        """Have it on the disk soon, so that a power cut leaves it or the one before."""
        if self._writing is None or not self._writing.is_alive():
            self._writing = threading.Thread(target=self.write, args=(state,), name="signing-stamp", daemon=True)
            self._writing.start()

    def write(self, state: SigningTime) -> None:
        """Have it on the disk now, or a :attr:`problem`."""
        rows = "".join(f"{' '.join(map(str, stream))} {newest}\n" for stream, newest in state.streams.items())
        try:
            write_atomically(self._path, f"{state.sent}\n{rows}")
        except OSError as error:
            self.problem = f"{self._path.name} of signing cannot be written ({error.strerror or error})"
        else:
            self.problem = None
