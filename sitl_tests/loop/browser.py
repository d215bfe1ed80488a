"""A headless Chromium, spoken to over a pipe by the DevTools protocol: no driver and no library."""

from __future__ import annotations

import base64
import fcntl
import json
import os
import select
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_ANSWER_S = 30.0
_HIGH = 100  # descriptors that are free


def browser_path() -> str | None:
    return next((path for path in map(shutil.which, BROWSERS) if path is not None), None)


class Browser:
    """One window with one page. A context manager."""

    def __init__(self, width_px: int, height_px: int) -> None:
        path = browser_path()
        assert path is not None
        self._folder = tempfile.TemporaryDirectory(
            prefix="browser-", ignore_cleanup_errors=True
        )  # it writes while it ends
        theirs_in, ours_out = os.pipe()
        ours_in, theirs_out = os.pipe()
        high = [fcntl.fcntl(end, fcntl.F_DUPFD, _HIGH) for end in (theirs_in, theirs_out)]

        def as_the_browser_wants() -> None:
            for number, end in zip((3, 4), high, strict=True):  # descriptors of the protocol's pipe
                os.dup2(end, number)

        words = [
            path, "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--mute-audio",
            f"--user-data-dir={self._folder.name}", "--remote-debugging-pipe", f"--window-size={width_px},{height_px}",
        ]  # fmt: skip
        self._process = subprocess.Popen(
            words, preexec_fn=as_the_browser_wants, pass_fds=(3, 4),
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        for end in (theirs_in, theirs_out, *high):
            os.close(end)
        self._in, self._out = ours_in, ours_out
        self._buffer = b""
        self._number = 0
        self._session: str | None = None
        self.complaints: list[str] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        size = {"width": width_px, "height": height_px, "deviceScaleFactor": 1, "mobile": width_px < 600}
        self.call("Emulation.setDeviceMetricsOverride", **size)
        self.call("Emulation.setScrollbarsHidden", hidden=True)  # a picture of all of a page is as wide as the page
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait(10)
        os.close(self._in)
        os.close(self._out)
        self._folder.cleanup()

    def call(self, method: str, **parameters: Any) -> Any:
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._receive()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer["error"]
                return answer["result"]
            self._note(answer)

    def open(self, url: str) -> None:
        self.call("Page.navigate", url=url)

    def value(self, expression: str) -> Any:
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def until(self, expression: str, within_s: float = 30.0) -> Any:
        """Wait until an expression of the page is true."""
        ends_s = time.monotonic() + within_s
        while time.monotonic() < ends_s:
            value = self.value(expression)
            if value:
                return value
            time.sleep(0.2)
        raise AssertionError(f"never true within {within_s} s: {expression}; said: {self.complaints}")

    def screenshot(self, path: Path, *, full_page: bool = True) -> None:
        picture = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=full_page)["data"]
        path.write_bytes(base64.b64decode(picture))

    def _receive(self) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            assert select.select([self._in], [], [], _ANSWER_S)[0], "the browser does not answer"
            piece = os.read(self._in, 1 << 16)
            assert piece, "the browser has ended"
            self._buffer += piece
        message, _, self._buffer = self._buffer.partition(b"\0")
        content: dict[str, Any] = json.loads(message)
        return content

    def _note(self, event: dict[str, Any]) -> None:
        if event.get("method") == "Runtime.exceptionThrown":
            self.complaints.append(str(event["params"]["exceptionDetails"])[:600])
        elif event.get("method") == "Log.entryAdded" and event["params"]["entry"]["level"] == "error":
            entry = event["params"]["entry"]
            self.complaints.append(f"{entry['text']} {entry.get('url', '')}"[:600])
