"""A page in headless Chromium; tests that need it are skipped if it is missing."""

import json
import os
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path

from helpers.processes import HANG_S

BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
AXE_TAGS = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
AXE = Path(__file__).parents[1] / "data/axe/axe.min.js"  # what keyboards and screen readers need
MIN_TEXT_PX = 12
FLAGS = ("headless", "no-sandbox", "no-first-run", "window-size=1600,1200", "enable-logging=stderr")
DISABLED = (
    "background-networking",
    "component-update",
    "sync",
    "extensions",
    "default-apps",
    "quic",
    "gpu",
)


class Tab:
    """A page in a running Chromium, driven by its protocol of debugging; its console must stay
    empty.
    """

    def __init__(self, folder: Path) -> None:
        from websockets.sync.client import connect

        profile = folder / "profile"
        flags = [
            *FLAGS,
            f"user-data-dir={profile}",
            "remote-debugging-port=0",
            *(f"disable-{name}" for name in DISABLED),
        ]
        own = {name: value for name, value in os.environ.items() if not name.startswith("XDG_")} | {
            "HOME": str(profile)
        }
        command = [str(BROWSER), *(f"--{flag}" for flag in flags), "about:blank"]
        self.process = subprocess.Popen(
            command, env=own, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        told, self.number = profile / "DevToolsActivePort", 0
        self.wait(lambda: told.exists() and told.read_text().count("\n"))
        with urllib.request.urlopen(
            f"http://127.0.0.1:{told.read_text().split()[0]}/json"
        ) as listed:
            address = next(
                each["webSocketDebuggerUrl"] for each in json.load(listed) if each["type"] == "page"
            )
        self.connecting = connect(address, max_size=None)
        self.socket = self.connecting.__enter__()
        self.call("Runtime.enable")
        self.call("Log.enable")

    def call(self, method: str, **parameters):
        self.number += 1
        self.socket.send(json.dumps({"id": self.number, "method": method, "params": parameters}))
        while (answer := json.loads(self.socket.recv(timeout=HANG_S))).get("id") != self.number:
            assert answer["method"] not in (
                "Runtime.exceptionThrown",
                "Runtime.consoleAPICalled",
                "Log.entryAdded",
            ), answer
        assert "error" not in answer, answer
        return answer["result"]

    def value(self, script: str):
        """The value of an expression of JavaScript, or that of its promise."""
        found = self.call(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def press(self, key: str) -> None:
        for kind in ("rawKeyDown", "keyUp"):
            self.call(
                "Input.dispatchKeyEvent",
                type=kind,
                key=key,
                code=key,
                windowsVirtualKeyCode=KEY_CODES[key],
            )

    @staticmethod
    def wait(is_so: Callable[[], object]) -> None:
        deadline = time.monotonic() + HANG_S
        while not is_so():
            assert time.monotonic() < deadline, "it takes too long"
            time.sleep(0.05)

    def close(self) -> None:
        self.call("Browser.close")  # which clears its temporary files, as a signal would not
        self.process.wait(HANG_S)
        self.connecting.__exit__(None, None, None)


KEY_CODES = {"ArrowRight": 39, "ArrowLeft": 37, "Tab": 9, "Enter": 13, "Home": 36}
