"""One link that several simulated vehicles hear and speak on, as on a radio."""

from __future__ import annotations

from edge.telemetry.link import Link


class SharedLink:
    """The part of one vehicle: it hears everything that arrives, as each other part of `shared` does."""

    def __init__(self, link: Link, parts: list[SharedLink]) -> None:
        self._link, self._parts = link, parts
        self._heard = b""
        parts.append(self)

    def receive(self) -> bytes:
        """What has arrived since this part's last call."""
        arrived = self._link.receive()
        for part in self._parts:
            part._heard += arrived
        heard, self._heard = self._heard, b""
        return heard

    def send(self, data: bytes) -> bool:
        """See Link."""
        return self._link.send(data)

    def fileno(self) -> int:
        """See Link."""
        return self._link.fileno()

    def close(self) -> None:
        """The link itself stays open."""


def shared(link: Link, count: int) -> list[SharedLink]:
    """A link's parts for so many vehicles."""
    parts: list[SharedLink] = []
    return [SharedLink(link, parts) for _ in range(count)]
