"""Radio addresses of virtual Crazyflies, with a stand-in for cflib's drivers."""

import sys
import types

import pytest

from bulletuav.bridges import cflib_radio
from bulletuav.bridges.cflib_radio import FIRST_PORT, find_uri, list_ports


class WrongUriType(Exception):  # noqa: N818  # cflib names it so
    pass


class UdpDriver:
    def connect(self, uri, *callbacks):
        self.opened, self.needs_resending = uri, False

    def scan_interface(self, address=None):
        return [["udp://127.0.0.1:19850", ""], ["udp://127.0.0.1:19851", ""]]


@pytest.fixture
def crtp(monkeypatch):
    made = {name: types.ModuleType(name) for name in
            ("cflib", "cflib.crtp", "cflib.crtp.exceptions", "cflib.crtp.udpdriver")}  # fmt: skip
    made["cflib"].crtp = made["cflib.crtp"]
    made["cflib.crtp.exceptions"].WrongUriType = WrongUriType
    made["cflib.crtp.udpdriver"].UdpDriver = UdpDriver
    for name, module in made.items():
        monkeypatch.setitem(sys.modules, name, module)
    return made["cflib.crtp"]


@pytest.mark.parametrize(
    ("uri", "port"),
    [
        ("radio://0/20/2M/E7E7E7E701", 19850),
        ("radio://0/20/2M/E7E7E7E704", 19853),
        ("radio://0/80/2M/E7E7E7E7E7?rate_limit=100", 19850),
        ("radio://0/80/2M", 19850),
    ],
)
def test_addresses_have_ports(uri, port, crtp):
    cflib_radio.replace_radio(list_ports(None, FIRST_PORT))
    driver = crtp.RadioDriver()
    driver.connect(uri, None, None)
    assert (driver.opened, driver.uri) == (f"udp://127.0.0.1:{port}", uri)
    assert driver.needs_resending  # as the radio does not repeat datagrams
    with pytest.raises(WrongUriType):
        driver.connect("udp://127.0.0.1:19850", None, None)


def test_addresses_are_chosen_and_scanned(crtp):
    ports = list_ports("AAAAAAAAAA,E7E7E7E7BB", 19851)
    assert find_uri("radio://0/80/2M/E7E7E7E7BB", ports, "host") == "udp://host:19852"
    with pytest.raises(ValueError, match="no drone has the address E7E7E7E701"):
        find_uri("radio://0/80/2M/E7E7E7E701", ports, "host")
    cflib_radio.replace_radio(ports)
    assert crtp.RadioDriver().scan_interface(0xAAAAAAAAAA) == [["radio://0/80/2M/AAAAAAAAAA", ""]]
    assert crtp.RadioDriver().scan_interface(0xE7E7E7E7BB) == []


def test_a_program_runs_with_its_arguments(crtp, tmp_path, monkeypatch, capsys):
    program = tmp_path / "fly.py"
    program.write_text("import sys, beside, cflib.crtp\nprint(beside.NAME, sys.argv[1:])\n")
    (tmp_path / "beside.py").write_text("NAME = 'beside'\n")
    monkeypatch.setattr(sys, "argv", ["cflib_radio", "--port", "20000", str(program), "--fast"])
    monkeypatch.setattr(sys, "path", ["", *sys.path])
    cflib_radio.main()
    assert capsys.readouterr().out == "beside ['--fast']\n"
    driver = crtp.RadioDriver()
    driver.connect("radio://0/20/2M/E7E7E7E702")
    assert driver.opened == "udp://127.0.0.1:20001"


def test_without_cflib_it_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "cflib", None)
    with pytest.raises(ImportError, match="pip install cflib"):
        cflib_radio.replace_radio({})
