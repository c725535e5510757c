"""The network of ROS 2: topics that are published, and their messages, read by Cyclone DDS in a thread of its own."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from kreisel.devices.address import Address
from kreisel.errors import DeviceError, SettingsError

MESSAGES = 5000
"""Messages of a topic that may wait to be read. Chosen: more than a second of the fastest IMUs."""

_WAIT = 0.05
"""s after which the thread looks whether it shall end, and for new topics. Chosen: nobody waits for less."""

_PARTICIPANTS = 100  # of a domain on one machine, by Cyclone DDS's own limit of ports for each domain

Take = Callable[[str, str, bytes], None]
"""Called with a topic, its type, and the content of a message."""


@dataclass(frozen=True)
class Publisher:
    """A publisher of a topic: type of its messages, and whether it repeats what was lost, and keeps its last one."""

    topic: str
    kind: str
    reliable: bool
    kept: bool


def network_of(address: Address) -> str:
    """Return the configuration of Cyclone DDS for an address: its host is the interface of this machine that is used.

    Raises
    ------
    SettingsError
        If the host is not an address in numbers.
    """
    host, peers = address.host, [peer for peer in address.options.get("peers", "").split(",") if peer]
    if not all(part.replace(".", "").isdigit() for part in (host, *peers)):
        raise SettingsError(f"{address}: expected addresses in numbers, as 192.168.1.5, of this machine and of peers")
    if host == "0.0.0.0":
        interface = '<NetworkInterface autodetermine="true"/>'
    else:
        interface = f'<NetworkInterface address="{host}"/>'
    alone = host.startswith("127.")
    peers += [host] if alone else []
    listed = "".join(f'<Peer address="{peer}"/>' for peer in peers)
    return (
        f"<CycloneDDS><Domain><General><Interfaces>{interface}</Interfaces>"
        f"<AllowMulticast>{'false' if alone else 'default'}</AllowMulticast></General><Discovery>"
        f"<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>{_PARTICIPANTS}</MaxAutoParticipantIndex>"
        f"<Peers>{listed}</Peers></Discovery><Tracing><Verbosity>none</Verbosity></Tracing></Domain></CycloneDDS>"
    )


_domains: dict[int, tuple[str, Any]] = {}
"""Domains that this process has opened; Cyclone DDS configures each of them once."""


def participant_at(address: Address) -> Any:
    """Return a new participant in the domain of an address.

    Raises
    ------
    SettingsError
        If the Python package `cyclonedds` is missing, or another address uses the same domain in another way.
    DeviceError
        If the interface is not one of this machine.
    """
    try:
        from cyclonedds.core import DDSException
        from cyclonedds.domain import Domain, DomainParticipant
    except ImportError as error:
        raise SettingsError("ROS 2 needs Cyclone DDS: pip install 'kreisel[ros2]'") from error
    number, configuration = int(address.number("domain", 0, 0, 232)), network_of(address)
    used = _domains.get(number)
    if used is not None and used[0] != configuration:
        raise SettingsError(f"{address}: another address uses the domain {number} over other hosts; make them alike")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((address.host, 0))
        except OSError as error:
            raise DeviceError(f"{address}: {address.host} is not an address of this machine") from error
    try:
        if used is None:
            _domains[number] = (configuration, Domain(number, configuration))
        return DomainParticipant(number)
    except DDSException as error:
        raise DeviceError(f"{address}: the domain cannot be joined ({error.msg})") from error


class Network:
    """The topics of a domain that are read, in a thread, from the moment they are published.

    Parameters
    ----------
    topics
        Those that are read, as ROS 2 shows them to people, with a slash in front.
    take
        Called in the thread with each message.

    Attributes
    ----------
    publishers
        All that are known, by their identity.
    failure
        Why the thread has ended by itself; empty while it runs.
    """

    def __init__(self, address: Address, topics: tuple[str, ...], take: Take) -> None:
        self.publishers: dict[str, Publisher] = {}
        self.failure = ""
        self._participant, self._topics, self._take = participant_at(address), topics, take
        self._readers: dict[str, tuple[str, Any]] = {}
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._read, name="ros2", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._ends.set()
        self._thread.join()

    def _read(self) -> None:
        try:
            self._run()
        except Exception as error:  # a library's; without a report the device would only seem silent
            self.failure = f"{type(error).__name__}: {error}"

    def _run(self) -> None:
        from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
        from cyclonedds.util import duration

        whatever = ViewState.Any | InstanceState.Any | SampleState.NotRead
        found = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        waiting, wait = WaitSet(self._participant), duration(seconds=_WAIT)
        conditions = [ReadCondition(found, whatever)]
        waiting.attach(conditions[0])
        while not self._ends.is_set():
            waiting.wait(wait)
            for endpoint in found.take(N=100):
                reader = self._notice(endpoint)
                if reader is not None:
                    conditions.append(ReadCondition(reader, whatever))
                    waiting.attach(conditions[-1])
            for topic, (kind, reader) in self._readers.items():
                for message in reader.take(N=MESSAGES):
                    if hasattr(message, "data"):  # else a publisher that has gone
                        self._take(topic, kind, message.data)

    def _notice(self, endpoint: Any) -> Any:
        """Note a publisher that has come or gone; return a reader of its topic if it is wanted and was not read yet."""
        from cyclonedds.core import InstanceState, Policy

        from kreisel.devices.ros2_types import TYPES, shown

        identity = str(endpoint.key)
        if endpoint.sample_info.instance_state != InstanceState.Alive or not hasattr(endpoint, "qos"):
            self.publishers.pop(identity, None)
            return None
        topic, kind = endpoint.topic_name, shown(endpoint.type_name)
        if not topic.startswith("rt/"):
            return None
        policies = list(endpoint.qos)
        publisher = Publisher(
            topic[2:],
            kind,
            any(isinstance(policy, Policy.Reliability.Reliable) for policy in policies),
            Policy.Durability.TransientLocal in policies,
        )
        self.publishers[identity] = publisher
        if publisher.topic not in self._topics or publisher.topic in self._readers or kind not in TYPES:
            return None
        reader = self._reader(topic, publisher)
        self._readers[publisher.topic] = (kind, reader)
        return reader

    def _reader(self, topic: str, publisher: Publisher) -> Any:
        """Return a reader that asks for as much as the publisher offers."""
        from cyclonedds.core import Policy, Qos
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic
        from cyclonedds.util import duration

        from kreisel.devices.ros2_types import TYPES

        reliability = Policy.Reliability.Reliable(duration(seconds=1)) if publisher.reliable else None
        qos = Qos(
            reliability or Policy.Reliability.BestEffort,
            Policy.Durability.TransientLocal if publisher.kept else Policy.Durability.Volatile,
            Policy.History.KeepLast(MESSAGES),
        )
        return DataReader(self._participant, Topic(self._participant, topic, TYPES[publisher.kind]), qos=qos)
