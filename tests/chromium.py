"""A browser without a screen, driven by its DevTools protocol; and what is wrong with pages for people.

That is for those who hear them, enlarge them, use a keyboard alone or read on a phone.
"""

import base64
import io
import json
import shutil
import subprocess
import tempfile
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import axe_core_python
import numpy as np
import pytest
from PIL import Image

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = [
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-first-run",
    "--remote-debugging-port=0",
]


class Tab:
    """One page of a browser: what it asks for, what it says, how it looks."""

    def __init__(self, socket):
        self._socket, self._number = socket, 0
        self.errors, self.requests = [], []
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._call(f"{domain}.enable")

    def _call(self, method, **parameters):
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=300))
            if message.get("id") == self._number:
                assert "error" not in message, message
                return message["result"]
            self._take(message)

    def _take(self, message):
        answer, parameters = message.get("method"), message.get("params", {})
        if answer == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(parameters["exceptionDetails"])[:400])
        elif answer == "Runtime.consoleAPICalled" and parameters["type"] in ("error", "assert"):
            self.errors.append(json.dumps(parameters["args"])[:400])
        elif answer == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.errors.append(json.dumps(parameters["entry"])[:400])
        elif answer in ("Network.requestWillBeSent", "Network.webSocketCreated"):
            self.requests.append(parameters.get("url") or parameters["request"]["url"])

    def resize(self, width_px, height_px):
        self._call(
            "Emulation.setDeviceMetricsOverride", width=width_px, height=height_px, deviceScaleFactor=1, mobile=False
        )

    def prefer(self, scheme):
        """Ask for a light or a dark page."""
        self._call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])

    def open(self, url):
        self._call("Page.navigate", url=url)

    def ask(self, script):
        """The value of an expression of JavaScript; promises are awaited."""
        answer = self._call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def until(self, script, seconds=120.0):
        """Wait until an expression is true; its value."""
        end = time.monotonic() + seconds
        while not (value := self.ask(script)):
            assert time.monotonic() < end, f"not within {seconds} s: {script}; errors: {self.errors}"
            time.sleep(0.1)
        return value

    def picture(self):
        shot = self._call("Page.captureScreenshot", format="png")
        return np.array(Image.open(io.BytesIO(base64.b64decode(shot["data"]))).convert("RGB"))

    def press(self, key, code):
        for kind in ("rawKeyDown", "keyUp"):
            self._call("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code)


@contextmanager
def tab(url, width_px=1280, height_px=800):
    """Open a page in a fresh browser."""
    from websockets.sync.client import connect

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        words = [BROWSER, *FLAGS, f"--user-data-dir={profile}", "about:blank"]
        # What it says goes nowhere: a pipe that nobody empties would stop it.
        browser = subprocess.Popen(words, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        try:
            port = _port_of(browser, Path(profile))
            with connect(_page_of(port), max_size=None, open_timeout=120, ping_interval=None) as socket:
                page = Tab(socket)
                page.resize(width_px, height_px)
                page.open(url)
                yield page
        finally:
            browser.terminate()
            try:
                browser.wait(timeout=60)
            except subprocess.TimeoutExpired:
                browser.kill()
                browser.wait()


def _port_of(browser, profile):
    """The port that a browser writes into its profile once it listens there."""
    while browser.poll() is None:
        with suppress(FileNotFoundError, IndexError, ValueError):
            return int((profile / "DevToolsActivePort").read_text("ascii").splitlines()[0])
        time.sleep(0.05)
    raise AssertionError(f"the browser did not start: it ended with {browser.returncode}")


def _page_of(port):
    from urllib.request import urlopen

    with urlopen(f"http://127.0.0.1:{port}/json/list", timeout=120) as answer:
        return next(each["webSocketDebuggerUrl"] for each in json.load(answer) if each["type"] == "page")


AXE = Path(axe_core_python.__file__).with_name("axe.min.js").read_text("utf-8")
SERIOUS = ("serious", "critical")
NODES = "nodes: each.nodes.map(node => node.html)"
RUN = f"axe.run().then(found => found.violations.map(each => ({{impact: each.impact, rule: each.id, {NODES}}})))"
TOO_WIDE = "document.documentElement.scrollWidth > document.documentElement.clientWidth"

PAGES = pytest.mark.parametrize(("width_px", "scheme"), [(1280, "light"), (400, "dark")])
in_browser = pytest.mark.skipif(BROWSER is None, reason="no chromium is installed")


def faults_of(pages, width_px=1280, scheme="light"):
    """What axe-core calls serious or critical in HTML files, and files that are wider than the window."""
    faults = []
    with tab("about:blank", width_px) as browser:
        browser.prefer(scheme)
        for page in pages:
            browser.open(page.as_uri())
            browser.until(f"location.href == {page.as_uri()!r} && document.readyState == 'complete'")
            if browser.ask(TOO_WIDE):
                faults.append(f"{page.name} is wider than {width_px} px")
            browser.ask(f"{AXE}; 0")
            for found in browser.ask(RUN):
                if found["impact"] in SERIOUS:
                    nodes = found["nodes"]
                    faults.append(f"{page.name}: {found['rule']}, {len(nodes)} times, as {nodes[0][:200]}")
    return faults
