"""The one port of the live view: page, downloads and changes by HTTP, and the websocket behind the same rule of access.

Runs in a thread of its own. Every connection has a bounded head and body and a time in which they must come. Of those
that are not admitted yet an address has few: a newer one takes the place of its oldest, so that nobody who only knocks
shuts the owner out.
"""

from __future__ import annotations

import asyncio
import dataclasses
import socket
import threading
from collections.abc import Callable
from http import HTTPStatus

from companion.errors import ConfigError
from companion.live import tunnel
from companion.live.access import COOKIE, Access
from companion.live.config import LiveConfig
from companion.live.public import public_answer
from companion.live.requests import MOST_BODY_BYTES, MOST_HEAD_BYTES, HttpAnswer, Request, parse_head, refusal

_HEAD_S = 10.0  # chosen: a browser sends its request at once; who dawdles is turned away
_MOST_CONNECTIONS = 64  # bound of memory
_MOST_KNOCKING = 16  # of one address, not admitted yet: more than a browser opens at once (choice)
_CLOSING_S = 2.0  # chosen: transfers end by then, or are cut off with the service
_CHUNK_BYTES = 262_144  # chosen: few turns for a large file, little memory for each reader
_SHUT_OUT = (
    "the live view wants its token here: open the address that 'spanwise run --live' prints, "
    "or put ?token=... behind this one"
)


def listen(config: LiveConfig) -> socket.socket:
    """Bind the live view's address.

    Raises
    ------
    ConfigError
        The address is taken, or none of this machine's.
    """
    family = socket.AF_INET6 if ":" in config.host else socket.AF_INET
    try:
        return socket.create_server((config.host, config.port), family=family, backlog=_MOST_CONNECTIONS)
    except OSError as error:
        where = f"{config.host}:{config.port}"
        raise ConfigError(f"--live {where}: {error.strerror or error}; give another HOST:PORT") from error


class Door:
    """Serves one live view.

    ``listening`` is the bound socket, whose port is the door's. ``answer`` gives the answer to an admitted request that
    is no websocket, and is called in a thread. ``behind`` is the port of the SDK's server on this machine.
    """

    def __init__(
        self, listening: socket.socket, access: Access, answer: Callable[[Request], HttpAnswer], behind: int
    ) -> None:
        self._access, self._answer, self._behind = access, answer, behind
        self._knocking: dict[asyncio.Task[None] | None, str] = {}
        self._admitted: set[asyncio.Task[None] | None] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stop = asyncio.Event()
        self._is_up = threading.Event()
        self._thread = threading.Thread(target=self._serve, args=(listening,), name="live-door", daemon=True)
        self._thread.start()
        self._is_up.wait(_CLOSING_S)

    def close(self) -> None:
        """Close the door, and end."""
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(_CLOSING_S)

    def _serve(self, listening: socket.socket) -> None:
        asyncio.run(self._until_closed(listening))

    async def _until_closed(self, listening: socket.socket) -> None:
        """Serve until told to stop; what is still connected is cut off when the loop ends."""
        self._loop = asyncio.get_running_loop()
        server = await asyncio.start_server(self._connected, sock=listening, limit=MOST_HEAD_BYTES)
        self._is_up.set()
        await self._stop.wait()
        server.close()

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task, (address, *_) = asyncio.current_task(), writer.get_extra_info("peername") or ("",)
        self._make_room(address)
        self._knocking[task] = address
        try:
            if len(self._knocking) + len(self._admitted) <= _MOST_CONNECTIONS:
                await self._attend(reader, writer)
        except (OSError, ValueError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError):
            pass  # whoever it was has gone, or never spoke HTTP
        except asyncio.CancelledError:
            pass  # the door closes, which is no error to be told
        finally:
            self._knocking.pop(task, None)
            self._admitted.discard(task)
            writer.close()

    def _make_room(self, address: str) -> None:
        """Turn the oldest away of too many that are not admitted yet, first of the newcomer's own address."""
        neighbours = [task for task, place in self._knocking.items() if place == address]
        is_full = len(self._knocking) + len(self._admitted) >= _MOST_CONNECTIONS
        if len(neighbours) < _MOST_KNOCKING:
            neighbours = list(self._knocking) if is_full else []
        for task in neighbours[:1]:
            del self._knocking[task]
            if task is not None:
                task.cancel()

    async def _attend(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        request = await asyncio.wait_for(_read(reader), _HEAD_S)
        if request is None:
            return await _send(writer, refusal(HTTPStatus.BAD_REQUEST, "this is no request of HTTP"))
        if not self._access.admits(request):
            public = public_answer(request, self._access.token_place, is_loopback=self._access.is_loopback)
            return await _send(writer, public or refusal(HTTPStatus.FORBIDDEN, _SHUT_OUT))
        self._knocking.pop(task := asyncio.current_task(), None)
        self._admitted.add(task)
        if request.is_websocket:
            name = tunnel.subprotocol(request)
            if name is not None:
                return await tunnel.carry(request, name, reader, writer, self._behind)
            return await _send(writer, refusal(HTTPStatus.BAD_REQUEST, "the websocket speaks foxglove.sdk.v1"))
        response = await asyncio.to_thread(self._answer, request)
        if self._access.token is not None and request.query.get("token") == self._access.token:
            cookie = f"{COOKIE}={self._access.token}; HttpOnly; SameSite=Strict; Path=/"
            response = dataclasses.replace(response, headers=response.headers | {"Set-Cookie": cookie})
        return await _send(writer, response)


async def _read(reader: asyncio.StreamReader) -> Request | None:
    """Read a request whole; None where it is none, or too large."""
    request = parse_head(await reader.readuntil(b"\r\n\r\n"))
    length = "0" if request is None else request.headers.get("content-length", "0")
    if request is None or not length.isdecimal() or int(length) > MOST_BODY_BYTES:
        return None
    return dataclasses.replace(request, body=await reader.readexactly(int(length)))


async def _send(writer: asyncio.StreamWriter, response: HttpAnswer) -> None:
    if response.file is None:
        writer.write(response.head(len(response.body)) + response.body)
        await writer.drain()
        return
    with response.file.open("rb") as file:  # one that is being written is sent as long as it is now
        remaining = response.file.stat().st_size
        writer.write(response.head(remaining))
        while remaining and (chunk := await asyncio.to_thread(file.read, min(_CHUNK_BYTES, remaining))):
            writer.write(chunk)
            await writer.drain()
            remaining -= len(chunk)
