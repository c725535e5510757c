"""Which sender a port takes datagrams from."""

from kreisel.devices.datagram_source import HANDOVER_NS, LOCKED_OUT, SETTLED, Source

FIRST, OTHER, RESTARTED = ("10.0.0.1", 4000), ("10.0.0.2", 4000), ("10.0.0.1", 4001)
CYCLE_NS = 4_000_000


def kept(telegrams=SETTLED):
    """Return a source that took so many telegrams of the first sender, and the time of the last."""
    source = Source()
    for k in range(telegrams):
        assert source.takes(FIRST, k * CYCLE_NS)
        source.keep(FIRST, k * CYCLE_NS)
    return source, (telegrams - 1) * CYCLE_NS


def test_others_are_dropped_counted_and_reported_a_few_times_only():
    source, now = kept()
    for _ in range(150):
        assert not source.takes(OTHER, now + CYCLE_NS)
        assert not source.takes(RESTARTED, now + CYCLE_NS)
    assert source.takes(FIRST, now + CYCLE_NS)
    assert source.dropped == 300
    news = source.news()
    assert len(news) == 3
    assert "10.0.0.2:4000 dropped, 1 so far: this port accepts only 10.0.0.1:4000" in news[0]
    assert source.news() == []


def test_another_port_of_the_same_host_is_taken_after_silence():
    source, now = kept()
    assert not source.takes(RESTARTED, now + HANDOVER_NS)
    assert not source.takes(OTHER, now + 100 * HANDOVER_NS)
    source.news()
    assert source.takes(RESTARTED, now + HANDOVER_NS + 1)
    source.keep(RESTARTED, now + HANDOVER_NS + 1)
    assert source.sender == RESTARTED
    assert source.news() == ["10.0.0.1:4000 was silent for 2.0 s; now 10.0.0.1:4001 is accepted"]
    assert not source.takes(FIRST, now + HANDOVER_NS + 2)


def test_a_sender_of_a_few_telegrams_is_given_up_for_any_other():
    source, now = kept(SETTLED - 1)
    assert not source.takes(OTHER, now + HANDOVER_NS)
    assert source.takes(OTHER, now + HANDOVER_NS + 1)


def test_a_stated_host_is_the_only_one_whoever_speaks_first():
    source = Source("10.0.0.1")
    for k in range(50):
        assert not source.takes(OTHER, k * CYCLE_NS)
    assert "this port accepts only 10.0.0.1" in source.news()[0]
    assert source.takes(FIRST, 50 * CYCLE_NS)
    source.keep(FIRST, 50 * CYCLE_NS)
    assert not source.takes(OTHER, 100 * HANDOVER_NS)
    assert not source.locked_out  # nobody who may be the robot was turned away


def test_a_sender_that_goes_on_beside_the_first_may_be_the_robot():
    source, now = kept()
    for k in range(LOCKED_OUT):
        assert not source.locked_out
        assert not source.takes(OTHER, now + k * CYCLE_NS)
    assert source.locked_out
