"""Manual flight from a window: virtual sticks or a joystick in the browser, and its permission.

The window sends the stick positions twenty times a second; every message is checked for permission here. Manual flight
ends when the window is hidden or loses its focus, joystick or connection. It also ends when another window takes the
controls, or another vehicle or a recording is shown. The vehicle then hovers.
"""

from __future__ import annotations

from collections.abc import Callable

from nicegui.events import GenericEventArguments

from mufly.station.page.page_session import WindowView
from mufly.station.page.panels import BrowserPanel
from mufly.station.remote_vehicle import RemoteVehicle
from mufly.station.signal_history import OperatorRequest, RequestOutcome

CENTRE_TOLERANCE = 0.15
"""Largest deflection at which sticks are taken up (share of full), so that nothing jumps."""


class StickPanel:
    """The sticks of one window.

    Parameters
    ----------
    view : WindowView
    reason : callable
        Returns why manual flight is unavailable now, "" if available.
    """

    def __init__(self, view: WindowView, reason: Callable[[], str]) -> None:
        self._view, self._reason = view, reason
        self._flown: RemoteVehicle | None = None
        self._request: OperatorRequest | None = None
        self._shown: tuple[object, ...] = ()
        self._panel = BrowserPanel("sticks").classes("mf-live-only")
        self._panel.on("sticks", self._handle_sticks, throttle=0.0)

    def refresh(self) -> None:
        """Send the window its permission and whether it flies."""
        if self._flown is not None and (why := self._end_reason()):
            self._release_sticks(why)
        now = (self._reason(), self._flown is not None)
        if now != self._shown:
            self._shown = now
            self._panel.call_method("show", {"reason": now[0], "held": now[1]})

    def _end_reason(self) -> str:
        vehicle = self._flown
        if vehicle is None:
            return ""
        if self._view.shown_vehicle() is not vehicle:
            return "another vehicle is displayed"
        if why := self._reason():
            return why
        if self._request is not None and self._request.is_done and self._request.outcome is not RequestOutcome.ACCEPTED:
            return self._request.answer
        return "" if vehicle.sticks.is_held else "no stick input received"

    def _release_sticks(self, why: str) -> None:
        vehicle, self._flown, self._request = self._flown, None, None
        if vehicle is not None and (request := vehicle.release_sticks()) is not None:
            self._view.keep_request(request)
        self._panel.call_method("ended", why)

    def _handle_sticks(self, e: GenericEventArguments) -> None:
        content = e.args if isinstance(e.args, dict) else {}
        if "end" in content:
            self._release_sticks(str(content["end"])[:120])
            self.refresh()
            return
        at = content.get("at")
        if not isinstance(at, list) or len(at) != 4 or not all(isinstance(v, int | float) for v in at):
            return
        if content.get("begin"):
            self._start_flying(at)
        elif self._flown is not None and not self._end_reason():
            self._flown.sticks.set_deflection(*map(float, at))
        self.refresh()

    def _start_flying(self, at: list[float]) -> None:
        vehicle, why = self._view.shown_vehicle(), self._reason()
        if any(abs(v) > CENTRE_TOLERANCE for v in at):
            why = why or "sticks not centred; release them first"
        if vehicle is None or why:
            self._panel.call_method("ended", why or "no vehicle is displayed")
            return
        vehicle.sticks.set_deflection(*map(float, at))
        self._flown, self._request = vehicle, vehicle.fly_manually()
        self._view.keep_request(self._request)
