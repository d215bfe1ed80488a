"""A websocket carried on to the SDK's server behind the door, which knows one name of its protocol alone."""

from __future__ import annotations

import asyncio
import contextlib

from companion.live.requests import MOST_HEAD_BYTES, Request

_SPOKEN = "foxglove.sdk.v1"
_EARLIER = "foxglove.websocket.v1"  # the same protocol, as Lichtblick before 1.24 and older clients name it
_CHUNK_BYTES = 65_536  # chosen: few turns for a picture, little memory for each viewer
_HANDSHAKE = ("upgrade", "connection", "sec-websocket-key", "sec-websocket-version")


def subprotocol(request: Request) -> str | None:
    """The name by which a client knows the protocol; None where it does not."""
    names = [name.strip() for name in request.headers.get("sec-websocket-protocol", "").split(",")]
    return next((name for name in (_SPOKEN, _EARLIER) if name in names), None)


async def carry(
    request: Request, name: str, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, port: int
) -> None:
    """Carry one websocket until either side ends; a client that does not read holds up the SDK's queue for it alone."""
    inner_reader, inner_writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        headers = {key: request.headers[key] for key in _HANDSHAKE if key in request.headers}
        headers |= {"host": f"127.0.0.1:{port}", "sec-websocket-protocol": _SPOKEN}
        lines = "".join(f"{key}: {value}\r\n" for key, value in headers.items())
        inner_writer.write(f"GET / HTTP/1.1\r\n{lines}\r\n".encode("latin-1"))
        answer = await inner_reader.readuntil(b"\r\n\r\n")
        if len(answer) <= MOST_HEAD_BYTES:
            writer.write(answer.replace(_SPOKEN.encode(), name.encode()))
            await _both_ways((reader, inner_writer), (inner_reader, writer))
    finally:
        inner_writer.close()


async def _both_ways(*ways: tuple[asyncio.StreamReader, asyncio.StreamWriter]) -> None:
    """Pass bytes on in each way until one of them ends."""
    tasks = [asyncio.create_task(_pass_on(*way)) for way in ways]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while chunk := await reader.read(_CHUNK_BYTES):
            writer.write(chunk)
            await writer.drain()
