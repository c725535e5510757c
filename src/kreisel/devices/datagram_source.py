"""The sender whose datagrams a port accepts: that of a stated host, or the first one, as long as it sends."""

from __future__ import annotations

HANDOVER_NS = 2_000_000_000
"""Silence of the accepted sender, ns, after which another port of its host is accepted: a restarted controller."""

SETTLED = 5
"""Telegrams after which only the same host can replace a sender; one that falls silent earlier is replaced by any."""

LOCKED_OUT = 10
"""Dropped datagrams from which on they are no stray ones."""

Sender = tuple[str, int]


class Source:
    """The sender a port accepts, and the number of datagrams from others.

    Parameters
    ----------
    host
        The only host that is accepted, as an IP address; None for any.

    Attributes
    ----------
    sender
        Host and port; None before the first telegram.
    dropped
        Number of datagrams of other senders.
    """

    def __init__(self, host: str | None = None) -> None:
        self._host = host
        self.sender: Sender | None = None
        self.dropped = 0
        self._count = 0
        self._last_ns = 0
        self._news: list[str] = []

    def takes(self, sender: Sender, now_ns: int) -> bool:
        """Return whether a datagram of a sender is accepted; count it if it is not."""
        if sender == self.sender or self._free(sender, now_ns):
            return True
        self.dropped += 1
        if str(self.dropped).strip("0") == "1":  # 1, 10, 100, …: so that the number of reports stays small
            other_host = self._host is not None and sender[0] != self._host
            accepted = self._host if other_host else f"{_name(self.sender or sender)}, which sent first"
            self._news.append(
                f"datagrams from {_name(sender)} dropped, {self.dropped} so far: this port accepts only {accepted}"
            )
        return False

    @property
    def locked_out(self) -> bool:
        """Whether another sender was turned away again and again, and no host is stated: it may be the robot."""
        return self._host is None and self.dropped >= LOCKED_OUT

    def keep(self, sender: Sender, now_ns: int) -> None:
        """Note a telegram of a sender that `takes` accepted."""
        if sender != self.sender:
            if self.sender is not None:
                silent = (now_ns - self._last_ns) * 1e-9
                self._news.append(
                    f"{_name(self.sender)} was silent for {silent:.1f} s; now {_name(sender)} is accepted"
                )
            self.sender, self._count = sender, 0
        self._count += 1
        self._last_ns = now_ns

    def news(self) -> list[str]:
        """Return the reports since the last call."""
        news, self._news = self._news, []
        return news

    def _free(self, sender: Sender, now_ns: int) -> bool:
        """Return whether a new sender may replace the present one."""
        if self._host is not None and sender[0] != self._host:
            return False
        if self.sender is None:
            return True
        same_host = sender[0] == self.sender[0]
        return now_ns - self._last_ns > HANDOVER_NS and (same_host or self._count < SETTLED)


def _name(sender: Sender) -> str:
    return f"{sender[0]}:{sender[1]}"
