"""A headless browser for tests: chromedriver spoken to over HTTP, with nothing but the standard library."""

from __future__ import annotations

import base64
import json
import shutil
import socket
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip


def missing() -> str:
    """What is not installed; "" if all is there."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    parts = {"chromium": chromium, "chromedriver": shutil.which("chromedriver")}
    return ", ".join(name for name, path in parts.items() if path is None)


# Scripts for `Browser.run`. The first takes a width in px; it and the second list elements at fault, the
# third all sizes of letters in px.
OVERFLOWING = """
const limit = arguments[0] + 1;
const scrolls = e => e && (['auto', 'scroll', 'hidden'].includes(getComputedStyle(e).overflowX)
  || scrolls(e.parentElement));
return [...document.querySelectorAll('body *')]
  .filter(e => e.getBoundingClientRect().right > limit && !e.closest('thead, svg'))
  .filter(e => !scrolls(e.parentElement))
  .map(e => e.tagName + '.' + e.getAttribute('class')).slice(0, 5);
"""
LOW_CONTRAST = """
const rgb = s => s.match(/[\\d.]+/g).map(Number);
const linear = v => (v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
const light = c => 0.2126 * linear(c[0]) + 0.7152 * linear(c[1]) + 0.0722 * linear(c[2]);
const ground = e => {
  for (; e; e = e.parentElement) {
    const c = rgb(getComputedStyle(e).backgroundColor);
    if (c.length < 4 || c[3] === 1) return c;
  }
  return [255, 255, 255];
};
const ratio = e => {
  const [a, b] = [light(rgb(getComputedStyle(e).color)), light(ground(e))];
  return (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
};
return [...document.querySelectorAll('body *')].filter(e => !e.closest('svg')
    && [...e.childNodes].some(n => n.nodeType === 3 && n.textContent.trim()))
  .map(e => [ratio(e), e.tagName + '.' + e.className]).filter(([value]) => value < 4.5).slice(0, 5);
"""
SIZES = """
const shrunk = e => {
  const svg = e.closest('svg'), box = svg && svg.getAttribute('viewBox');
  return box ? svg.getBoundingClientRect().width / box.split(' ')[2] : 1;
};
return [...document.querySelectorAll('body *')]
  .filter(e => [...e.childNodes].some(n => n.nodeType === 3 && n.textContent.trim()))
  .filter(e => e.getBoundingClientRect().width > 0)
  .map(e => parseFloat(getComputedStyle(e).fontSize) * shrunk(e));
"""


class Browser:
    """One window."""

    def __init__(self, session: str) -> None:
        self.session = session

    def call(self, path: str, body: dict[str, Any]) -> Any:
        return post(f"{self.session}/{path}", body)

    def cdp(self, command: str, **parameters: Any) -> Any:
        """A command of the developer tools."""
        return self.call("goog/cdp/execute", {"cmd": command, "params": parameters})

    def open(self, path: Path, width: int = 1280, dark: bool = False) -> None:
        """Open a file in a window of this width, after a clean slate of logs."""
        self.cdp("Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1,
                 mobile=width < 600)  # fmt: skip
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.cdp("Emulation.setEmulatedMedia", features=[scheme])
        for kind in ("browser", "performance"):
            self.call("se/log", {"type": kind})
        self.call("url", {"url": path.resolve().as_uri()})

    def run(self, script: str, *arguments: Any) -> Any:
        """What a script returns."""
        return self.call("execute/sync", {"script": script, "args": arguments})

    def console(self) -> list[str]:
        """What the page has told the console."""
        return [entry["message"] for entry in self.call("se/log", {"type": "browser"})]

    def requests(self) -> list[str]:
        """Addresses that the page has asked for."""
        entries = self.call("se/log", {"type": "performance"})
        events = [json.loads(entry["message"])["message"] for entry in entries]
        sent = [event["params"] for event in events if event["method"] == "Network.requestWillBeSent"]
        return [each["request"]["url"] for each in sent]

    def picture(self, file: Path, whole: bool = True) -> None:
        """A picture of the page as it is now."""
        shot = self.cdp("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        file.write_bytes(base64.b64decode(shot["data"]))


def post(url: str, body: dict[str, Any]) -> Any:
    request = urllib.request.Request(url, json.dumps(body).encode(), {"Content-Type": "application/json"})
    with urllib.request.urlopen(request, timeout=60) as answer:
        return json.loads(answer.read())["value"]


@contextmanager
def browser(profile: Path) -> Iterator[Browser]:
    """A browser with a fresh profile, ended afterwards."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    driver = subprocess.Popen(
        ["chromedriver", f"--port={port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    root = f"http://127.0.0.1:{port}"
    try:
        options = {"args": [*FLAGS, f"--user-data-dir={profile}"]}
        if chromium := shutil.which("chromium") or shutil.which("chromium-browser"):
            options["binary"] = chromium
        wanted = {
            "browserName": "chrome",
            "goog:chromeOptions": options,
            "goog:loggingPrefs": {"browser": "ALL", "performance": "ALL"},
        }
        for attempt in range(100):
            try:
                made = post(f"{root}/session", {"capabilities": {"alwaysMatch": wanted}})
                break
            except (ConnectionError, urllib.error.URLError):
                if attempt == 99:
                    raise
                time.sleep(0.1)
        session = f"{root}/session/{made['sessionId']}"
        yield Browser(session)
        with urllib.request.urlopen(urllib.request.Request(session, method="DELETE"), timeout=30):
            pass
    finally:
        driver.terminate()
        driver.wait(10)
