"""What the messages of one instant are made from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mufly.link.geodesy import Origin
from mufly.link.on_arming import Choice

if TYPE_CHECKING:
    from mufly.flight import FlightView, Status

__all__ = ["Airframe", "Picture", "Progress"]


@dataclass(frozen=True, slots=True)
class Airframe:
    """What messages say of the vehicle that never changes.

    Attributes
    ----------
    first_beam_rad, beams, min_range_m, max_range_m : float, int
        The ring of range beams.
    nominal_V, low_V : float
        Battery.
    """

    first_beam_rad: float
    beams: int
    min_range_m: float
    max_range_m: float
    nominal_V: float
    low_V: float


@dataclass(frozen=True, slots=True)
class Progress:
    """Where the mission stands: the item that is current, how many there are, MISSION_STATE, and MISSION_MODE."""

    item: int
    total: int
    state: int
    mode: int


@dataclass(frozen=True, slots=True)
class Picture:
    """One instant of the vehicle, as messages tell it.

    Attributes
    ----------
    view : FlightView
        What it measures, follows and does.
    status : Status
        What it is up to.
    ready : bool
        Whether it could be armed.
    returning : bool
        Whether it is on its way home.
    progress : Progress
        Of its mission.
    airframe : Airframe
    origin : Origin or None
        Where on the globe it is.
    chosen : str
        The mode that was chosen on the floor, for when it is armed; "" if none.
    commander : int
        system * 256 + component of who commands; 0: nobody.
    loss : float
        Share of the packets from its stations that were lost, 0..1.
    """

    view: FlightView
    status: Status
    ready: bool
    returning: bool
    progress: Progress
    airframe: Airframe
    origin: Origin | None
    chosen: Choice
    commander: int
    loss: float

    @property
    def boot_ms(self) -> int:
        """The vehicle's clock (ms), as an unsigned number of 32 bits; never 0, which readers take for "not known"."""
        return max(1, round(self.view.time_s * 1e3) % 2**32)

    @property
    def usec(self) -> int:
        """The vehicle's clock (us), never 0."""
        return max(1, round(self.view.time_s * 1e6))
