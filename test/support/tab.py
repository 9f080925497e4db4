"""A tab of a real browser that a test clicks and types in, by the protocol that Chromium's own tools speak.

https://chromedevtools.github.io/devtools-protocol: a message is an object with an ``id``, ``method`` and ``params``; the answer has
the same ``id``, and what happens comes without one.
"""

from __future__ import annotations

import base64
import json
import subprocess
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from support.browser import BROWSER, QUIET
from support.waiting import wait_for

PATIENCE_S = 120.0
"""Whoever waits longer waits for nothing; a busy computer is slow."""
GL = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--remote-debugging-port=0"]
"""Three dimensions without a graphics card."""

PICK = """(() => {
  const it = [...document.querySelectorAll("button, a, [role=button], [role=switch], summary, label")].filter((it) =>
    it.innerText.trim().startsWith(%s) && it.getClientRects().length && !it.disabled)[0];
  if (!it) return null;
  it.scrollIntoView({block: "center"});
  const box = it.getBoundingClientRect(), at = [box.x + box.width / 2, box.y + box.height / 2];
  return it.contains(document.elementFromPoint(...at)) ? at : null;
})()"""
"""Where one would click; null while nothing is there, or something lies over it."""
MOST_TABS = 80
MOST_CHOICES = 40
DRAG = """(() => {
  const data = new DataTransfer(), from = document.querySelector(%s), to = document.querySelector(%s);
  const say = (it, kind) => it.dispatchEvent(new DragEvent(kind, {dataTransfer: data, bubbles: true, cancelable: true}));
  say(from, "dragstart");
  if (say(to, "dragover")) throw "nothing may be dropped there";
  say(to, "drop");
})()"""
STILL = """await (async (at) => {
  await new Promise((done) => setTimeout(done, 200));
  return String(at) === String(%s);
})(window.proprioAt)"""


class Tab:
    """One tab.

    Attributes:
        requests: Addresses that it has asked for.
    """

    def __init__(self, address: str) -> None:
        from websockets.sync.client import connect

        self._opened = ExitStack()
        self._socket = self._opened.enter_context(
            connect(address, max_size=None, ping_interval=None)
        )
        self._number = 0
        self.requests: list[str] = []
        self.said: list[str] = []
        for domain in ("Page", "Runtime", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """What the browser answers."""
        self._number += 1
        asked = {"id": self._number, "method": method, "params": params}
        self._socket.send(json.dumps(asked))
        while True:
            message = json.loads(self._socket.recv(PATIENCE_S))
            self._hear(message)
            if message.get("id") == self._number:
                assert "error" not in message, message
                return dict(message["result"])

    def _hear(self, message: dict[str, Any]) -> None:
        if message.get("method") == "Network.requestWillBeSent":
            self.requests.append(message["params"]["request"]["url"])
        elif message.get("method") == "Network.webSocketCreated":
            self.requests.append(message["params"]["url"])
        elif message.get("method") == "Runtime.exceptionThrown":
            self.said.append(json.dumps(message["params"])[:500])

    def does(self, script: str) -> Any:
        """The value of an expression."""
        found = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def open(self, address: str) -> None:
        """Go there."""
        self.call("Page.navigate", url=address)
        self.until("document.readyState === 'complete' && window.socket && window.socket.connected")

    def until(self, script: str) -> None:
        """Wait until an expression is true."""
        tried = f"(async () => {{ try {{ return !!({script}) }} catch {{ return false }} }})()"
        assert wait_for(lambda: self.does(tried), PATIENCE_S), (
            f"never: {script}; {self.text[-1500:]}"
        )

    def shows(self, words: str) -> None:
        """Wait until words stand on the page."""
        self.until(f"document.body.innerText.includes({json.dumps(words)})")

    @property
    def text(self) -> str:
        """All that stands there."""
        return str(self.does("document.body.innerText"))

    def click(self, words: str) -> None:
        """What has this text, once it can be clicked: by the mouse, at its middle."""
        found = PICK % json.dumps(words)
        # what opens moves for a while
        self.until(f"(window.proprioAt = {found}) && {STILL % found}")
        box = self.does("window.proprioAt")
        for kind in ("mousePressed", "mouseReleased"):
            self.call(
                "Input.dispatchMouseEvent",
                type=kind, x=box[0], y=box[1], button="left", clickCount=1,
            )  # fmt: skip

    def drag(self, what: str, where: str) -> None:
        """What a selector finds, to where another does: what the page would hear of a mouse."""
        self.does(DRAG % (json.dumps(what), json.dumps(where)))

    def choose(self, box: str, words: str) -> None:
        """In a box of this name, what begins with these words; by the arrow key."""
        found = f"document.querySelector({json.dumps(f'select[aria-label={json.dumps(box)}]')})"
        self.until(f"({found}.focus(), document.activeElement === {found})")
        for _ in range(MOST_CHOICES):
            if str(self.does(f"{found}.selectedOptions[0].text")).startswith(words):
                return
            self.press("ArrowDown")
        raise AssertionError(f"{box}: no {words!r}")

    def press(self, key: str, code: str = "", text: str = "") -> None:
        """A key, down and up."""
        number = {"Tab": 9, "Enter": 13, " ": 32, "ArrowDown": 40}.get(key, ord(key[0]))
        which = {"key": key, "code": code or key, "windowsVirtualKeyCode": number}
        written = {"text": text} if text else {}
        self.call("Input.dispatchKeyEvent", type="keyDown", **which, **written)
        self.call("Input.dispatchKeyEvent", type="keyUp", **which)

    def focus(self, words: str) -> None:
        """By the Tab key alone, to what begins with these words or is called so."""
        names = (
            "[document.activeElement.getAttribute('aria-label'), document.activeElement.innerText]"
        )
        for _ in range(MOST_TABS):
            self.press("Tab")
            if any(str(name or "").strip().startswith(words) for name in self.does(names)):
                return
        raise AssertionError(f"no key leads to {words!r}: {self.text[-1500:]}")

    def look(self, width: int, height: int = 900, dark: bool = False) -> None:
        """Be so wide [px], dark or light."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=False,
        )  # fmt: skip
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])

    def picture(self, path: Path) -> None:
        """What is seen, as PNG."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot")["data"]))

    def close(self) -> None:
        """As a user closes it."""
        self.call("Page.close")
        self._opened.close()


class Browser:
    """Chromium without a window; `tab` opens one more."""

    def __init__(self, port: int) -> None:
        self._port = port

    def tab(self, kind: type[Tab] = Tab) -> Tab:
        """A new one."""
        asked = urllib.request.Request(
            f"http://127.0.0.1:{self._port}/json/new?about:blank", method="PUT"
        )
        with urllib.request.urlopen(asked) as answer:
            return kind(json.load(answer)["webSocketDebuggerUrl"])


@contextmanager
def browser(folder: Path) -> Iterator[Browser]:
    """Chromium as a process with a profile of its own."""
    assert BROWSER is not None
    profile = folder / "profile"
    # what may be asked for is seen by the tests; this computer's own address has to be found
    quiet = [word for word in QUIET if "host-resolver" not in word]
    process = subprocess.Popen(
        [BROWSER, *quiet, *GL, f"--user-data-dir={profile}", "about:blank"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        told = profile / "DevToolsActivePort"
        assert wait_for(lambda: told.exists() and told.read_text().strip(), PATIENCE_S)
        yield Browser(int(told.read_text().split()[0]))
    finally:
        process.terminate()
        process.wait()
