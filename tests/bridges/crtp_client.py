"""A client of virtual Crazyflies, of bytes alone: nothing of the server's code is used."""

import itertools
import math
import struct


class Drone:
    """Talks to one drone of a fleet, in one process with it."""

    def __init__(self, fleet, index=0):
        self.fleet, self.index = fleet, index

    def ask(self, port, channel, data=b""):
        """Send a packet; returns (port, channel, data) of each answer."""
        from bulletuav.bridges.crtp import Packet

        datagram = bytes([port << 4 | 0x0C | channel]) + data
        answers = self.fleet.take(self.index, Packet.parse(datagram))
        return [read(answer.frame()) for answer in answers]

    def data(self, port, channel, data=b""):
        """Send a packet that has one answer; returns its data."""
        ((told, from_channel, answer),) = self.ask(port, channel, data)
        assert (told, from_channel) == (port, channel)
        return answer

    def plan(self, layout, *numbers):
        """Send a command to the planner; returns the error that it tells."""
        sent = struct.pack("<" + layout, *numbers)
        answer = self.data(8, 0, sent)
        assert answer[:3] == sent[:3]
        return answer[3]

    def take_off(self, height, seconds):
        return self.plan("BBff?f", 7, 0, height, 0.0, True, seconds)

    def land(self, seconds):
        return self.plan("BBff?f", 8, 0, 0.0, 0.0, True, seconds)

    def go_to(self, x, y, z, yaw, seconds, relative=False, linear=False):
        return self.plan("BBBBfffff", 12, 0, relative, linear, x, y, z, yaw, seconds)

    def setpoint(self, kind, layout="", *numbers):
        assert self.ask(7, 0, struct.pack("<B" + layout, kind, *numbers)) == []

    def attitude(self, roll, pitch, yaw_rate, thrust):
        """As cflib sends it, which turns the pitch around."""
        assert self.ask(3, 0, struct.pack("<fffH", roll, -pitch, yaw_rate, thrust)) == []

    def swing(self):
        """Returns a function that sends full states of a swing of 1 m along x, 10 ms apart."""
        clock = itertools.count()

        def send():
            t = next(clock) / 100
            x, v, a = 0.5 * (1 - math.cos(t)), 0.5 * math.sin(t), 0.5 * math.cos(t)
            mm = [int(1000 * one) for one in (x, 0, 1, v, 0, 0, a, 0, 0)]
            self.setpoint(6, "9hI3h", *mm, 3 << 30, 0, 0, 0)

        return send

    def bits(self):
        return struct.unpack("<BH", self.data(9, 0, b"\x0c"))[1]

    def parameter(self, name, value):
        """Set a parameter by its name, as one byte."""
        answer = self.data(
            2, 3, b"\0" + name.replace(".", "\0").encode() + b"\0\x08" + bytes([value])
        )
        return answer[-1]

    @property
    def place(self):
        return self.fleet.airspace.swarm.position[self.index]

    @property
    def velocity(self):
        return self.fleet.airspace.swarm.velocity[self.index]


def read(datagram):
    """Split a datagram as cflib does."""
    assert 1 <= len(datagram) <= 31
    return datagram[0] >> 4, datagram[0] & 3, datagram[1:]


def entries(ask, port, layout):
    """Download a table of contents: {name: (number, type)}.

    Args:
        ask: Function of port, channel and data that returns the data of the answer.
        port: 5 for logs, 2 for parameters.
        layout: What follows the checksum in the table's description.
    """
    about = ask(port, 0, b"\x03")
    request, count, crc, *_ = struct.unpack("<BHI" + layout, about)
    assert request == 3
    assert crc
    names = {}
    for number in range(count):
        entry = ask(port, 0, struct.pack("<BH", 2, number))
        assert entry[:3] == struct.pack("<BH", 2, number)
        group, name, rest = entry[4:].split(b"\0")
        assert rest == b""
        names[f"{group.decode()}.{name.decode()}"] = (number, entry[3])
    return names
