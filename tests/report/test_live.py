"""Live pages: the feed of flights to any number of browsers, without one."""

import contextlib
import http.client
import json
import logging
import socket
import threading
import time

import numpy as np
import pytest
from payload_block import Block
from waiting import PATIENCE, until

import bulletuav
from bulletuav.cli import main
from bulletuav.envs.viewer import join_address, parse_address
from bulletuav.report import feed as feeds
from bulletuav.report.feed import Feed, event
from bulletuav.serving.connections import ConnectionLimits

FREE = "127.0.0.1:0"
SHORT = {"num_drones": 3, "dynamics": "point_mass", "horizon": 20}


class Watcher:
    """A browser, as far as a feed knows."""

    def __init__(self, address, path="/feed", **headers):
        self.connection = http.client.HTTPConnection(address, timeout=PATIENCE)
        self.connection.request("GET", path, headers=headers)
        self.answer = self.connection.getresponse()

    def next(self):
        """Name and data of the next event."""
        while True:
            lines = []
            while not lines or lines[-1]:
                lines.append(self.answer.readline().decode().rstrip("\n"))
            if not lines[0].startswith(":"):  # compiling takes long, in which nothing is new
                return lines[0].removeprefix("event: "), lines[1].removeprefix("data: ")

    def leave(self):
        self.answer.close()
        self.connection.close()


@pytest.fixture
def env(turns):
    env = bulletuav.Aviary("crossing", render_mode="web", render_address=FREE, **SHORT)
    yield env
    env.close()


def watch(env, count=1):
    """Let watchers come."""
    feed = env.viewer.feed
    came = [Watcher(feed.address) for _ in range(count)]
    until(lambda: len(feed._viewers) == count)
    return came


def actions(env, row):
    return np.random.default_rng(row).uniform(-1, 1, env.given.shape)


def test_a_viewer_sees_the_whole_flight_from_a_reset_on(env, turns):
    (watcher,) = watch(env)
    env.reset(seeds=3)
    places = [env.swarm.position[0].copy()]
    for row in range(4):
        step = env.step(actions(env, row))
        places.append(env.swarm.position[0].copy())
        name, data = watcher.next()
        assert name == ("rows" if row else "start")
        block = Block(data)
        shown, size = block.series("position")
        wanted = np.array(places[-2:]).reshape(2, -1)
        assert (np.abs(shown - wanted) <= size + 1e-4).all()
        np.testing.assert_allclose(block.array("time"), [0.1 * row, 0.1 * (row + 1)], atol=1e-6)
        if row:
            assert set(block.about) == {"rows", "arrays"}
        else:
            assert block.about["title"] == "crossing: 3 drones, live"
            by_title = {chart["title"]: chart["lines"][0] for chart in block.about["charts"]}
        told, _ = block.series(by_title["reward"]["series"])
        np.testing.assert_allclose(told[1], step.rewards[0], rtol=1e-4)
    assert turns == [0.1] * 4
    # A new episode begins anew.
    env.reset(seeds=4)
    env.step(actions(env, 0))
    name, data = watcher.next()
    assert name == "start"
    assert Block(data).array("time")[0] == 0
    env.close()
    assert watcher.next()[0] == "over"
    assert watcher.answer.read() == b""


def test_several_come_and_go_and_the_flight_goes_on(env, turns):
    first, second = watch(env, 2)
    env.reset(seeds=0)
    for row in range(2):
        env.step(actions(env, row))
    assert [first.next()[0], first.next()[0]] == ["start", "rows"]
    late = Watcher(env.viewer.feed.address)
    until(lambda: len(env.viewer.feed._viewers) == 3)
    env.step(actions(env, 2))
    assert first.next()[0] == "rows"
    name, data = late.next()
    assert name == "start"
    np.testing.assert_allclose(Block(data).array("time"), [0.2, 0.3], atol=1e-6)
    for watcher in (first, late):
        watcher.leave()
    # That a viewer has left is noticed where it is written to.
    while len(env.viewer.feed._viewers) > 1:
        env.step(actions(env, 3))
        if not env.alive.any():
            env.reset()
        time.sleep(0.002)
    assert [second.next()[0] for _ in range(3)] == ["start", "rows", "rows"]
    second.leave()
    while env.viewer.feed.is_watched:
        env.step(actions(env, 3))
        if not env.alive.any():
            env.reset()
        time.sleep(0.002)
    env.step(actions(env, 4))
    # Nobody watches: nothing waits, nothing is kept.
    turns.clear()
    for row in range(3):
        env.step(actions(env, row))
    assert turns == []
    assert env.viewer._recorder is None


def test_a_flight_is_the_same_with_viewers_and_without(env):
    plain = bulletuav.Aviary("crossing", **SHORT)
    watch(env)
    for one in (plain, env):
        one.reset(seeds=5)
        for row in range(5):
            step = one.step(actions(one, row))
        one.last = (step.rewards, step.observations)
    assert env.state_hash() == plain.state_hash()
    for ours, theirs in zip(env.last, plain.last, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    plain.close()


def test_a_viewer_that_does_not_read_is_dropped(caplog):
    """It never makes the flight wait, and others see everything."""
    feed = Feed("127.0.0.1", 0, lambda: "", ConnectionLimits(max_unread=4_000_000))
    asleep, awake = Watcher(feed.address), Watcher(feed.address)
    until(lambda: len(feed._viewers) == 2)
    news = event("rows", "x" * 500_000)
    sent = 0
    while len(feed._viewers) > 1:
        feed.send(news, lambda: event("start", "x"))
        sent += 1
        assert awake.next()[0] == ("start" if sent == 1 else "rows")
    assert 8 <= sent < 50
    assert feed.is_watched
    assert "bytes unread" in caplog.text
    asleep.leave()
    feed.close()
    feed.close()
    assert awake.next()[0] == "over"


def test_viewers_that_read_nothing_cost_no_threads_and_no_more_memory_than_is_allowed():
    """70 of them; those who read get everything, and a late one gets in when others stall."""
    now = [0.0]
    limits = ConnectionLimits(max_clients=64, max_unread=100_000, max_stall=10.0, grace=10.0)
    feed = Feed("127.0.0.1", 0, lambda: "", limits, lambda: now[0])
    before = threading.active_count()
    asleep = [http.client.HTTPConnection(feed.address, timeout=PATIENCE) for _ in range(70)]
    for connection in asleep:
        connection.connect()
        # The system keeps less for it
        connection.sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.request("GET", "/feed")
    until(lambda: len(feed._viewers) == 64)
    assert threading.active_count() == before
    news = event("rows", "x" * 50_000)
    for _ in range(40):
        feed.send(news, lambda: news)
        assert sum(one.unread for one in feed.connections.all()) <= 64 * 150_000
    until(lambda: not feed.is_watched)
    watcher = Watcher(feed.address)
    assert watcher.answer.status == 200
    feed.close()
    for connection in asleep:
        connection.close()
    watcher.leave()


def test_a_stalled_viewer_is_dropped_in_time():
    now = [0.0]
    feed = Feed("127.0.0.1", 0, lambda: "", ConnectionLimits(max_stall=10.0), lambda: now[0])
    asleep, awake = Watcher(feed.address), Watcher(feed.address)
    until(lambda: len(feed._viewers) == 2)
    feed.send(event("rows", "x" * 10_000_000), lambda: event("start", "x" * 10_000_000))
    assert awake.next()[0] == "start"

    def later():
        now[0] += 6.0
        time.sleep(0.5)
        feed.send(event("rows"), lambda: event("start"))
        assert awake.next()[0] == "rows"
        return len(feed._viewers) == 1

    until(later)
    asleep.leave()
    feed.close()
    awake.leave()


@pytest.fixture
def feed():
    feed = Feed("127.0.0.1", 0, lambda: "the page", ConnectionLimits(handshake=0.5, linger=0.2))
    yield feed
    feed.close()


def ask(feed, data):
    """Send bytes; return all that is answered until the connection ends."""
    host, port = parse_address(feed.address)
    with socket.create_connection((host, port), timeout=PATIENCE) as one:
        one.sendall(data)
        found = b""
        with contextlib.suppress(ConnectionError):
            while more := one.recv(65536):
                found += more
        return found


@pytest.mark.parametrize(
    ("data", "status"),
    [
        (b"", b""),
        (b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n", b""),
        (b"\x16\x03\x01\x02\x00" * 10, b""),
        (b"GET /" + b"x" * 100_000, b"400"),
        (b"GET / HTTP/1.1\r\n" + b"A: b\r\n" * 1000 + b"\r\n", b"400"),
        (b"\xff\xfe\r\n\r\n", b"400"),
        (b"GET /\r\n\r\n", b"400"),
        (b"GET / HTTP/9\r\nHost: 127.0.0.1\r\n\r\n", b"505"),
        (b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", b"405"),
        (b"GET /feed HTTP/1.1\r\nHost: evil.example\r\n\r\n", b"403"),
        (b"GET /feed HTTP/1.1\r\n\r\n", b"403"),
        (b"GET /feed HTTP/1.1\r\nHost: 10.1.2.3\r\n\r\n", b"403"),
        (b"GET /feed HTTP/1.1\r\nHost: 127.0.0.1\r\nHost: evil.example\r\n\r\n", b"400"),
        (b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: a\r\norigin: b\r\n\r\n", b"400"),
        (b"GET / HTTP/1.1\r\nHost: 127.0.0.1:80@evil.example\r\n\r\n", b"403"),
        (b"GET / HTTP/1.1\r\nHost: 127.0.0.1:x\r\n\r\n", b"403"),
        (b"GET / HTTP/1.1\r\nHost: [::1]evil.example\r\n\r\n", b"403"),
        (b"GET / HTTP/1.1\r\nHost: LOCALHOST:99\r\n\r\n", b"200"),
        (b"GET / HTTP/1.1\r\nHost: [::1]\r\n\r\n", b"200"),
    ],
)
def test_requests_that_cannot_be_are_answered_by_an_error_or_ended(feed, data, status):
    answer = ask(feed, data)
    assert answer.split(b" ")[1:2] == ([status] if status else [])
    assert not feed.is_watched


PAGE = {"Host": "127.0.0.1:80"}


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Origin": "https://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": "http://127.0.0.1:81"}, 403),
        ({"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"}, 403),
        ({"Sec-Fetch-Site": "same-site", "Sec-Fetch-Mode": "cors"}, 403),
        (
            {
                "Sec-Fetch-Site": "cross-site",
                "Sec-Fetch-Mode": "navigate",
                "Sec-Fetch-Dest": "iframe",
            },
            403,
        ),
        (
            {
                "Sec-Fetch-Site": "cross-site",
                "Sec-Fetch-Mode": "navigate",
                "Sec-Fetch-Dest": "document",
            },
            200,
        ),
        ({"Origin": "http://127.0.0.1:80", "Sec-Fetch-Site": "same-origin"}, 200),
    ],
)
def test_pages_of_other_sites_cannot_watch(feed, headers, status):
    """A flight that is watched keeps real time, so that a page could slow a training."""
    watcher = Watcher(feed.address, "/feed", **PAGE, **headers)
    assert watcher.answer.status == status
    watcher.leave()


def test_other_machines_ask_by_address_or_by_this_machines_name(monkeypatch):
    """Served to all, a name that others made point here is refused all the same."""
    monkeypatch.setattr(socket, "gethostname", lambda: "lab7")
    feed = Feed("0.0.0.0", 0, lambda: "the page")
    known = ("192.0.2.1:80", "[2001:db8::1]:80", "lab7:80", "lab7.local", "localhost")
    assert all(feed.accepts_host(host) for host in known)
    assert not any(feed.accepts_host(host) for host in ("evil.example:80", "lab7.evil.example", ""))
    feed.close()


def test_a_long_flight_begins_anew_before_pages_are_full(env, monkeypatch):
    monkeypatch.setattr("bulletuav.report.live.MAX_TRAIL_SEGMENTS", 10)
    (watcher,) = watch(env)
    env.reset(seeds=0)
    for row in range(9):
        env.step(actions(env, row))
    names = [watcher.next()[0] for _ in range(8)]
    assert names == ["start", "rows", "rows", "rows", "start", "rows", "rows", "rows"]


def test_the_page_connects_to_its_server_alone(env):
    page = Watcher(env.viewer.feed.address, "/").answer.read().decode()
    assert "connect-src 'self';" in page
    assert 'id="payload"></script>' in page
    assert Watcher(env.viewer.feed.address, "/run.json").answer.status == 404
    # A name that others made point to this machine
    assert Watcher(env.viewer.feed.address, "/", Host="evil.example:80").answer.status == 403
    assert Watcher(env.viewer.feed.address, "/", Host="localhost:1").answer.status == 200


def test_there_are_bounds_to_how_many_watch():
    feed = Feed("127.0.0.1", 0, lambda: "the page", ConnectionLimits(max_clients=1))
    watcher = Watcher(feed.address)
    assert watcher.answer.status == 200
    other = Watcher(feed.address)
    assert other.answer.status == 503
    assert "1 others are connected, which is the limit: try later" in other.answer.read().decode()
    assert Watcher(feed.address, "/").answer.read() == b"the page"
    feed.close()
    watcher.leave()


def test_a_page_that_has_the_head_of_the_feed_watches():
    """It misses no event that is sent from then on."""
    feed = Feed("127.0.0.1", 0, lambda: "the page")
    watchers = []
    for count in range(1, 31):
        watchers.append(Watcher(feed.address))
        assert len(feed._viewers) == count
    feed.close()
    for watcher in watchers:
        watcher.leave()


def test_silent_connections_lock_no_viewer_out():
    feed = Feed("127.0.0.1", 0, lambda: "the page", ConnectionLimits(max_pending=4))
    silent = [socket.create_connection(parse_address(feed.address)) for _ in range(20)]
    watcher = Watcher(feed.address)
    until(lambda: feed.is_watched)
    feed.send("", lambda: event("start"))
    assert watcher.next()[0] == "start"
    feed.close()
    for one in (*silent, watcher.connection):
        one.close()


def test_a_silent_feed_finds_out_who_has_left(env, monkeypatch):
    monkeypatch.setattr(feeds, "KEEPALIVE_INTERVAL", 0.01)
    (watcher,) = watch(env)
    assert watcher.answer.readline() == b": nothing new\n"
    watcher.leave()
    until(lambda: not env.viewer.feed.is_watched)


def test_requests_are_logged_by_name_and_nothing_is_printed(env, caplog, capfd):
    with caplog.at_level(logging.DEBUG, logger="bulletuav"):
        assert Watcher(env.viewer.feed.address, "/").answer.status == 200
    assert {record.name for record in caplog.records} == {"bulletuav.live"}
    assert "GET / HTTP/1.1" in caplog.text
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("host", "shown"), [("127.0.0.1", "127.0.0.1"), ("::1", "[::1]"), ("localhost", "localhost")]
)
def test_addresses(host, shown):
    if host == "::1" and not socket.has_ipv6:
        pytest.skip("this system has no IPv6")
    feed = Feed(host, 0, lambda: "the page")
    assert feed.address.startswith(f"{shown}:")
    assert Watcher(feed.address, "/").answer.read() == b"the page"
    feed.close()


def test_what_cannot_be_is_one_line(capsys, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        used = f"127.0.0.1:{port}"
        with pytest.raises(OSError, match=f"live page at 127.0.0.1, port {port}: .*another port"):
            bulletuav.Aviary("crossing", render_mode="web", render_address=used, **SHORT)
        words = ["fly", "crossing", "--dynamics", "point_mass", "--out", str(tmp_path), "--live"]
        with pytest.raises(SystemExit) as end:
            main([*words, used])
        assert end.value.code == 2
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert f"port {port}" in line
    for wrong in ("8765", "host:", ":80", "host:port", "host:99999", 80, "a:-1"):
        with pytest.raises(ValueError, match=r"render_address"):
            parse_address(wrong)
    assert parse_address("[::1]:80") == ("::1", 80)
    assert parse_address(join_address("::1", 80)) == ("::1", 80)
    stages = [{"num_drones": 2}, {"num_drones": 3}]
    with pytest.raises(ValueError, match="'web', and there are 2 stages"):
        bulletuav.curriculum_env("crossing", stages, render_mode="web")
    with pytest.raises(ValueError, match="workers=1"):
        bulletuav.batch_env("crossing", 2, workers=2, render_mode="web")
    with pytest.raises(ValueError, match="live views show tasks"):
        bulletuav.Airspace([(0.0, 0.0, 1.0)], render_mode="web")


def test_flying_live_writes_the_same_flight(turns, tmp_path, monkeypatch, capsys):
    events = []

    def come(self, seconds=None):
        watcher = Watcher(self.address)

        def read():
            while not events or events[-1] != "over":
                events.append(watcher.next()[0])

        threading.Thread(target=read, daemon=True).start()
        until(lambda: self.is_watched)

    monkeypatch.setattr(Feed, "wait", come)
    words = ["fly", "crossing", "--drones", "2", "--dynamics", "point_mass", "--horizon", "5"]
    words += ["--animation", "none", "--out"]
    main([*words, str(tmp_path / "live"), "--live", FREE])
    assert "open http://127.0.0.1:" in capsys.readouterr().out
    until(lambda: events[-1:] == ["over"])
    assert events == ["start", "rows", "rows", "rows", "rows", "over"]
    main([*words, str(tmp_path / "plain")])
    live, plain = (
        json.loads((tmp_path / name / "run.json").read_text()) for name in ("live", "plain")
    )
    assert (live["hash"], live["call"]) == (plain["hash"], plain["call"])
