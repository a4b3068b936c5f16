"""Take the pictures of ``docs/reference/station.md``: the page in Chromium, with the simulated helicopter in flight.

    python docs/make_station_images.py [--out docs/images]

Needs Chromium and Playwright.
"""

from __future__ import annotations

import argparse
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page, sync_playwright

FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
LARGE, TABLET = (1366, 768), (820, 1180)


def free_port() -> int:
    """Return a port that nobody uses."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def running(*words: str) -> Iterator[str]:
    """Run ``mufly`` with a page; yields the page's address."""
    port = free_port()
    command = [sys.executable, "-c", "from mufly.cli import main; main()", *words]
    process = subprocess.Popen(
        [*command, "--no-browser", "--port", str(port)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        while socket.socket().connect_ex(("127.0.0.1", port)):
            if process.poll() is not None:
                raise SystemExit(f"mufly {' '.join(words)} did not start")
            time.sleep(0.2)
        yield f"http://127.0.0.1:{port}/"
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(30)


def wait(condition: Callable[[], Any], seconds: float = 90.0) -> None:
    """Wait for something to become true."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise SystemExit("waited too long")
        time.sleep(0.1)


def window(browser: Browser, url: str, dark: bool, size: tuple[int, int] = LARGE) -> Page:
    """Open the page and wait for what it shows."""
    page = browser.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme="dark" if dark else "light")
    page.goto(url)
    page.wait_for_function("window.muflyLive?.latest?.s?.position[0] != null", timeout=60_000)
    page.wait_for_function("Boolean(window.muflyScene)")
    page.wait_for_timeout(1500)
    return page


def state(page: Page) -> dict[str, Any]:
    """Return what the page knows of the vehicle."""
    found: dict[str, Any] = page.evaluate("window.muflyLive.latest.s")
    return found


def look(page: Page, x: float, y: float, z: float) -> None:
    """Put the camera east, up and south of what it follows (m)."""
    page.evaluate(
        f"(() => {{ const {{ camera, controls }} = window.muflyScene; "
        f"camera.position.copy(controls.target).add({{ x: {x}, y: {y}, z: {z} }}); controls.update(); }})()"
    )


def shoot(page: Page, path: Path) -> None:
    """Write a picture, with the pointer out of the way."""
    page.mouse.move(5, page.viewport_size["height"] - 3 if page.viewport_size else 5)
    page.wait_for_timeout(1000)
    page.screenshot(path=path)
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


def main() -> None:
    """Take all pictures."""
    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("--out", type=Path, default=Path(__file__).parent / "images")
    out = words.parse_args().out
    folder = Path(tempfile.mkdtemp())
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=chromium, args=FLAGS)
        with running("fly", "box-on-leg", "--out", str(folder / "flight")) as url:
            page = window(browser, url, dark=True)
            shoot(page, out / "station-ready.png")
            page.click("[data-testid=mission]")
            wait(lambda: state(page)["state"] == "obstacle")
            wait(lambda: state(page)["position"][0] > 1.3)
            page.get_by_role("tab", name="Mission").click()
            look(page, 2.6, 2.2, 3.2)
            page.wait_for_timeout(600)
            shoot(page, out / "station-dark.png")
            light = window(browser, url, dark=False)
            light.get_by_role("tab", name="Messages").click()
            look(light, 2.6, 2.2, 3.2)
            light.wait_for_timeout(4000)
            shoot(light, out / "station-light.png")
            light.close()
            page.get_by_role("tab", name="Spectrum").click()
            page.wait_for_timeout(2000)
            shoot(page, out / "station-spectrum.png")
            page.get_by_role("tab", name="Parameters").click()
            page.wait_for_timeout(800)
            field = page.locator("[data-name=AVD_CLEARANCE]")
            field.fill("0.42")
            field.press("Enter")
            page.wait_for_timeout(1500)
            page.get_by_role("tab", name="Messages").click()
            shoot(page, out / "station-parameters.png")
            tablet = window(browser, url, dark=True, size=TABLET)
            tablet.wait_for_timeout(3000)
            shoot(tablet, out / "station-tablet.png")
            tablet.close()
            wait(lambda: not state(page)["armed"])
            page.close()
        with running("fly", "--position", "camera", "--out", str(folder / "camera")) as url:
            page = window(browser, url, dark=True)
            page.click("[data-testid=mission]")
            wait(lambda: state(page)["position"][0] > 1.5, 400.0)
            shoot(page, out / "station-camera.png")
            page.close()
        with running("station", "--open", str(folder / "flight" / "flight.mcap"), "--out", str(folder)) as url:
            page = window(browser, url, dark=False)
            end = float(page.locator("[data-testid=replay-slider]").get_attribute("max") or 0)
            page.locator("[data-testid=replay-slider]").evaluate(
                f"e => {{ e.value = {0.62 * end}; e.dispatchEvent(new Event('input')); }}"
            )
            page.locator("[data-testid=replay-slider]").evaluate("e => e.dispatchEvent(new Event('change'))")
            page.wait_for_timeout(1500)
            look(page, -2.4, 2.4, 3.4)
            shoot(page, out / "station-recording.png")
        browser.close()


if __name__ == "__main__":
    main()
