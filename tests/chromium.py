"""A Chromium that a test drives: pages opened, the mouse used, pictures taken."""

from __future__ import annotations

import asyncio
import base64
import json
import shutil
import subprocess
import time
import urllib.request
from importlib.resources import files
from pathlib import Path
from typing import Any


BROWSER = next(
    (b for b in ("chromium", "chromium-browser", "google-chrome", "chrome") if shutil.which(b)),
    None,
)
#: Sizes of a window: a desk's and a phone's.
DESKTOP, PHONE = (1280, 900), (390, 844)

#: What axe-core finds, short enough to be read.
AUDIT = """
axe.run(document, {resultTypes: ["violations"]}).then(found => ({
  rules: found.passes.length,
  violations: found.violations.map(
    v => [v.id, v.impact, v.help, v.nodes.slice(0, 3).map(n => n.html.slice(0, 200))])}))
"""


class Chromium:
    """One page of a browser without a window, by Chromium's own protocol (DevTools)."""

    def __init__(self, folder: Path, size: tuple[int, int] = DESKTOP):
        assert BROWSER is not None
        self._loop = asyncio.new_event_loop()
        profile = folder / "driven"
        command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
        command += ["--remote-debugging-port=0", f"--user-data-dir={profile}"]
        command += [f"--window-size={size[0]},{size[1]}", "about:blank"]
        self._process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self._size, self._asked = size, 0
        try:
            self._socket = self._loop.run_until_complete(self._connected(profile))
            self.ask("Page.enable")
            self.ask("Page.setBypassCSP", enabled=True)  # a page refuses scripts, axe is one
            metrics = {"width": size[0], "height": size[1], "deviceScaleFactor": 1}
            self.ask("Emulation.setDeviceMetricsOverride", mobile=size[0] < 600, **metrics)
        except BaseException:
            self._process.kill()
            raise

    async def _connected(self, profile: Path, seconds: float = 90.0) -> Any:
        from tornado.websocket import websocket_connect

        port, until = profile / "DevToolsActivePort", time.monotonic() + seconds
        while not port.is_file() or not port.read_text().strip():
            assert time.monotonic() < until, "Chromium does not start"
            await asyncio.sleep(0.1)
        address = f"http://127.0.0.1:{port.read_text().split()[0]}/json"
        while True:
            with urllib.request.urlopen(address) as answer:
                pages = [p for p in json.loads(answer.read()) if p["type"] == "page"]
            if pages:
                return await websocket_connect(
                    pages[0]["webSocketDebuggerUrl"], max_message_size=2**28
                )
            await asyncio.sleep(0.1)

    def __enter__(self) -> Chromium:
        return self

    async def _closed(self) -> None:
        self._socket.close()

    def __exit__(self, *_: object) -> None:
        self._loop.run_until_complete(self._closed())  # it asks for the loop that runs
        self._process.terminate()
        self._process.wait(30)
        self._loop.close()

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """What the browser answers to a command of its protocol."""
        self._asked += 1
        words = json.dumps({"id": self._asked, "method": method, "params": parameters})
        return self._loop.run_until_complete(self._answered(words, self._asked))

    async def _answered(self, words: str, number: int) -> dict[str, Any]:
        await self._socket.write_message(words)
        while True:
            text = await self._socket.read_message()
            assert text is not None, "Chromium has ended"
            found = json.loads(text)
            if found.get("id") == number:
                assert "error" not in found, found
                return found["result"]

    def open(self, address: str) -> None:
        self.ask("Page.navigate", url=address)

    def shown(self, address: str) -> None:
        """Opens a page and waits until all of it is there."""
        self.open(address)
        there = f"location.href === {json.dumps(address)}"
        self.wait(f"{there} && document.readyState === 'complete'")

    def evaluate(self, script: str) -> Any:
        """The value of an expression on the page."""
        found = self.ask(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def wait(self, script: str, seconds: float = 120.0) -> Any:
        """The value of an expression once it is true; before the page is there it may fail."""
        until = time.monotonic() + seconds
        guarded = f"(() => {{ try {{ return {script.strip()} }} catch (e) {{ return null }} }})()"
        while not (value := self.evaluate(guarded)):
            assert time.monotonic() < until, f"never true: {script}"
            time.sleep(0.2)
        return value

    def settled(self, script: str, still: int = 5) -> Any:
        """The value of an expression once it has been the same this many times, 0.2 s apart: a page
        that is still laid out moves under the mouse.
        """
        seen = [self.evaluate(script)]
        while len(seen) < still or any(value != seen[-1] for value in seen[-still:]):
            time.sleep(0.2)
            seen.append(self.evaluate(script))
            assert len(seen) < 600, f"never still: {script}"
        return seen[-1]

    def violations(self) -> list[Any]:
        """What axe-core finds on the page: rule, how bad, what it asks for, first elements."""
        axe = (files("axe_core_python") / "axe.min.js").read_text(encoding="utf-8")
        self.evaluate(f"{axe}; true")
        found = self.evaluate(AUDIT)
        assert found["rules"] > 10, "axe has looked at next to nothing"
        return found["violations"]

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """The mouse pressed at one place of the window and let go at another."""
        steps = [(start, "mousePressed")]
        for k in range(1, 6):
            share = k / 5
            place = (start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1]))
            steps.append((place, "mouseMoved"))
        steps.append((end, "mouseReleased"))
        self._mouse(start, "mouseMoved", 0)
        for place, kind in steps:
            self._mouse(place, kind, 0 if kind == "mouseReleased" else 1)

    def click(self, selector: str) -> None:
        """The mouse clicked on the first element of a selector."""
        script = (
            f"(e => {{ e.scrollIntoView({{block: 'center'}}); const r = e.getBoundingClientRect();"
            " return [r.x + r.width / 2, r.y + r.height / 2]; })"
            f"(document.querySelector({json.dumps(selector)}))"
        )
        x, y = self.evaluate(script)
        self.drag((x, y), (x, y))

    def _mouse(self, place: tuple[float, ...], kind: str, buttons: int) -> None:
        button = "none" if kind == "mouseMoved" and not buttons else "left"
        self.ask(
            "Input.dispatchMouseEvent",
            type=kind,
            x=place[0],
            y=place[1],
            button=button,
            buttons=buttons,
            clickCount=1,
        )

    def picture(self, path: Path) -> Path:
        """The whole page as PNG."""
        found = self.ask("Page.captureScreenshot", format="png", captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(found["data"]))
        return path
