"""Commands that only ask: a message once, a message at a rate, the rate of a message. Anyone may.

======================================  =======================================
REQUEST_MESSAGE (512)                   the message with id parameter 1, once
SET_MESSAGE_INTERVAL (511)              parameter 1: id, parameter 2: us
GET_MESSAGE_INTERVAL (510)              MESSAGE_INTERVAL of id parameter 1
GET_HOME_POSITION (410)                 HOME_POSITION
REQUEST_AUTOPILOT_CAPABILITIES (520)    AUTOPILOT_VERSION
======================================  =======================================
"""

from __future__ import annotations

import math

from mufly.link.call import Call, Verdict
from mufly.link.dialect import MavMessage, mavlink
from mufly.link.streams import Wishes

__all__ = ["ENQUIRIES", "enquire"]

_GLOBAL = (
    mavlink.MAVLINK_MSG_ID_HOME_POSITION,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
)
ENQUIRIES = (
    mavlink.MAV_CMD_REQUEST_MESSAGE,
    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
    mavlink.MAV_CMD_GET_MESSAGE_INTERVAL,
    mavlink.MAV_CMD_GET_HOME_POSITION,
    mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES,
)
"""The commands of this table."""


def enquire(now_s: float, call: Call, wishes: Wishes, has_origin: bool) -> tuple[Verdict, list[MavMessage]]:
    """Answer one.

    Parameters
    ----------
    now_s : float
    call : Call
    wishes : Wishes
        Of the peer that asks.
    has_origin : bool
        Whether there is anything to tell about the globe.

    Returns
    -------
    verdict : Verdict
    messages : list
        To be sent at once, before those that the wishes hold.
    """
    accepted = Verdict(mavlink.MAV_RESULT_ACCEPTED)
    if call.number == mavlink.MAV_CMD_GET_HOME_POSITION:
        number = mavlink.MAVLINK_MSG_ID_HOME_POSITION
    elif call.number == mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
        number = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
    else:
        number = int(call.p[0]) if 0.0 <= call.p[0] < 2**24 else -1
    if call.number == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
        known = not math.isnan(call.p[1]) and wishes.set_interval(now_s, number, call.p[1])
        return (accepted if known else Verdict(mavlink.MAV_RESULT_UNSUPPORTED)), []
    if call.number == mavlink.MAV_CMD_GET_MESSAGE_INTERVAL:
        known = wishes.known(number)
        answer = mavlink.MAVLink_message_interval_message(
            number if 0 <= number < 65536 else 0, wishes.interval_us(number)
        )
        return (accepted if known else Verdict(mavlink.MAV_RESULT_UNSUPPORTED)), [answer]
    if number in _GLOBAL and not has_origin:
        return Verdict(mavlink.MAV_RESULT_DENIED), []
    return (accepted if wishes.ask_once(number) else Verdict(mavlink.MAV_RESULT_UNSUPPORTED)), []
