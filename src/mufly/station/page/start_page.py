"""The progress of a start, served as a page until the station's page is ready.

Loading libraries, designing controllers and compiling the model takes a minute on a busy machine. A
:class:`Startup` is the list of these stages with their times; :class:`StartPage` serves it, from a thread and with
nothing but the standard library, on the socket that the station's page takes over. A browser that shows it goes to the
station's page by itself.
"""

from __future__ import annotations

import hmac
import json
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

from mufly.station.page.page_address import (
    COOKIE_NAME,
    PageAddress,
    hash_token_for_cookie,
    is_loopback,
    parse_host_header,
)

FAILURE_DISPLAY_S = 2.0
"""Time for which an open page shows a failed start (s)."""
_POLL_TIMEOUT_S = 3.0


@dataclass(slots=True)
class StartupStage:
    """One stage of a start, with its begin and end (s of a monotonic clock); the end is NaN while the stage runs."""

    text: str
    began_s: float
    ended_s: float = math.nan


class Startup:
    """The stages of a start, and its outcome.

    Parameters
    ----------
    title : str
    clock : callable
        Monotonic clock (s).

    Attributes
    ----------
    title, url : str
        Name of the started program; address of its page, "" without a page.
    stages : list of StartupStage
    fault : str
        Reason of a failure, "" if none.
    is_done : bool
        Whether the start is over, successfully or not.
    visit_count : int
        Number of times that the start page was opened.
    on_change : callable or None
        Called with the text of a stage that begins; with "" when the start is over.
    """

    def __init__(self, title: str = "", clock: Callable[[], float] = time.monotonic) -> None:
        self.title, self._clock = title, clock
        self.url = ""
        self.stages: list[StartupStage] = []
        self.fault = ""
        self.is_done = False
        self.visit_count = 0
        self.on_change: Callable[[str], None] | None = None
        self._lock = threading.Lock()

    def begin_stage(self, text: str) -> None:
        """Begin the next stage, which ends the present one; callable from any thread."""
        with self._lock:
            if self.is_done or (self.stages and self.stages[-1].text == text):
                return
            now = self._end_stage()
            self.stages.append(StartupStage(text, now))
        if self.on_change is not None:
            self.on_change(text)

    def mark_succeeded(self) -> None:
        """Mark the start as successfully finished."""
        self._finish_start("")

    def end_with_fault(self, why: str) -> None:
        """End the start with a fault; later faults are added."""
        self.fault = why
        self._finish_start(why)

    def _finish_start(self, why: str) -> None:
        with self._lock:
            if self.is_done:
                return
            self._end_stage()
            self.is_done = True
        if self.on_change is not None:
            self.on_change("")

    def _end_stage(self) -> float:
        now = self._clock()
        if self.stages and math.isnan(self.stages[-1].ended_s):
            self.stages[-1].ended_s = now
        return now

    @property
    def duration_s(self) -> float:
        """Return the duration of the start so far, or in total (s)."""
        if not self.stages:
            return 0.0
        last = self.stages[-1]
        return (self._clock() if math.isnan(last.ended_s) else last.ended_s) - self.stages[0].began_s

    def describe_stage(self) -> str:
        """Return the present stage and its seconds."""
        if not self.stages:
            return ""
        stage = self.stages[-1]
        spent = (self._clock() if math.isnan(stage.ended_s) else stage.ended_s) - stage.began_s
        return f"{stage.text}, {spent:.0f} s"

    def describe_duration(self) -> str:
        """Return the duration of the start, and its stages of a second or more."""
        long = [(s.text, s.ended_s - s.began_s) for s in self.stages if s.ended_s - s.began_s >= 1.0]
        parts = "; ".join(f"{text} {seconds:.0f} s" for text, seconds in long)
        return f"{self.duration_s:.0f} s" + (f" ({parts})" if len(long) > 1 else "")

    def status_fields(self) -> dict[str, Any]:
        """Return the content of the start page: ``stages`` are ``[text, seconds, whether it has ended]``."""
        now = self._clock()
        return {
            "title": self.title,
            "fault": self.fault,
            "done": self.is_done,
            "stages": [
                [s.text, (now if math.isnan(s.ended_s) else s.ended_s) - s.began_s, not math.isnan(s.ended_s)]
                for s in list(self.stages)
            ],
        }


class StartPage:
    """Serves a :class:`Startup` on the page's address, until :meth:`stop_serving` leaves the socket to the page.

    Parameters
    ----------
    address : PageAddress
    startup : Startup
    """

    def __init__(self, address: PageAddress, startup: Startup) -> None:
        self._startup = startup
        self._asked_s = -math.inf
        self._server = _StartServer(
            ("", 0), _make_handler(address, startup, self._record_poll_time), bind_and_activate=False
        )
        self._server.socket.close()
        self._server.socket = address.socket
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.1,), name="mufly start page", daemon=True
        )
        self._thread.start()

    def _record_poll_time(self) -> None:
        self._asked_s = time.monotonic()

    def stop_serving(self) -> None:
        """Stop serving; the socket stays open, so that the next server answers waiting browsers."""
        if self._thread.is_alive():
            self._server.shutdown()
            self._thread.join()

    def __enter__(self) -> StartPage:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        # Whoever looks is told why it ends; where nobody does it ends at once.
        if isinstance(error, Exception) and self._thread.is_alive():
            self._startup.end_with_fault(str(error))
            if time.monotonic() - self._asked_s < _POLL_TIMEOUT_S:
                time.sleep(FAILURE_DISPLAY_S)
        self.stop_serving()


class _StartServer(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore browsers that disconnect during an answer."""


def _make_handler(address: PageAddress, startup: Startup, asked: Callable[[], None]) -> type[BaseHTTPRequestHandler]:
    class StartPageHandler(BaseHTTPRequestHandler):
        timeout = 5.0
        server_version, sys_version = "mufly", ""

        def do_GET(self) -> None:
            place = urlsplit(self.path)
            if not address.token and not is_loopback(parse_host_header(self.headers.get("Host", ""))):
                self._send_answer(403, "text/plain", "host name not allowed; open the address that the station printed")
            elif not self._has_valid_token(place.query):
                self._send_answer(401, "text/plain", "the station is starting; token required")
            elif place.path == "/starting":
                asked()
                self._send_answer(200, "application/json", json.dumps(startup.status_fields()))
            elif place.path == "/":
                asked()
                startup.visit_count += 1
                self._send_answer(200, "text/html", _START_PAGE_HTML)
            else:
                self._send_answer(503, "text/plain", "the station is starting")

        def _has_valid_token(self, query: str) -> bool:
            if not address.token:
                return True
            given = parse_qs(query).get("token", [""])[0]
            try:
                kept = SimpleCookie(self.headers.get("Cookie", "")).get(COOKIE_NAME)
            except CookieError:
                kept = None
            return hmac.compare_digest(given.encode(), address.token.encode()) or (
                kept is not None and hmac.compare_digest(kept.value, hash_token_for_cookie(address.token))
            )

        def _send_answer(self, status: int, kind: str, text: str) -> None:
            content = text.encode()
            self.send_response(status)
            for name, value in (
                ("content-type", f"{kind}; charset=utf-8"), ("content-length", str(len(content))),
                ("cache-control", "no-store"), ("referrer-policy", "no-referrer"), ("x-frame-options", "DENY"),
            ):  # fmt: skip
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, format: str, *args: Any) -> None:
            """Suppress log output."""

    return StartPageHandler


_START_PAGE_HTML = """<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content="width=device-width">
<title>Starting mufly</title><style>
:root{color-scheme:light dark;--bg:#eef1f4;--panel:#fff;--line:#cfd6dd;--text:#17202a;--dim:#57646f;--accent:#1769a5;
--good:#1d7a46;--bad:#c2271d}
@media(prefers-color-scheme:dark){:root{--bg:#0f1419;--panel:#171d24;--line:#2c3641;--text:#e8edf2;--dim:#98a5b1;
--accent:#58b1e6;--good:#4fc387;--bad:#ff6f61}}
body{margin:0;min-height:100vh;display:grid;place-items:center;background:var(--bg);color:var(--text);
font:14px/1.5 system-ui,"Segoe UI",Roboto,"Noto Sans","DejaVu Sans",sans-serif}
main{width:min(25rem,calc(100vw - 2rem));box-sizing:border-box;padding:1.2rem 1.5rem;background:var(--panel);
border:1px solid var(--line);border-radius:8px}
h1{margin:0;font-size:1.3rem;color:var(--accent)}p{margin:.2rem 0 .8rem;color:var(--dim)}
ol{list-style:none;margin:0;padding:0}
li{display:grid;grid-template-columns:1.5rem 1fr auto;font-variant-numeric:tabular-nums}
li.now{font-weight:600}li:not(.now){color:var(--dim)}li.done span:first-child{color:var(--good)}
#fault{color:var(--bad);font-weight:600;margin:.8rem 0 0;overflow-wrap:anywhere}#fault:empty{display:none}
</style><main><h1>Starting mufly</h1><p id=title>&nbsp;</p><ol id=stages></ol><p id=fault role=alert></p></main><script>
const at = (id) => document.getElementById(id);
let lost = 0;
function show(s) {
  at("title").textContent = s.title || "\\u00a0";
  at("stages").replaceChildren(...s.stages.map(([text, seconds, ended]) => {
    const li = document.createElement("li"), words = [ended ? "\\u2713" : "\\u25b8", text, `${Math.floor(seconds)} s`];
    li.className = ended ? "done" : "now";
    li.append(...words.map((w) => Object.assign(document.createElement("span"), { textContent: w })));
    return li;
  }));
  at("fault").textContent = s.fault ? `Start failed: ${s.fault}` : "";
}
async function look() {
  try {
    const answer = await fetch("/starting" + location.search, { cache: "no-store" });
    if (!(answer.headers.get("content-type") || "").includes("json")) return location.reload();
    show(await answer.json());
    lost = 0;
  } catch (error) {
    if (++lost > 3 && !at("fault").textContent) at("fault").textContent = "The mufly command has ended.";
  }
  setTimeout(look, 300);
}
look();
</script></html>
"""
