"""The log of refusals: once for each client and kind, of any text, in bounded memory."""

import pytest

from bulletuav.bridges.refusals import (
    MAX_CLIENTS,
    MAX_KINDS,
    MAX_TEXT,
    Refusals,
    address_text,
    printable,
)


@pytest.fixture
def refusals():
    return Refusals()


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


def test_kinds_and_clients_are_bounded(refusals, caplog):
    for k in range(3 * MAX_KINDS):
        refusals.log("a:1", f"call{k}", "unknown")
    assert len(caplog.records) == MAX_KINDS + 1
    assert lines(caplog)[-1].startswith(f"client a:1: more than {MAX_KINDS} kinds")
    for k in range(3 * MAX_CLIENTS):
        refusals.log(f"b:{k}", "x" * 10**6, "y" * 10**6)
    kept = refusals._kinds
    assert len(kept) == MAX_CLIENTS
    assert f"b:{3 * MAX_CLIENTS - 1}" in kept
    assert max(len(kind) for kinds in kept.values() for kind in kinds) < 3 * MAX_TEXT


@pytest.mark.parametrize(
    "hostile", ["a\nb", "a\r\x1b[2Jb", "a\u2028b", "\u202eab", "a\x00", "\ud800"]
)
def test_a_text_cannot_make_lines_of_its_own(refusals, caplog, hostile):
    refusals.log("a:1", hostile, hostile)
    (line,) = lines(caplog)
    assert line.isprintable()
    assert printable("plain: ü, 中") == "plain: ü, 中"
    assert printable(hostile).encode("ascii").decode("unicode_escape") == hostile


def test_addresses():
    assert address_text("127.0.0.1", 5) == "127.0.0.1:5"
    assert address_text("::1", 5) == "[::1]:5"
