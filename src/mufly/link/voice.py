"""What the vehicle says, and to whom: packs messages for each peer and keeps them until they are sent."""

from __future__ import annotations

from collections.abc import Hashable

from mufly.link.authority import Sender
from mufly.link.clients import Clients
from mufly.link.codec import Outgoing
from mufly.link.dialect import MavMessage
from mufly.link.texts import Texts

__all__ = ["Voice"]

_TELL_EVERY_S = 2.0


class Voice:
    """Speaks to all peers.

    Parameters
    ----------
    system, component : int
        Who the vehicle is.

    Attributes
    ----------
    clients : Clients
        The peers.
    """

    def __init__(self, system: int, component: int) -> None:
        self.clients = Clients(system, component)
        self._texts = Texts()
        self._out: list[Outgoing] = []

    def send(self, peer: Hashable | None, message: MavMessage) -> None:
        """Send a message to a peer; to all if None."""
        for client in self.clients:
            if peer is None or client.peer == peer:
                self._out.append(Outgoing(client.peer, client.encode(message)))

    def say(self, text: str, level: str = "info", peer: Hashable | None = None) -> None:
        """Say a line to a peer; to all if None."""
        for message in self._texts(text, level):
            self.send(peer, message)

    def tell(self, now_s: float, sender: Sender, why: str) -> None:
        """Tell a station why something is refused, but not with every message of a stream."""
        client = self.clients.get(sender.peer)
        if why and client is not None and now_s - client.told_s > _TELL_EVERY_S:
            client.told_s = now_s
            self.say(why, "warning", sender.peer)

    def taken(self) -> list[Outgoing]:
        """Hand over what is to be sent."""
        out, self._out = self._out, []
        return out
