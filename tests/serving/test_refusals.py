"""The log of refusals: once for each client and kind, of any text, in bounded memory and space."""

import logging

import pytest

from bulletuav.serving import refusals as module
from bulletuav.serving.refusals import (
    MAX_KINDS,
    MAX_LINES,
    MAX_TEXT,
    PERIOD,
    LineLimit,
    Refusals,
    escape_line,
)


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def refusals(clock):
    return Refusals(logging.getLogger("bulletuav.test"), clock)


def lines(caplog):
    return [record.getMessage() for record in caplog.records]


def test_each_kind_is_logged_once_for_each_client(refusals, caplog):
    for client in ("a:1", "b:2"):
        for height in range(3):
            refusals.log(client, "takeoff", f"{height}.5e-3 m is too high")
            refusals.log(client, "land", "Drone1 does not fly")
            refusals.log(client, "land", "Drone2 does not fly")
    told = [
        "takeoff refused: 0.5e-3 m is too high",
        "land refused: Drone1 does not fly",
        "land refused: Drone2 does not fly",
    ]
    assert lines(caplog) == [f"client {one}: {line}" for one in ("a:1", "b:2") for line in told]
    refusals.forget("a:1")
    refusals.log("a:1", "land", "Drone1 does not fly")
    assert len(caplog.records) == 7


def test_kinds_and_clients_are_bounded(refusals, clock, caplog, monkeypatch):
    monkeypatch.setattr(module, "MAX_CLIENTS", 64)
    for k in range(3 * MAX_KINDS):
        refusals.log("a:1", f"call{k}", "unknown")
    assert len(caplog.records) == MAX_KINDS + 1
    assert lines(caplog)[-1].startswith(f"client a:1: more than {MAX_KINDS} kinds")
    assert refusals.log("b:0", "land", "unknown")
    for k in range(200):
        clock.now += PERIOD
        refusals.log("b:0", f"call{k % MAX_KINDS}", "unknown")  # one that stays is remembered
        refusals.log(f"c:{k}", "x" * 10**6, "y" * 10**6)
        assert not refusals.log("b:0", "land", "unknown")
        assert len(refusals._kinds) <= 64
    assert max(map(len, lines(caplog))) < 3 * MAX_TEXT


def test_connections_are_logged_once_for_each_event(refusals, caplog):
    for _ in range(2):
        refusals.log_connection("a:1", "refused: by vehicle 1")
        refusals.log_connection("a:1", "refused: by vehicle 2")
        refusals.log_connection("b:1", "dropped: silent\n")
    assert lines(caplog) == [
        "client a:1: connection refused: by vehicle 1",
        "client a:1: connection refused: by vehicle 2",
        "client b:1: connection dropped: silent\\n",
    ]


def test_a_flood_from_many_addresses_neither_fills_the_log_nor_hides_calls(refusals, clock, caplog):
    logged = [refusals.log_connection(f"a:{k}", "refused: full") for k in range(10 * MAX_LINES)]
    assert logged == [True] * MAX_LINES + [False] * 9 * MAX_LINES
    last = "; more refused connections are not logged for 60 s"
    assert [line.endswith(last) for line in lines(caplog)] == [False] * (MAX_LINES - 1) + [True]
    assert len(refusals._kinds) == MAX_LINES
    assert refusals.log("b:1", "takeoff", "it is not armed")
    assert not refusals.log("b:1", "takeoff", "it is not armed")
    # What was not logged is logged when it happens again
    clock.now = PERIOD + 1
    assert not refusals.log_connection("a:0", "refused: full")
    assert refusals.log_connection(f"a:{MAX_LINES}", "refused: full")


def test_a_flood_of_calls_does_not_fill_the_log(refusals, caplog):
    for client in range(10 * MAX_LINES):
        for name in ("takeoff", "land"):
            refusals.log(f"a:{client}", name, "it is not armed")
    assert len(caplog.records) == MAX_LINES
    assert refusals.log_connection("a:1", "dropped: silent")


@pytest.mark.parametrize(
    "hostile", ["a\nb", "a\r\x1b[2Jb", "a\u2028b", "\u202eab", "a\x00", "\ud800"]
)
def test_a_text_cannot_make_lines_of_its_own(refusals, caplog, hostile):
    refusals.log("a:1", hostile, hostile)
    (line,) = lines(caplog)
    assert line.isprintable()
    assert escape_line("plain: ü, 中") == "plain: ü, 中"
    assert escape_line(hostile).encode("ascii").decode("unicode_escape") == hostile


def test_lines_of_libraries_are_limited_and_escaped_too(clock, caplog):
    logger = logging.getLogger("bulletuav.test.library")
    limit = LineLimit(clock)
    logger.addFilter(limit)
    try:
        for k in range(3 * MAX_LINES):
            logger.error("odd message %s of %d", "\x1b[31m", k)
        assert lines(caplog)[0] == "odd message \\x1b[31m of 0"
        assert len(lines(caplog)) == MAX_LINES
        assert lines(caplog)[-1].endswith("; more lines are not logged for 60 s")
        clock.now += PERIOD + 1
        logger.error("later")
        assert lines(caplog)[-1] == "later"
    finally:
        logger.removeFilter(limit)


def test_what_keeps_servers_from_accepting_is_logged_once_in_a_period(refusals, clock, caplog):
    for _ in range(5):
        refusals.log_server("no connection can be accepted")
    assert lines(caplog) == ["server: no connection can be accepted"]
    clock.now += PERIOD + 1
    refusals.log_server("no connection can be accepted")
    assert len(lines(caplog)) == 2
