"""The strip above everything: whether the vehicle flies, and the emergency stop.

It stands on top of tabs, dialogs and recordings, at every width, and speaks of the selected vehicle even while a
recording is shown. The stop works from every window and whoever commands; it needs two presses within three seconds.
Its key is heard before any field or dialog hears it (``static/keys.js``).
"""

from __future__ import annotations

import math

from mufly.link.ports import elapsed_s
from mufly.station.history import Outcome, Request
from mufly.station.page.panels import Action, Panel, element
from mufly.station.page.session import ANSWER_S, View, availability
from mufly.station.remote import RemoteVehicle

CONFIRM_S = 3.0
_WORDS = {
    Outcome.WAITING: "asked",
    Outcome.ACCEPTED: "done: motors off",
    Outcome.REFUSED: "REFUSED",
    Outcome.TIMED_OUT: "NO ANSWER",
}


class FlightStrip:
    """The strip of one window.

    Parameters
    ----------
    view : View
    """

    def __init__(self, view: View) -> None:
        self._view = view
        self._aimed_s = self._asked_s = -math.inf
        self._aim: RemoteVehicle | None = None
        self._request: Request | None = None
        with element("section", classes="mf-flightbar").props('aria-label="flight and emergency stop"'):
            Panel("strip")
            self._stop = Action(
                "EMERGENCY STOP", "emergency-stop", "Shift+Backspace", self._press, "mf-stop", "Shift+⌫ twice"
            )
        self.refresh()

    def _press(self) -> None:
        now, vehicle = elapsed_s(), self._view.aircraft()
        if not self._sure(now, vehicle):
            self._aim, self._aimed_s = vehicle, now
        elif vehicle is not None:
            self._aim, self._asked_s = None, now
            self._request = vehicle.emergency_stop()
            self._view.ask(self._request)
        self.refresh()

    def _sure(self, now: float, vehicle: RemoteVehicle | None) -> bool:
        """Whether a press is the second one for this vehicle."""
        return vehicle is self._aim is not None and now - self._aimed_s < CONFIRM_S

    def refresh(self) -> None:
        """Bring the button up to date."""
        vehicle, now = self._view.aircraft(), elapsed_s()
        label, note = "EMERGENCY STOP", ""
        if self._sure(now, vehicle):
            label = "PRESS AGAIN TO STOP"
        elif self._request is not None and now - self._asked_s < ANSWER_S:
            note = _WORDS[self._request.outcome]
        reasons = availability(
            None if vehicle is None else vehicle.snapshot,
            kind="other" if vehicle is None else vehicle.kind,
            has_controls=self._view.has_controls,
            rows=0,
        )
        # Of several vehicles the button says which one it stops.
        if vehicle is not None and len(self._view.session.vehicles()) > 1:
            note = ": ".join(filter(None, (self._view.session.label(vehicle), note)))
        self._stop.show(label, reasons["stop"], note)
