"""The page as a person uses it: `mufly fly` started for real, in a real browser."""

import io
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from free_ports import free_port

from mufly.mission import load_mission
from mufly.station.replay import open_recording

MISSION = """
[take_off]
height_m = 0.5
wait_s = 0.5

[[waypoint]]
position_m = [0.6, 0.4, -0.6]

[[box]]
name = "far box"
centre_m = [3.0, -2.0, -0.5]
size_m = [0.5, 0.5, 1.0]
"""


CALM = """
const ask = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = (draw) => setTimeout(() => ask(draw), 100);
"""
"""Draw some eight times a second: WebGL in software takes a core for what a graphics card draws sixty times."""
SIZES = ((1366, 768), (1024, 768), (820, 1180), (390, 844))
STOP = "[data-testid=emergency-stop]"


def wait(condition: Callable[[], Any], what: str, seconds: float = 120.0) -> Any:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found := condition():
            return found
        time.sleep(0.1)
    raise AssertionError(f"{what} did not happen within {seconds:g} s")


class Fly:
    """A running `mufly fly`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "out"
        (folder / "hop.toml").write_text(MISSION)
        self.port = free_port(socket.SOCK_STREAM)
        self.url = f"http://127.0.0.1:{self.port}/"
        words = [
            "fly",
            str(folder / "hop.toml"),
            "--no-browser",
            "--sensors",
            "ideal",
            "--port",
            str(self.port),
            "--out",
            str(self.folder),
        ]
        self.log = (folder / "log.txt").open("w+")
        self.process = subprocess.Popen(
            [sys.executable, "-c", "from mufly.cli import main; main()", *words],
            stdout=self.log, stderr=subprocess.STDOUT, env=os.environ,
        )  # fmt: skip

    def serves(self) -> bool:
        """Whether the station's page is served; until then the page of the start has the port."""
        assert self.process.poll() is None, self.said()
        try:
            with urllib.request.urlopen(self.url + "starting", timeout=5.0):
                return False
        except urllib.error.HTTPError as error:
            return error.code == 404
        except OSError:
            return False

    def said(self) -> str:
        self.log.flush()
        return Path(self.log.name).read_text()


@pytest.fixture(scope="module")
def fly(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fly]:
    running = Fly(tmp_path_factory.mktemp("page"))
    wait(running.serves, "the station's page", 240.0)
    yield running
    running.process.send_signal(signal.SIGINT)
    try:
        running.process.wait(60)
    finally:
        running.process.kill()


class Page:
    """A window, and everything that it asked for or complained of."""

    def __init__(self, browser: Any, url: str, script: str = CALM) -> None:
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self.context = browser.new_context(viewport={"width": 1366, "height": 768}, color_scheme="dark")
        self.context.set_default_timeout(120_000.0)  # ms; a machine without graphics draws slowly under load
        self.page = self.context.new_page()
        self.page.on("console", self._heard)
        self.page.on("pageerror", lambda e: self.complaints.append(str(e)))
        self.page.on("request", lambda r: self.requests.append(r.url))
        self.page.add_init_script(script)
        self.page.goto(url)

    def _heard(self, message: Any) -> None:
        """Keep what the page complains of; that pictures are fetched slowly is software WebGL's own word."""
        own = any(words in message.text for words in ("GPU stall", "GL Driver Message"))
        if message.type in ("error", "warning") and not own:
            self.complaints.append(message.text)

    def frame(self) -> dict[str, Any] | None:
        try:
            found: dict[str, Any] | None = self.page.evaluate("window.muflyLive?.latest?.s ?? null")
        except Exception as error:
            if "Execution context was destroyed" in str(error):
                return None  # the page of the start gives way to the station's
            raise
        return found

    def picture(self, selector: str) -> np.ndarray:
        shot = self.page.locator(selector).first.screenshot()
        return np.asarray(matplotlib.image.imread(io.BytesIO(shot), format="png"))[..., :3]

    def whole(self, selector: str) -> bool:
        """Whether all of it is within the window, and nothing lies on top of it."""
        return bool(
            self.page.locator(selector).first.evaluate(
                """e => {
                    const b = e.getBoundingClientRect(), at = (x, y) => e.contains(document.elementFromPoint(x, y));
                    const wide = b.width > 0 && b.left >= 0 && b.right <= innerWidth;
                    const high = b.top >= 0 && b.bottom <= innerHeight;
                    return wide && high && at(b.left + 3, b.top + 3) && at(b.right - 3, b.bottom - 3);
                }"""
            )
        )

    def ready(self, test_id: str) -> bool:
        return bool(self.page.locator(f"[data-testid={test_id}]").is_enabled())


def repeat(window: Page, act: Callable[[], Any], done: Callable[[], Any], what: str) -> None:
    """Do it until it is done: a greyed or half built window takes no press, a busy station drops a late one."""
    from playwright.sync_api import TimeoutError as NotTaken

    for _ in range(12):
        try:
            act()
            wait(done, what, 5.0)
            return
        except (AssertionError, NotTaken):
            continue
    raise AssertionError(f"{what} did not happen: {window.page.inner_text('body')[-500:]}")


def press(window: Page, selector: str, done: Callable[[], Any], what: str) -> None:
    """Press until it is done, where the button is still there to be pressed."""

    def click() -> None:
        if window.page.locator(selector).count():
            window.page.locator(selector).first.click(timeout=5000.0)

    repeat(window, click, done, what)


def download(window: Page, selector: str) -> Path:
    """Press until its file comes."""
    files: list[Path] = []

    def ask() -> None:
        with window.page.expect_download(timeout=10_000.0) as sent:
            window.page.locator(selector).click(timeout=5000.0)
        files.append(sent.value.path())

    repeat(window, ask, lambda: files, "the download")
    return files[-1]


def open_tab(window: Page, name: str, done: Callable[[], Any], what: str) -> None:
    """Choose a tab of the page until its content is there."""
    repeat(window, lambda: window.page.get_by_role("tab", name=name).click(timeout=5000.0), done, what)


def open_mark(window: Page) -> Any:
    """Press the key of a mark until its field is there."""
    field = window.page.get_by_label("text").last
    is_open = window.page.locator(".q-dialog").count
    repeat(window, lambda: is_open() or window.page.keyboard.press("m"), is_open, "the dialog of a mark")
    return field


def ask_twice(window: Page, test_id: str, done: Callable[[], Any], what: str) -> None:
    """Press, and again when asked to; anew where it came to nothing: a very busy station drops a press as late."""
    page, button = window.page, f"[data-testid={test_id}]"
    for _ in range(12):
        page.click(button)
        try:
            wait(lambda: "press again" in page.inner_text(button), "being asked again", 5.0)
            assert not done()
            page.click(button)
            wait(done, what, 10.0)
            return
        except AssertionError:
            continue
    raise AssertionError(f"{what} did not happen")


@pytest.fixture(scope="module")
def window(browser: Any, fly: Fly) -> Iterator[Page]:
    page = Page(browser, fly.url)
    wait(
        lambda: (f := page.frame()) and f["connected"] and f["position"][0] is not None,
        "a vehicle on the page",
    )
    yield page
    page.context.close()


def test_the_scene_is_drawn_and_nothing_overflows(window: Page) -> None:
    wait(lambda: window.page.evaluate("Boolean(window.muflyScene)"), "the scene")
    time.sleep(1.0)
    picture = window.picture(".mf-scene")
    assert picture.std() > 0.02  # not one colour
    assert len(np.unique((picture * 32).astype(int).reshape(-1, 3), axis=0)) > 20
    wait(lambda: window.page.locator(".mf-chips button").count() > 6, "the signals")
    for width, height in SIZES:
        window.page.set_viewport_size({"width": width, "height": height})
        assert window.page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert window.whole(STOP)
        # Fields and buttons of the commands stand beside each other, cut nowhere.
        boxes = [b.bounding_box() for b in window.page.locator(".mf-commands :is(button, input):visible").all()]
        for k, a in enumerate(boxes):
            assert a["x"] >= 0
            assert a["x"] + a["width"] <= width
            for b in boxes[:k]:
                apart = a["x"] + 0.5 >= b["x"] + b["width"] or b["x"] + 0.5 >= a["x"] + a["width"]
                assert apart or a["y"] + 0.5 >= b["y"] + b["height"] or b["y"] + 0.5 >= a["y"] + a["height"]
        cut = window.page.locator(".mf-plot-head select").first.evaluate(
            """e => {
                const wide = e.offsetWidth;
                e.style.cssText = "width: max-content; max-width: none";
                const whole = e.offsetWidth;
                e.style.cssText = "";
                return whole - wide;
            }"""
        )
        assert cut <= 0, "the longest name of a quantity is cut"
        for chips in window.page.locator(".mf-chips").all():
            assert chips.evaluate("e => e.scrollWidth <= e.clientWidth"), f"at {width} a component is cut"
    window.page.set_viewport_size({"width": 1366, "height": 768})


def test_axes_have_two_numbers_and_nothing_is_charged_before_a_vehicle_is_heard(window: Page) -> None:
    found = window.page.evaluate(
        """async () => {
            const place = document.querySelector("link[href*='/station.css']").href.replace("station.css", "");
            const { tickStep } = await import(place + "draw.js"), { mount } = await import(place + "status.js");
            const numbers = [];
            for (const pixels of [20, 36, 60, 200]) {
                for (let k = 0; k < 300; k++) {
                    const low = -3 + 0.0217 * k, high = low + 10 ** (k / 60 - 3.5), step = tickStep(low, high, pixels);
                    numbers.push(Math.floor(high / step) - Math.ceil(low / step) + 1);
                }
            }
            const bar = document.createElement("div");
            mount(bar).close();
            return { least: Math.min(...numbers), most: Math.max(...numbers), text: bar.innerText,
                     gauge: bar.querySelector(".mf-gauge").hidden };
        }"""
    )
    assert found["least"] == 2
    assert found["most"] < 12
    assert found["gauge"]
    assert "%" not in found["text"]


def test_the_checks_say_ready_and_the_buttons_say_why_not(window: Page) -> None:
    wait(lambda: "Ready to fly" in window.page.inner_text(".mf-checks-head"), "ready")
    wait(lambda: window.ready("take-off"), "take-off")
    assert not window.ready("land")
    assert "on the floor" in window.page.inner_text("[data-testid=land]")


def test_a_station_that_is_stopped_greys_the_page_and_does_nothing_late(fly: Fly, window: Page) -> None:
    """Its process stands still: what is pressed then waits in the socket, and is dropped when it goes on."""
    page, strip = window.page, ".mf-flightbar"
    page.evaluate(
        """() => {
            window.once = true;
            const packet = window.socket.packet.bind(window.socket);
            window.socket.packet = (one) => {
                if (one.data?.[0] === "event") window.kept = one;
                return packet(one);
            };
        }"""
    )
    page.fill("[data-testid=field-height]", "1.2")
    os.kill(fly.process.pid, signal.SIGSTOP)
    try:
        page.evaluate("document.querySelector('[data-testid=take-off]').click()")
        wait(lambda: "No link to the station for" in page.inner_text(strip), "the page to grey")
        assert page.locator("[data-testid=no-contact]").is_visible()
        assert "transmitter" in page.locator(STOP).evaluate("e => getComputedStyle(e, '::after').content")
        for part in (".mf-page", STOP):
            assert page.locator(part).evaluate("e => e.inert")
        page.set_viewport_size({"width": 390, "height": 844})
        for part in (".mf-strip-line", "[data-testid=no-contact]"):  # its words are cut on no phone
            assert page.locator(part).evaluate(
                "e => e.scrollWidth <= e.clientWidth && e.scrollHeight <= e.clientHeight"
            )
        page.set_viewport_size({"width": 1366, "height": 768})
        page.keyboard.press("Shift+T")
        page.evaluate("document.querySelector('[data-testid=take-off]').click()")
        page.evaluate("window.kept && window.socket.packet(window.kept)")  # past the page's own watchdog
        time.sleep(1.2)  # longer than anything may be late
    finally:
        os.kill(fly.process.pid, signal.SIGCONT)
    wait(lambda: "No link" not in page.inner_text(strip), "the station")
    wait(lambda: window.ready("take-off"), "the buttons")
    time.sleep(1.0)
    assert not (window.frame() or {})["armed"]
    assert page.evaluate("window.once"), "the page was loaded anew"
    wait(lambda: not page.locator(".mf-page").evaluate("e => e.inert"), "the page to answer")


PAD = """
    window.pad = { index: 0, id: "Test pad (Vendor: 1)", connected: true, axes: [0.05, 0, 0, 0], buttons: [] };
    navigator.getGamepads = () => [window.pad];
    window.dispatchEvent(Object.assign(new Event("gamepadconnected"), { gamepad: window.pad }));
"""


def by_joystick(window: Page, state: Callable[[], Any]) -> None:
    """The browser's joystick: taken up in its middle only, with a dead one, and let go when it is unplugged."""
    page = window.page
    page.evaluate(PAD)
    wait(lambda: "Test pad" in page.inner_text(".mf-sticks-bar select"), "the joystick")
    page.evaluate("window.pad.axes[1] = -0.9")
    by_hand = "[data-testid=by-hand]"
    press(window, by_hand, lambda: "not centred" in page.inner_text("[data-testid=sticks-said]"), "the refusal")
    page.evaluate("window.pad.axes[1] = 0")
    page.click(by_hand)
    wait(lambda: state() == "rc", "the joystick to be taken up")

    def turns() -> bool:
        if state() == "hover":  # a busy machine is late with the sticks, and the vehicle lets go of them
            page.evaluate("window.pad.axes[0] = 0")
            page.click(by_hand)
            wait(lambda: state() == "rc", "the joystick to be taken up again")
        page.evaluate("window.pad.axes[0] = 0.6")
        return abs(window.frame()["rates"][2]) > 0.1  # type: ignore[index]

    wait(turns, "a turn")
    page.evaluate("window.pad.connected = false")
    wait(lambda: state() == "hover", "the hover without a joystick")
    assert "joystick disconnected" in page.inner_text("[data-testid=sticks-said]")


def fly_by_hand(window: Page) -> None:
    """Sticks of the screen: it leans while one is held, stays when it is let go, and ends with the window's focus."""
    page = window.page

    def state() -> Any:
        return (window.frame() or {}).get("state")

    page.click("[data-testid=sticks-toggle]")
    wait(lambda: window.ready("by-hand"), "the vehicle to allow it")
    page.click("[data-testid=by-hand]")
    wait(lambda: state() == "rc", "the sticks to be taken up")
    wait(lambda: not window.ready("land"), "the other commands to wait")
    stick = page.locator("[data-testid=stick-1]").bounding_box()
    assert stick is not None
    x, y = stick["x"] + stick["width"] / 2, stick["y"] + stick["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 25, y)  # half way to the right
    wait(lambda: window.frame()["reference_attitude"][0] > 0.02, "to lean to the right")  # type: ignore[index]
    page.mouse.up()
    wait(lambda: abs(window.frame()["reference_attitude"][0]) < 1e-3, "the middle")  # type: ignore[index]
    page.evaluate("window.dispatchEvent(new Event('blur'))")
    wait(lambda: state() == "hover", "the hover")
    assert "window lost focus" in page.inner_text("[data-testid=sticks-said]")
    by_joystick(window, state)
    page.click("[data-testid=sticks-toggle]")
    wait(lambda: window.ready("land"), "the buttons")


def test_it_takes_off_flies_to_a_click_and_lands(window: Page) -> None:
    page = window.page
    page.fill("[data-testid=field-height]", "0.6")
    ask_twice(window, "take-off", lambda: (window.frame() or {}).get("armed"), "arming")
    assert "on the floor" in page.inner_text(".mf-flightbar").lower()
    before = {k: window.picture(k) for k in (".mf-scene", ".mf-plot-area")}
    wait(lambda: window.frame()["state"] == "hover" and window.ready("goto"), "the hover")  # type: ignore[index]
    for selector, picture in before.items():
        after = window.picture(selector)
        assert np.abs(after - picture).max() > 0.2, f"{selector} did not move"
        assert (np.abs(after - picture).max(axis=2) > 0.1).mean() > 1e-3

    x, y = page.evaluate("window.muflyScene.onFloor(0.6, -0.5)")
    page.locator(".mf-scene canvas").first.click(position={"x": x, "y": y})
    assert page.locator("[data-testid=goto-chip]").is_visible()
    page.fill("[data-testid=goto-chip] input", "0.6")
    assert page.evaluate("window.muflyScene.sent()") is None
    page.click(".mf-chip-send")
    wait(lambda: page.evaluate("window.muflyScene.sent()"), "the mark of where it was sent")
    assert float(page.input_value("[data-testid=field-north]")) == pytest.approx(0.6, abs=0.05)

    def there() -> bool:
        s = window.frame()
        assert s is not None
        return float(np.linalg.norm(np.subtract(s["position"], (0.6, -0.5, -0.6)))) < 0.2

    wait(there, "arrival at the waypoint")
    wait(lambda: page.evaluate("window.muflyScene.sent()") is None, "the mark to go")
    stop_is_there_behind_a_recording_a_dialog_and_a_field(window)
    fly_by_hand(window)

    def press_land_twice() -> None:
        for _ in range(2):
            page.keyboard.press("Shift+L")
            time.sleep(0.5)

    repeat(window, press_land_twice, lambda: window.frame()["state"] != "hover", "to begin the landing")  # type: ignore[index]
    wait(lambda: not window.frame()["armed"], "the landing")  # type: ignore[index]
    assert "✓ land" in page.inner_text(".mf-requests")


def open_recording_of_the_station(window: Page, is_open: Callable[[], bool]) -> None:
    """Let the list show every file, and open the station's."""
    row = window.page.locator("tr", has_text="station.mcap").locator("button")
    repeat(window, lambda: window.page.check("[data-testid=every-file]"), row.count, "every file")
    repeat(window, lambda: is_open() or row.first.click(timeout=5000.0), is_open, "the recording")


def stop_is_there_behind_a_recording_a_dialog_and_a_field(window: Page) -> None:
    """In flight; the first of the two presses only."""
    page, stop = window.page, window.page.locator(STOP)
    every = page.locator("[data-testid=every-file]")
    open_tab(window, "Recordings", every.is_visible, "the recordings")
    slider = page.locator("[data-testid=replay-slider]")
    open_recording_of_the_station(window, slider.is_visible)
    field = open_mark(window)
    field.fill("gust")
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        assert window.whole(STOP)
        assert "Flying" in page.inner_text(".mf-flightbar")
        assert slider.bounding_box()["width"] > 250
    page.set_viewport_size({"width": 1366, "height": 768})
    field.press("Shift+Backspace")
    wait(lambda: "PRESS AGAIN" in stop.inner_text(), "the question")
    assert field.input_value() == "gust"
    page.keyboard.press("Escape")
    press(window, "text=Close recording", lambda: window.ready("land") and not page.locator(".q-dialog").count(),
          "the vehicle again")  # fmt: skip


def test_an_edit_of_a_parameter_is_made_and_taken_back(window: Page) -> None:
    page = window.page
    search, field = page.locator("[aria-label='search parameters']"), page.locator("[data-name=MIS_TAKEOFF_ALT]")
    open_tab(window, "Parameters", search.is_visible, "the parameters")
    search.fill("MIS_TAKEOFF")
    field.wait_for()
    was = field.input_value()

    def enter(text: str, key: str) -> None:
        field.fill(text)
        field.press(key)

    repeat(
        window, lambda: enter("1.5", "Enter"), lambda: page.locator(".mf-badge").count() == 1, "the mark of a change"
    )
    field.fill("1.7")
    field.press("Escape")
    assert field.input_value() == "1.5"  # what the vehicle has, and not what it had
    repeat(window, lambda: enter("999", "Tab"), lambda: field.input_value() == "1.5", "what the vehicle has")
    assert "outside 0.2 to 50 m" in page.inner_text("body")
    refused = "e => !e.validity.valid"
    repeat(window, lambda: enter("999", "Enter"), lambda: field.evaluate(refused), "the reason at the field")
    assert field.input_value() == "999"  # who types may mend it
    field.press("Escape")
    assert field.input_value() == "1.5"
    press(window, "[data-testid=undo]", lambda: field.input_value() == was, "undo")


def test_a_mission_is_sent_from_a_file_and_a_bad_one_is_refused(window: Page, tmp_path: Path) -> None:
    page = window.page
    items = page.locator(".mf-mission tbody tr")
    open_tab(window, "Mission", lambda: items.count() == 3, "the mission of the command line")
    good, bad = tmp_path / "two.toml", tmp_path / "bad.toml"
    moved = MISSION.replace("[3.0, -2.0, -0.5]", "[3.0, -2.2, -0.5]")
    good.write_text(moved + "\n[[waypoint]]\nposition_m = [0.0, 1.0, -0.7]\n")
    bad.write_text(MISSION.replace("-0.6]", "0.6]"))
    upload = page.locator("[data-testid=mission-file] input[type=file]")
    repeat(window, lambda: upload.set_input_files(str(bad)),
           lambda: "waypoint[1].position_m" in page.inner_text("body"), "the reason")  # fmt: skip
    assert items.count() == 3
    repeat(window, lambda: upload.set_input_files(str(good)), lambda: items.count() == 4, "the new mission")
    wait(lambda: "the vehicle keeps its own: box" in page.inner_text("body"), "what items do not carry")
    assert "0.70" in page.inner_text(".mf-mission tbody")


def test_a_mission_is_drawn_checked_and_sent(window: Page) -> None:
    """After the one above the vehicle holds two waypoints. Point, drag, height, undo, and the check while one draws."""
    page = window.page
    open_tab(window, "Plan", lambda: page.locator("[data-testid=plan-fetch]").is_visible(), "the plan")

    def rows() -> list[list[float]]:
        found: list[list[float]] = page.evaluate("window.muflyDraft.state?.rows.map(r => r.at) ?? []")
        return found

    def verdict(words: str) -> bool:
        return words in page.inner_text("[data-testid=plan-verdict]")

    held = [[0.6, 0.4, 0.6], [0.0, 1.0, 0.7]]
    press(window, "[data-testid=plan-fetch]", lambda: rows() == held, "the vehicle's mission")
    wait(lambda: verdict("valid"), "the check")
    assert verdict("% of the battery")
    page.get_by_role("button", name="view from above, north up").click()
    page.evaluate("new Promise(r => requestAnimationFrame(() => requestAnimationFrame(r)))")  # it has been drawn
    x, y = page.evaluate("window.muflyScene.onFloor(0.8, -0.6)")
    page.locator(".mf-scene canvas").first.click(position={"x": x, "y": y})
    wait(lambda: len(rows()) == 3, "a third waypoint")
    assert rows()[2] == pytest.approx([0.8, -0.6, 1.0], abs=0.06)
    assert page.locator("[data-testid=goto-chip]").is_hidden()  # drawing flies nothing

    point = page.locator("[data-testid=point-3]").bounding_box()
    assert point is not None
    page.mouse.move(point["x"] + 12, point["y"] + 12)
    page.mouse.down()
    for k in range(1, 9):
        page.mouse.move(point["x"] + 12 - 8 * k, point["y"] + 12)
    page.mouse.up()
    wait(lambda: rows()[2][1] < -0.9, "the drag")
    assert rows()[2][2] == 1.0  # on its level
    page.fill("[data-testid=plan-3-height]", "0.1")
    page.keyboard.press("Tab")
    wait(lambda: verdict("waypoint[3].position_m") and verdict("too low to fly"), "the fault of the third")
    assert page.locator("tr.mf-bad-row").get_attribute("data-row") == "3"
    refusal = "not uploaded: waypoint[3]"
    press(window, "[data-testid=plan-send]", lambda: refusal in page.inner_text("body"), "the refusal")
    for _ in range(2):  # the height and, in one step, the drag
        page.click("[data-testid=plan-undo]")
    wait(lambda: rows()[2] == pytest.approx([0.8, -0.6, 1.0], abs=0.06), "undo")
    page.fill("[data-testid=plan-3-speed_m_s]", "0.25")
    page.keyboard.press("Enter")
    wait(lambda: page.evaluate("window.muflyDraft.state.rows[2].speed") == 0.25, "the speed")
    wait(lambda: verdict("valid"), "the check again")

    def send() -> None:
        open_tab(window, "Plan", lambda: page.locator("[data-testid=plan-send]").is_visible(), "the plan")
        page.click("[data-testid=plan-send]", timeout=5000.0)
        page.get_by_role("tab", name="Mission").click(timeout=5000.0)

    items = page.locator(".mf-mission tbody tr")
    repeat(window, send, lambda: items.count() == 6, "the mission in the vehicle")  # its speed, too
    kept = load_mission(download(window, "[data-testid=plan-save]"))
    assert [w.speed_m_s for w in kept.waypoint] == [None, None, 0.25]
    page.get_by_role("tab", name="Plots").click()


def test_the_emergency_stop_wants_a_second_press(window: Page) -> None:
    stop = window.page.locator("[data-testid=emergency-stop]")
    repeat(window, stop.click, lambda: "PRESS AGAIN" in stop.inner_text(), "the question")
    wait(lambda: "EMERGENCY STOP" in stop.inner_text(), "the end of the question", 6)
    assert "EMERGENCY" not in window.page.inner_text(".mf-requests")

    def press_twice() -> None:  # by the keyboard, and in earnest
        for _ in range(2):
            window.page.keyboard.press("Shift+Backspace")
            time.sleep(0.5)

    done = "✓ EMERGENCY STOP"
    repeat(window, press_twice, lambda: done in window.page.inner_text(".mf-requests"), "the stop")
    said = "window.muflyAlerts.said.some(a => a.level === 'error' && a.text.includes('emergency stop'))"
    wait(lambda: window.page.evaluate(said), "the alert")


ANY_NUMBER = """
async () => {
  const live = window.muflyLive, base = structuredClone(live.latest), names = live.samples.names ?? [];
  const drawn = () => new Promise((done) => requestAnimationFrame(() => setTimeout(done, 0)));
  const stop = document.querySelector("[data-testid=emergency-stop]");
  let worst = 0, tried = 0, covered = 0;
  async function show(frame) {
    const began = performance.now();
    live.take(frame);
    await drawn();
    worst = Math.max(worst, performance.now() - began);
    tried += 1;
    const b = stop.getBoundingClientRect();
    covered += live.connected && !stop.contains(document.elementFromPoint(b.x + b.width / 2, b.y + b.height / 2));
  }
  const tables = (v) => ({
    mission: Array.from({ length: 500 }, (_, k) => ({
      action: "waypoint", p: k % 2 ? [v, v, v] : [k, v, -1], heading: v, wait: v, reached: false, text: "<b>x</b>",
    })),
    trail: [[v, v, v], [0, v, 0]],
    others: [[v, v, v], [0, 0, -1]].map((p, k) => ({ name: `o${k}`, color: k, p, a: [v, v, v], w: [v, v] })),
    h: { t: [base.s.time_s + tried], v: names.map(() => [v]) },
    messages: [[v, "warning", "<img src=x onerror=alert(1)>\\u202e\\u05d0 \\ud83d\\ude81" + "x".repeat(1e5)]],
    parameters: [["P", v, "m", v, v, "help", false, v]], checks: [["check", false, "text"]],
    sensors: [["gyro", "fused", v, ""]],
    scenery: { world: { boxes: [], cylinders: [], room: { n: [-4, 4], e: [-1e5, 1e5] } }, rotor_radius: v },
    spectrum: {
      signal: "x", unit: "m", rate: v, f: [1, 2], d: [v, v], marks: [{ name: "upper", hz: v, at: v, folded: false }],
    },
  });
  const fields = [];
  (function walk(part, path) {
    for (const [key, value] of Object.entries(part)) {
      if (value && typeof value === "object") walk(value, [...path, key]);
      else fields.push([...path, key]);
    }
  })(base.s, []);
  const set = (s, path, v) => (path.slice(0, -1).reduce((part, key) => part[key], s)[path.at(-1)] = v);
  for (const v of [1e30, -1e30, 1e-30, -0, 1e308, null, NaN, Infinity, "text", undefined]) {
    const frame = structuredClone(base);
    fields.forEach((path) => set(frame.s, path, v));
    await show({ ...frame, ...tables(v) });
  }
  for (const path of fields) {
    const frame = structuredClone(base);
    set(frame.s, path, 1e30);
    await show(frame);
  }
  return { worst, tried, covered, fields: fields.length, scripts: document.querySelectorAll("img[src=x]").length };
}
"""
"""Frames with each field of the present, and all fields of all tables, as a number or text that no vehicle has."""


def test_no_number_hangs_the_page_and_the_stop_stays_in_reach(browser: Any, fly: Fly, window: Page) -> None:
    second = Page(browser, fly.url, "")
    wait(lambda: second.frame(), "a vehicle on the page")
    wait(lambda: second.page.evaluate("Boolean(window.muflyScene)"), "the scene")
    found = second.page.evaluate(ANY_NUMBER)
    assert found["fields"] > 40
    assert found["covered"] == 0
    assert found["scripts"] == 0
    # The page goes on with what the vehicle says, its view of it too.
    wait(lambda: (f := second.frame()) and abs(f["time_s"]) < 1e5, "the vehicle again")
    eye = second.page.evaluate("window.muflyScene.camera.position.toArray()")
    assert np.abs(eye).max() < 1e3
    second.context.close()


def test_a_mark_goes_into_the_recording(window: Page) -> None:
    page = window.page
    open_mark(window).fill("gust from the left")
    page.keyboard.press("Enter")
    open_tab(window, "Messages", page.locator(".mf-messages").first.is_visible, "the messages")
    wait(lambda: "mark: gust from the left" in page.inner_text(".mf-messages"), "the mark")


ONE_IS_NAN = """
const parse = JSON.parse;
JSON.parse = (text, ...more) => {
  const read = parse(text, ...more);
  if (read?.parameters?.length > 1) read.parameters[0][1] = read.parameters[0][7] = null;
  return read;
};
"""
"""As if the first parameter were NaN, which travels as null."""
KEEP_SOCKETS = """
const Socket = WebSocket, kept = [];
let cut = false;
window.WebSocket = class extends Socket {
  constructor(url, ...more) {
    if (cut && url.includes("/live/")) {
      const none = new EventTarget();
      none.close = () => {};
      setTimeout(() => none.onclose?.(), 50);
      return none;
    }
    super(url, ...more);
    if (url.includes("/live/")) kept.push(this);
  }
};
window.lose = () => { cut = true; kept.forEach((s) => s.close()); };
window.find_again = () => { cut = false; };
"""
"""The stream of frames can be cut, and comes back a second after it may."""


def test_a_second_window_watches_until_it_takes_the_controls(browser: Any, fly: Fly, window: Page) -> None:
    second = Page(browser, fly.url, CALM + ONE_IS_NAN + KEEP_SOCKETS)
    wait(lambda: "Another window" in second.page.inner_text(".mf-banner"), "the note")
    assert not second.ready("take-off")
    wait(second.frame, "its first frame")
    press(second, "[data-testid=take-controls]", lambda: "Another window" in window.page.inner_text(".mf-banner"),
          "the controls to change hands")  # fmt: skip
    wait(lambda: second.ready("take-off"), "the controls")
    rows = second.page.locator(".mf-parameter-table tbody tr")
    open_tab(second, "Parameters", lambda: rows.count() > 20, "the parameters, one of them no number")
    assert second.page.get_by_placeholder("not a number").count() == 1
    wait(lambda: not window.ready("take-off"), "the first window to watch")
    # A window that has lost the station asks for nothing: what waits would be done when it is back.
    second.page.evaluate("lose()")
    wait(lambda: "No link to the station" in second.page.inner_text(".mf-flightbar"), "the word of it")
    assert "use the transmitter or its kill switch" in second.page.inner_text(".mf-flightbar")
    assert second.page.locator(STOP).is_visible()
    for key in ("Shift+T", "Shift+Backspace", "Shift+Backspace"):
        second.page.keyboard.press(key)
    take_off = second.page.locator("[data-testid=take-off]")
    assert not take_off.evaluate("e => { e.focus(); return document.activeElement === e; }")
    assert "out of reach" in second.page.locator(STOP).evaluate("e => getComputedStyle(e, '::after').content")
    second.page.evaluate("find_again()")
    wait(lambda: "No link" not in second.page.inner_text(".mf-flightbar"), "the station")
    wait(lambda: not second.page.locator(".mf-page").evaluate("e => e.inert"), "the page to answer")
    time.sleep(1.0)
    assert not (second.frame() or {})["armed"]
    second.context.close()
    wait(lambda: window.ready("take-off"), "the controls to come back")
    assert fly.process.poll() is None  # closing a window stops nothing
    assert second.complaints == []


def test_a_recording_is_opened_and_its_slider_moves_everything(fly: Fly, window: Page) -> None:
    """Out of the list of flights, which says who flew what, and why a file cannot be read."""
    page = window.page
    (fly.folder / "broken.tlog").write_bytes(b"\x01" * 999)

    def rows() -> list[str]:
        return [text.replace("\t", " ") for text in page.locator(".mf-flight-list tbody tr").all_inner_texts()]

    def broken() -> bool:
        return any("broken.tlog" in r and "cannot be read: is not a log" in r for r in rows())

    open_tab(window, "Recordings", lambda: page.locator("text=Refresh").count(), "the recordings")
    press(window, "text=Refresh", broken, "the broken file")
    assert page.locator("tr", has_text="broken.tlog").locator("[data-testid=open-recording]").is_disabled()
    page.uncheck("[data-testid=every-file]")
    wait(lambda: any("flight.mcap" in r and "mufly-1.1" in r and "hop" in r for r in rows()), "who flew what")
    assert not any("station.mcap" in r for r in rows())  # it lies beside that of the vehicle
    page.fill("[aria-label='filter recordings']", "mufly-1.1 hop")
    assert len(rows()) == 1
    assert download(window, "[aria-label^=download]").read_bytes().startswith(b"\x89MCAP")
    page.fill("[aria-label='filter recordings']", "")
    slider = page.locator("[data-testid=replay-slider]")
    open_recording_of_the_station(window, slider.is_visible)
    picture = window.picture(".mf-scene")
    # Where it stood and where it was highest: on a busy machine a recording may be of standing for the most part.
    heard = open_recording(next(fly.folder.rglob("station.mcap")))
    highest = int(np.nanargmin(heard.columns["measured_position_D"]))
    shown = []
    for moment_s in (0.0, float(heard.times_s[highest] - heard.times_s[0])):

        def move(t: float = moment_s) -> None:
            slider.evaluate(f"e => {{ e.value = {t}; e.dispatchEvent(new Event('input')); }}")
            slider.evaluate("e => e.dispatchEvent(new Event('change'))")

        def moved(t: float = moment_s) -> bool:
            return bool(abs(window.frame()["time_s"] - t) < 0.1)  # type: ignore[index]

        repeat(window, move, moved, "the slider's moment")
        shown.append(window.frame()["position"])  # type: ignore[index]
    assert np.linalg.norm(np.subtract(*shown)) > 0.05
    assert np.abs(window.picture(".mf-scene") - picture).max() > 0.2
    status = page.locator(".mf-status")
    press(window, "text=Close recording", lambda: "recording" not in status.inner_text().lower(), "the vehicle again")


def test_nothing_was_complained_of_and_nothing_asked_for_elsewhere(fly: Fly, window: Page) -> None:
    assert window.complaints == []
    assert [u for u in window.requests if not u.startswith((fly.url, f"ws://127.0.0.1:{fly.port}/", "blob:"))] == []
    assert "Traceback" not in fly.said()
