"""The policy of servers' connections, by a clock of the test's own."""

import asyncio
import contextlib
import gc
import logging
import math
import socket

import numpy as np
import pytest
from waiting import PATIENCE

from bulletuav.serving.connections import ACCEPT_RETRY, ConnectionLimits, Connections, FullError
from bulletuav.serving.refusals import Refusals
from bulletuav.serving.streams import StreamServer


class Clock:
    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


def test_a_new_connection_evicts_the_pending_one_that_is_idle_longest(clock):
    kept = Connections(ConnectionLimits(max_pending=2), clock)
    for key in "abcd":
        clock.now += 1
        evicted = kept.add(key)
        assert evicted == {"c": "a", "d": "b"}.get(key)
    assert kept.all() == ["c", "d"]
    assert kept.clients() == []


def test_no_number_of_pending_connections_evicts_a_client(clock):
    kept = Connections(ConnectionLimits(max_clients=1, max_pending=3), clock)
    kept.add("client")
    assert kept.request("client") is None
    clock.now = 1e6
    for k in range(1000):
        kept.add(k)
    assert kept.is_client("client")
    assert len(kept) == 4
    assert kept.overdue() == []


def test_a_new_client_evicts_the_one_that_is_idle_longest_if_it_is_idle_at_all(clock):
    kept = Connections(ConnectionLimits(max_clients=3, grace=60.0), clock)
    for key in "abc":
        kept.request(key)
        clock.now += 1
    kept.add("d")
    with pytest.raises(FullError, match="3 others are connected"):
        kept.request("d")
    assert not kept.is_client("d")
    kept.wait("a")  # it waits for a motion to end
    clock.now += 500
    kept.request("c")
    assert kept.request("d") == "b"
    assert kept.clients() == ["a", "c", "d"]
    with pytest.raises(FullError):
        kept.request("e")
    kept.wait("a", -1)
    clock.now += 30
    with pytest.raises(FullError):
        kept.request("e")
    clock.now += 30
    kept.touch("a")
    assert kept.request("e") == "c"


def test_clients_that_wait_make_room_after_all_others_but_not_never(clock):
    kept = Connections(ConnectionLimits(max_clients=2, grace=60.0, max_wait=600.0), clock)
    for key in "ab":
        kept.request(key)
        kept.wait(key)
        clock.now += 1
    clock.now = 599.0
    with pytest.raises(FullError):
        kept.request("c")
    clock.now = 600.5
    assert kept.request("c") == "a"
    clock.now = 1300.0
    assert kept.request("d") == "c"  # which waits for nothing, though "b" is idle longer
    assert kept.clients() == ["b", "d"]


def test_pending_connections_have_a_time_for_their_first_request_and_clients_one_for_each(clock):
    kept = Connections(ConnectionLimits(handshake=10.0, max_idle=100.0), clock)
    kept.add("pending")
    kept.request("client")
    kept.request("waiting")
    kept.wait("waiting")
    clock.now = 10.0
    assert kept.overdue() == []
    clock.now = 10.1
    assert kept.overdue() == ["pending"]
    kept.remove("pending")
    kept.remove("pending")
    kept.wait("pending", -1)
    kept.touch("pending")
    clock.now = 101.0
    assert kept.overdue() == ["client"]
    clock.now = 601.0
    assert kept.overdue() == ["client", "waiting"]
    assert ConnectionLimits().max_idle == math.inf


def test_silent_connections_are_spared_where_the_system_has_no_room(clock):
    kept = Connections(ConnectionLimits(), clock)
    kept.request("client")
    kept.add("silent")
    clock.now = ACCEPT_RETRY
    kept.add("new")
    assert kept.spare() == ["silent"]
    assert kept.all() == ["client", "new"]


def test_a_pending_peer_that_is_heard_again_has_a_grace_time(clock):
    kept = Connections(ConnectionLimits(max_pending=1, pending_grace=3.0), clock)
    kept.add("a")
    clock.now = 2.9
    with pytest.raises(FullError):
        kept.add("b")
    kept.touch("a")
    clock.now = 5.8
    with pytest.raises(FullError):
        kept.add("b")
    clock.now = 6.0
    assert kept.add("b") == "a"


def test_any_order_of_events_keeps_the_limits(clock):
    """Clients never exceed their places, nor pending ones theirs; none is in both."""
    limits = ConnectionLimits(max_clients=5, max_pending=3, grace=2.0, pending_grace=1.0)
    kept, rng = Connections(limits, clock), np.random.default_rng(0)
    for _ in range(5000):
        clock.now += rng.random()
        key, before = int(rng.integers(20)), set(kept.clients())
        match rng.integers(5):
            case 0 if key not in kept:
                try:
                    kept.add(key)
                except FullError:
                    assert len(kept) - len(before) == 3
                assert set(kept.clients()) == before
            case 1 | 2:
                try:
                    evicted = kept.request(key)
                    assert evicted is None or (evicted in before and evicted not in kept)
                except FullError:
                    assert len(before) == 5
                    assert set(kept.clients()) == before
            case 3:
                kept.remove(key)
            case 4:
                kept.touch(key)
        assert len(kept.clients()) <= 5
        assert len(kept) - len(kept.clients()) <= 3


@pytest.mark.parametrize("rounds", range(8))
def test_a_connection_that_comes_as_the_server_stops_is_closed(rounds):
    """Whatever round of the loop its acceptance has got to: an open one would be a warning."""

    async def talk(stream):
        await stream.reader.read()

    async def check():
        log = Refusals(logging.getLogger("bulletuav.test"))
        server = StreamServer(talk, ConnectionLimits(linger=0.1), log)
        listening = socket.create_server(("127.0.0.1", 0))
        await server.start(listening)
        with socket.create_connection(listening.getsockname(), timeout=PATIENCE) as client:
            for _ in range(rounds):
                await asyncio.sleep(0)
            await server.stop()
            with contextlib.suppress(ConnectionError):
                assert client.recv(1) == b""
        assert len(server.connections) == 0

    asyncio.run(check())
    gc.collect()
