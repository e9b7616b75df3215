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
# Texts that stand on each other, of all that can be seen but the line of links, which floats.
OVERLAPPING = """
const boxes = [];
const walker = document.createTreeWalker(document.querySelector('body'), NodeFilter.SHOW_TEXT);
for (let node = walker.nextNode(); node; node = walker.nextNode()) {
  const parent = node.parentElement;
  if (!node.textContent.trim() || parent.closest('nav, script, style, option')) continue;
  if (getComputedStyle(parent.closest('thead') || parent).position === 'absolute') continue;
  const range = document.createRange();
  range.selectNodeContents(node);
  for (const r of range.getClientRects()) {
    const seen = r.width > 1 && r.height > 1;
    if (seen) boxes.push([r.left, r.top, r.right, r.bottom, node.textContent.trim().slice(0, 30)]);
  }
}
boxes.sort((a, b) => a[1] - b[1]);
const found = [];
boxes.forEach((a, i) => {
  for (let j = i + 1; j < boxes.length && boxes[j][1] < a[3] - 4; j++) {
    const b = boxes[j];
    if (Math.min(a[2], b[2]) - Math.max(a[0], b[0]) > 1) found.push(a[4] + ' | ' + b[4]);
  }
});
return found.slice(0, 5);
"""
# The same of the letters within each figure, at its natural size. A text twice at one place looks like one.
OVERLAPPING_IN_FIGURES = """
const found = [];
for (const image of document.images) {
  const holder = document.createElement('div');
  holder.style.cssText = 'position:absolute;left:0;top:0';
  holder.innerHTML = atob(image.src.split('base64,')[1]).replace(/^[^]*?<svg/, '<svg');
  document.body.append(holder);
  const boxes = [...holder.querySelectorAll('g[id^=text_]')].map(g => [g.getBoundingClientRect(), g.id]);
  boxes.forEach(([a, one], i) => boxes.slice(i + 1).forEach(([b, other]) => {
    if (Math.min(a.right, b.right) - Math.max(a.left, b.left) > 0.5
        && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 0.5
        && ['left', 'top', 'right', 'bottom'].some(side => Math.abs(a[side] - b[side]) > 0.1))
      found.push(image.alt.slice(0, 20) + ': ' + one + ' | ' + other);
  }));
  holder.remove();
}
return found.slice(0, 8);
"""
# Headings of tables whose text does not stand over that of their column, on the side where the column stands.
OUT_OF_LINE = """
const side = (cell, right) => {
  const range = document.createRange();
  range.selectNodeContents(cell);
  const boxes = [...range.getClientRects()].filter(r => r.width > 1);
  return right ? Math.max(...boxes.map(r => r.right)) : Math.min(...boxes.map(r => r.left));
};
const found = [];
for (const table of document.querySelectorAll('table.rows')) {
  const row = [...table.querySelectorAll('tbody tr:not(.group)')][0];
  if (!row || !row.getClientRects().length) continue;
  [...table.tHead.rows[0].cells].forEach((head, k) => {
    const cell = row.cells[k], right = getComputedStyle(cell).textAlign === 'right';
    const apart = Math.abs(side(head, right) - side(cell, right));
    if (cell.textContent.trim() && apart > 1.5) found.push(head.textContent + ': ' + apart);
  });
}
return found.slice(0, 5);
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

    def open(self, path: Path, width: int = 1280, dark: bool = False, scripts: bool = True) -> None:
        """Open a file in a window of this width, with or without its scripts, after a clean slate of logs."""
        self.cdp("Emulation.setScriptExecutionDisabled", value=not scripts)
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
