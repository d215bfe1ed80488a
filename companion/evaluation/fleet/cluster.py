"""The same tasks on an existing Dask cluster: its workers read the files and write the parts, as processes here do.

Workers see the files and the folder of results at the same paths, have Spanwise installed, and one thread each: a task
has its process to itself. Dask gives a task whose worker died to others and condemns it with whatever else that worker
held after a few deaths; a condemned task is tried once more with no other beside it before it is called deadly.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar
from urllib.parse import urlsplit

from companion.errors import LinkError, import_extra
from companion.evaluation.fleet.runner import Row, Task, attempt, failure, split_stored, write_part

_PORT = 8786  # where an address names none (Dask's convention)
_CONNECT_S = 10.0  # a scheduler on the same network answers within a second (choice)

T = TypeVar("T", bound=Task)


def run_on_cluster(tasks: Sequence[T], work: Callable[[T], Row], address: str) -> Iterator[tuple[T, Row]]:
    """Give each task's result as it is made, those of an earlier run first, as :func:`runner.run` does.

    Raises
    ------
    MissingExtra
        The extra ``fleet`` is not installed.
    LinkError
        No scheduler answers, it was lost, or a worker has more than one thread.
    """
    require_dask()
    earlier, missing = split_stored(tasks)
    yield from earlier
    if missing:
        with _client(address) as client:
            yield from _made(client, missing, work, address)


def require_dask() -> None:
    """Refuse a cluster where its library is absent.

    Raises
    ------
    MissingExtra
        The extra ``fleet`` is not installed.
    """
    import_extra("distributed", "Dask clusters", "fleet")


def _client(address: str) -> Any:
    from distributed import Client

    try:
        _knock(address)
        client = Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise LinkError(
            f"--scheduler {address}: no Dask scheduler answers there; start one (dask scheduler) and give its address "
            "as it prints it, such as tcp://192.168.1.5:8786"
        ) from error
    threaded = [worker for worker, threads in client.nthreads().items() if threads > 1]
    if threaded:
        client.close()
        raise LinkError(
            f"--scheduler {address}: {len(threaded)} workers have more than one thread, and a flight wants its process "
            "to itself; start them as: dask worker ADDRESS --nthreads 1 --nworkers N"
        )
    return client


def _knock(address: str) -> None:
    """Raise OSError or ValueError where nothing listens: a client that cannot connect would print more at its end."""
    place = urlsplit(address if "://" in address else f"tcp://{address}")
    socket.create_connection((place.hostname or "", place.port or _PORT), _CONNECT_S).close()


def _made(client: Any, tasks: Sequence[T], work: Callable[[T], Row], address: str) -> Iterator[tuple[T, Row]]:
    condemned: list[T] = []
    for task, row in _finished(client, tasks, work, address):
        if row is None:
            condemned.append(task)
        else:
            yield task, row
    for task in condemned:
        ((_, row),) = _finished(client, [task], work, address)
        if row is None:
            row = failure(task, "its worker ended each time")
            with contextlib.suppress(OSError):  # a failure is tried again by a further run anyway
                write_part(task, row)
        yield task, row


def _finished(
    client: Any, tasks: Sequence[T], work: Callable[[T], Row], address: str
) -> Iterator[tuple[T, Row | None]]:
    """Rows as they come; None for a task with which workers died."""
    from distributed import KilledWorker, as_completed

    pending = {client.submit(attempt, task, work, pure=False): task for task in tasks}
    for future in as_completed(list(pending), loop=client.loop):
        task = pending.pop(future)
        if future.status == "finished":
            yield task, future.result()
        elif future.status == "error":
            error = future.exception()
            yield task, None if isinstance(error, KilledWorker) else failure(task, f"{type(error).__name__}: {error}")
        else:
            raise LinkError(
                f"--scheduler {address}: the scheduler was lost ({future.status}); the same command goes on from "
                "the parts that are made"
            )
