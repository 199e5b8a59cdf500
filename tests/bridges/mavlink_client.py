"""A ground station, by pymavlink: what it says goes through bytes, as on the wire."""

import math

import numpy as np
from pymavlink.dialects.v20 import common

from bulletuav.bridges.mavlink_items import SUPPORTED_COMMANDS
from bulletuav.bridges.mavlink_protocol import Command, MavlinkCodec, Mode, Sender

NAN = math.nan
ACCEPTED, REJECTED, DENIED, UNSUPPORTED = range(4)
HOLD, MISSION, RETURN, LAND = (4, 3), (4, 4), (4, 5), (4, 6)
OFFBOARD = (6, 0)
WELL_KNOWN = 20 * (
    11,
    20,
    21,
    23,
    39,
    40,
    41,
    43,
    44,
    45,
    47,
    51,
    69,
    73,
    75,
    76,
    82,
    84,
    86,
    111,
    126,
    144,
)
"""Messages that vehicles answer; they come more often than others in `random_frame`"""
VELOCITY_ONLY, PLACE_ONLY = 0xDC7, 0xDF8


class Station:
    """Talks to one vehicle of a fleet, in one process with it."""

    def __init__(self, fleet, index=0, system=255, link="here"):
        self.fleet, self.index = fleet, index
        self.packer = common.MAVLink(None, system, 190)
        self.sender = Sender(system, 190, link)
        self.reader, self.listener = MavlinkCodec(index + 1), common.MAVLink(None)
        self.heard = []

    @property
    def target(self):
        return self.index + 1, 1

    @property
    def vehicle(self):
        return self.fleet.services[self.index].vehicle

    @property
    def pilot(self):
        return self.vehicle.pilot

    @property
    def place(self):
        """North, east, down of its start."""
        x, y, z = self.pilot.state[0]
        sx, sy, sz = self.vehicle.site.start
        return np.array((y - sy, x - sx, sz - z))

    def hear(self, told):
        """Read what a vehicle tells, through bytes."""
        found = [self.listener.decode(bytearray(self.reader.pack(one))) for one in told]
        self.heard += found
        return found

    def send(self, name, *fields):
        """Send a message; return the answers."""
        message = getattr(common, f"MAVLink_{name}_message")(*fields)
        (received,) = self.reader.read(bytes(message.pack(self.packer)))
        return self.hear(self.fleet.take(self.index, received, self.sender))

    def command(self, number, *numbers):
        """Send a command; return how it was answered, and what was said besides."""
        numbers = (*numbers, *[0.0] * (7 - len(numbers)))
        ack, *more = self.send("command_long", *self.target, number, 0, *numbers)
        assert ack.get_type() == "COMMAND_ACK"
        assert (ack.command, ack.target_system) == (number, self.packer.srcSystem)
        return ack.result, more

    def mode(self, mode):
        return self.command(176, 1, *mode)[0]

    def fly(self, seconds, each=lambda: None):
        """Fly; `each` is called at 20 Hz. Return what was heard by the way."""
        begin = len(self.heard)
        for k in range(round(seconds * 100)):
            if k % 5 == 0:
                each()
            self.hear(self.fleet.step()[self.index])
        return self.heard[begin:]

    def velocity(self, vx, vy, vz, frame=1, yaw=None, yaw_rate=None):
        mask = VELOCITY_ONLY
        mask &= ~0x400 if yaw is not None else ~0
        mask &= ~0x800 if yaw_rate is not None else ~0
        rest = (0, 0, 0, vx, vy, vz, 0, 0, 0, yaw or 0.0, yaw_rate or 0.0)
        return self.send("set_position_target_local_ned", 0, *self.target, frame, mask, *rest)

    def position(self, x, y, z, yaw=None):
        mask = PLACE_ONLY & ~0x400 if yaw is not None else PLACE_ONLY
        rest = (x, y, z, *[0.0] * 6, yaw or 0.0, 0.0)
        return self.send("set_position_target_local_ned", 0, *self.target, 1, mask, *rest)

    def take_off(self, height=None):
        """Arm, take off, and wait until it holds."""
        assert self.command(400, 1)[0] == ACCEPTED
        if height is not None:
            height += self.vehicle.site.altitude
        assert self.command(22, 0, 0, 0, NAN, NAN, NAN, height or NAN)[0] == ACCEPTED
        self.fly(5.0)

    def spot(self, north, east):
        """Tell latitude and longitude, 1e-7 deg, of a place north and east of the start."""
        site = self.vehicle.site
        sx, sy, sz = site.start
        latitude, longitude, _ = site.origin.to_geodetic((sx + east, sy + north, sz))
        return round(latitude * 1e7), round(longitude * 1e7)

    def degrees(self, north, east):
        """Return latitude and longitude, deg, of a place north and east of the start."""
        return [value * 1e-7 for value in self.spot(north, east)]

    def set_parameter(self, name, value):
        is_int = isinstance(value, int)
        packed = np.array(value, np.int32).view(np.float32).item() if is_int else value
        fields = (name.encode(), packed, 6 if is_int else 9)
        (reply,) = self.send("param_set", *self.target, *fields)
        assert reply.param_value == packed

    def sticks(self, pitch=0, roll=0, throttle=500, yaw=0):
        return self.send("manual_control", 1, pitch, roll, throttle, yaw, 0)

    def upload(self, items, kind=0):
        """Upload items (frame, command, 4 parameters, x, y, z); return the code of the answer."""
        answers = self.send("mission_count", *self.target, len(items), kind)
        while answers[-1].get_type() == "MISSION_REQUEST_INT":
            number = answers[-1].seq
            frame, command, *rest = items[number]
            fields = (number, frame, command, 0, 1, *rest, kind)
            answers = self.send("mission_item_int", *self.target, *fields)
        assert answers[-1].get_type() == "MISSION_ACK"
        assert answers[-1].mission_type == kind
        return answers[-1].type

    def waypoint(self, north, east, height, hold=0.0, yaw=NAN, command=16):
        return (6, command, hold, 0, 0, yaw, *self.spot(north, east), height)


def messages(heard, kind):
    return [one for one in heard if one.get_type() == kind]


def texts(heard):
    return [one.text for one in messages(heard, "STATUSTEXT")]


def random_frame(rng, packer, more=()):
    """Make a frame of a message that is known, for vehicle 1 mostly, with random content.

    Messages of the numbers in `more` are as likely as those that vehicles know.
    """
    numbers = [*WELL_KNOWN, *20 * more, *common.mavlink_map]
    kind = common.mavlink_map[numbers[rng.integers(len(numbers))]]
    payload = np.frombuffer(rng.bytes(kind.unpacker.size), np.uint8)
    # Small numbers go further into the code than those of random bits.
    payload = payload * (rng.random(payload.shape) < rng.random())
    message = common.MAVLink_message(kind.id, kind.msgname)
    frame = message._pack(packer, kind.crc_extra, payload.astype(np.uint8).tobytes())
    message = packer.decode(bytearray(frame))
    if rng.random() < 0.8:
        for name in ("target_system", "target_component"):
            if name in kind.fieldnames:
                setattr(message, name, 1)
    likely = {
        "seq": range(3),
        "count": range(4),
        "mission_type": range(2),
        "frame": (0, 3, 5, 6),
        "coordinate_frame": (1, 5, 8),
        "command": [int(one) for one in Command]
        if "COMMAND" in kind.msgname
        else SUPPORTED_COMMANDS,
        "custom_mode": [int(one) for one in Mode],
        **{f"param{k}": (0, 1, 1, 3, 4, 5, 6, NAN, 1e9, -1) for k in range(1, 5)},
    }
    known = sorted(set(likely).intersection(kind.fieldnames)) if kind.id in WELL_KNOWN else ()
    for name in known:
        if rng.random() < 0.8:
            choices = list(likely[name])
            setattr(message, name, choices[rng.integers(len(choices))])
    return bytes(message.pack(packer))
