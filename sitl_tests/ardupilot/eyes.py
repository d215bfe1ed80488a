"""The simulated cameras of an aircraft whose flight begins when somebody says so."""

from __future__ import annotations

import dataclasses
import multiprocessing
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess

from companion.sim.vision.camera_server import CameraServer, CameraServerConfig

NOT_YET_NS = 1 << 62


def serve(config: CameraServerConfig, control: Connection) -> None:
    """Run until the other end closes or says "stop"; a number is the host time of the flight's first instant."""
    server = CameraServer(config)
    control.send("open")
    try:
        while True:
            if control.poll(0):
                said = control.recv()
                if said == "stop":
                    break
                server.config = dataclasses.replace(config, start_host_ns=said)
            server.step()
    except EOFError:
        pass
    finally:
        server.close()


def open_eyes(config: CameraServerConfig, patience_s: float) -> tuple[BaseProcess, Connection]:
    """Start the process; its sockets are open when this returns. It sees nothing until the flight begins."""
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe()
    process = spawn.Process(target=serve, args=(config, theirs), name="sim-cameras", daemon=True)
    process.start()
    assert ours.poll(patience_s), "the simulated cameras do not come up"
    ours.recv()
    return process, ours
