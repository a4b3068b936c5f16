"""The mission protocol, both ends of it, as two machines that know neither sockets nor what an item means.

Whoever has the items is a :class:`Sender`, whoever wants them a :class:`Receiver` (mavlink.io, "Mission Protocol")::

    upload      Sender (station)            Receiver (vehicle)        download    Receiver (station)    Sender (vehicle)
                Count          ─────▶                                             RequestList   ─────▶
                               ◀─────       RequestItem 0                                       ◀─────  Count
                Item 0         ─────▶                                             RequestItem 0 ─────▶
                               ◀─────       RequestItem 1 ...                                   ◀─────  Item 0 ...
                               ◀─────       Ack                                   Ack           ─────▶

Packets get lost, doubled, late and out of order. The receiver holds the reins: it asks for one item after the other,
asks again when none comes, and passes over items that it does not wait for. What it has is given away once, when it is
whole. MAVLink does not say which transfer an item belongs to; so that two missions are not mixed, a receiver that
begins anew first lets the packets of the last transfer run dry (`SETTLE_S`), and a sender that does so first tells the
receiver to stop (`HUSH_S`): else its items could be taken as the answer to the requests of the transfer before.

An answer is expected after a round trip; the time after which it is asked for again follows the round trips seen.
"""

from __future__ import annotations

from mufly.link.transfer_pace import GIVE_UP_S
from mufly.link.transfer_receive import LIMIT, SETTLE_S, Receiver
from mufly.link.transfer_send import HUSH_S, Sender

__all__ = ["GIVE_UP_S", "HUSH_S", "LIMIT", "SETTLE_S", "Receiver", "Sender"]
