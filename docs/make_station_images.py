"""Make the pictures of the ground station: the page in Chromium, with the simulated helicopter in flight.

    python docs/make_station_images.py [--out docs/images] [--only film|box|camera ...]

``film`` records an animated WebP of the demonstration flight for the README. ``box`` and ``camera`` take the pictures
of ``docs/reference/station.md``. The script needs Chromium and Playwright.
"""

from __future__ import annotations

import argparse
import io
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import Browser, Page, TimeoutError, sync_playwright

FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
LARGE, TABLET = (1366, 768), (820, 1180)
FILM_SIZE, FILM_FRAMES, FILM_FRAME_s = (960, 540), 64, 0.125
FILM_START_s, FILM_SPEED = 6.0, 4
"""Start in the recording (s), and speed relative to real time (1)."""
SLOW_DRAWING = (
    "const draw = requestAnimationFrame; window.requestAnimationFrame = (f) => setTimeout(() => draw(f), 200);"
)
"""Script that limits drawing to 5 frames a second, since Chromium draws without a GPU here."""
MAX_FILM_BYTES = 2_000_000


def free_port() -> int:
    """Return an unused port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def running(*words: str) -> Iterator[str]:
    """Run ``mufly`` with a page; yield the address of the page."""
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
    """Wait until a condition holds."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise SystemExit(f"no change within {seconds:g} s")
        time.sleep(0.1)


def window(browser: Browser, url: str, dark: bool, size: tuple[int, int] = LARGE) -> Page:
    """Open the page and wait for its content."""
    page = browser.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme="dark" if dark else "light")
    page.add_init_script(SLOW_DRAWING)
    page.goto(url)
    page.wait_for_function("window.muflyLive?.latest?.s?.position[0] != null", timeout=300_000)
    page.wait_for_function("Boolean(window.muflyScene)")
    page.wait_for_timeout(1500)
    return page


def state(page: Page) -> dict[str, Any]:
    """Return the state of the vehicle that the page shows."""
    found: dict[str, Any] = page.evaluate("window.muflyLive.latest.s")
    return found


def look(page: Page, x: float, y: float, z: float) -> None:
    """Place the camera east, up and south of the vehicle (m)."""
    page.evaluate(
        f"(() => {{ const {{ camera, controls }} = window.muflyScene; "
        f"camera.position.copy(controls.target).add({{ x: {x}, y: {y}, z: {z} }}); controls.update(); }})()"
    )


def shoot(page: Page, path: Path) -> None:
    """Write a picture, with the pointer out of the way."""
    page.mouse.move(5, page.viewport_size["height"] - 3 if page.viewport_size else 5)
    page.wait_for_timeout(1000)
    picture(page).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


def start_mission(page: Page) -> None:
    """Press the mission button until the vehicle flies; a second press confirms the first."""
    button = "[data-testid=mission]"
    for _ in range(20):
        if state(page)["armed"]:
            return
        with suppress(TimeoutError):  # a busy machine greys the page out for a while
            page.click(button, timeout=5000)
        for _ in range(20):
            page.wait_for_timeout(100)
            if state(page)["armed"] or "press again" in page.inner_text(button):
                break
    raise SystemExit(f"the mission did not start: {page.inner_text('.mf-commands')}")


def make_film(browser: Browser, folder: Path, out: Path) -> None:
    """Write an animated WebP of the demonstration flight, from its recording at exact times."""
    command = [sys.executable, "-c", "from mufly.cli import main; main()", "fly", "--headless"]
    subprocess.run([*command, "--out", str(folder / "film")], check=True, stdout=subprocess.DEVNULL)
    with running("station", "--open", str(folder / "film" / "flight.mcap"), "--out", str(folder)) as url:
        page = window(browser, url, dark=True)
        look(page, 2.0, 1.5, 2.4)
        pictures = []
        for k in range(FILM_FRAMES):
            seek(page, FILM_START_s + k * FILM_SPEED * FILM_FRAME_s)
            page.wait_for_timeout(600)
            pictures.append(picture(page).resize(FILM_SIZE))
        page.close()
    path = out / "station-flight.webp"
    more = {"append_images": pictures[1:], "duration": round(1e3 * FILM_FRAME_s), "loop": 0}
    pictures[0].save(path, save_all=True, quality=70, method=6, **more)
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")
    if path.stat().st_size > MAX_FILM_BYTES:
        raise SystemExit(f"{path} exceeds {MAX_FILM_BYTES / 1e6:g} MB")


def is_offline(page: Page) -> bool:
    """Return whether the page is greyed out, as happens for a moment on a busy machine."""
    return bool(page.evaluate("document.body.classList.contains('mf-offline')"))


def seek(page: Page, time_s: float) -> None:
    """Move the slider of a recording until the page shows this time (s); the page drops input while it is offline."""
    slider = page.locator("[data-testid=replay-slider]")
    for _ in range(60):
        if abs(state(page)["time_s"] - time_s) < 0.03:
            return
        if not is_offline(page):
            slider.evaluate(f"e => {{ e.value = {time_s}; e.dispatchEvent(new Event('input')); }}")
            slider.evaluate("e => e.dispatchEvent(new Event('change'))")
        page.wait_for_timeout(500)
    raise SystemExit(f"the recording does not show {time_s:g} s")


def picture(page: Page) -> Image.Image:
    """Return a screenshot of the page while it is online."""
    for _ in range(60):
        if not is_offline(page):
            found = page.screenshot()
            if not is_offline(page):
                return Image.open(io.BytesIO(found)).convert("RGB")
        page.wait_for_timeout(200)
    raise SystemExit("the page stays offline")


def make_box_pictures(browser: Browser, folder: Path, out: Path) -> None:
    """Take the pictures of a flight around a crate and of its recording."""
    with running("fly", "box-on-leg", "--out", str(folder / "flight")) as url:
        page = window(browser, url, dark=True)
        shoot(page, out / "station-ready.png")
        start_mission(page)
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
    with running("station", "--open", str(folder / "flight" / "flight.mcap"), "--out", str(folder)) as url:
        page = window(browser, url, dark=False)
        end = float(page.locator("[data-testid=replay-slider]").get_attribute("max") or 0)
        seek(page, round(0.62 * end, 2))
        page.wait_for_timeout(1500)
        look(page, -2.4, 2.4, 3.4)
        shoot(page, out / "station-recording.png")
        page.close()


def make_camera_picture(browser: Browser, folder: Path, out: Path) -> None:
    """Take the picture of a flight on camera positions."""
    with running("fly", "--position", "camera", "--out", str(folder / "camera")) as url:
        page = window(browser, url, dark=True)
        start_mission(page)
        wait(lambda: state(page)["position"][0] > 1.5, 400.0)
        shoot(page, out / "station-camera.png")
        page.close()


MAKERS = {"film": make_film, "box": make_box_pictures, "camera": make_camera_picture}


def main() -> None:
    """Make all pictures, or the ones of ``--only``."""
    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("--out", type=Path, default=Path(__file__).parent / "images")
    words.add_argument("--only", nargs="+", choices=tuple(MAKERS), default=tuple(MAKERS))
    chosen = words.parse_args()
    folder = Path(tempfile.mkdtemp())
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=chromium, args=FLAGS)
        for name in chosen.only:
            MAKERS[name](browser, folder, chosen.out)
        browser.close()


if __name__ == "__main__":
    main()
