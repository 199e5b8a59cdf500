"""Writers of flight logs of other programs, for tests: minimal, from the documented formats."""

import struct
import zlib

import numpy as np

SWAP = np.sqrt(0.5)


def to_ned(rows):
    """Columns t, x, y, z, qx, qy, qz, qw, p, q, r by name, in NED and FRD (w, x, y, z).

    The product of quaternions (1, 1, 0, 0) / sqrt(2), q and (1, 0, 0, 0) by hand.
    """
    _, x, y, z, qx, qy, qz, qw, p, q, r = rows[:, :11].T
    turn = [SWAP * (qw + qz), SWAP * (qx + qy), SWAP * (qx - qy), SWAP * (qw - qz)]
    return {"position": [y, x, -z], "attitude": turn, "rates": [p, -q, -r]}


class Ulog:
    """A ULog file: formats come before all messages."""

    def __init__(self, flags=bytes(8), offsets=(0, 0, 0)):
        self.definitions = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
        self.messages = b""
        self.add("B", bytes(8) + flags + struct.pack("<3Q", *offsets))

    def add(self, kind, content):
        message = struct.pack("<HB", len(content), ord(kind)) + content
        if kind in "BF":
            self.definitions += message
        else:
            self.messages += message

    @property
    def data(self):
        return self.definitions + self.messages

    def topic(self, number, name, fields, instance=0):
        text = f"{name}:" + "".join(f"{kind} {field};" for kind, field in fields)
        self.add("F", text.encode())
        self.subscribe(number, name, instance)

    def subscribe(self, number, name, instance=0):
        self.add("A", struct.pack("<BH", instance, number) + name.encode())

    def write(self, number, form, *values):
        self.add("D", struct.pack(f"<H{form}", number, *values))


CLOCK = ("uint64_t", "timestamp")


def ulog_of(rows, pwm, order):
    """A log of PX4; pwm (n, 4) in the order of the airframe, order: motor of PX4 by rotor."""
    log, ned = Ulog(), to_ned(rows)
    place = [("float", name) for name in ("x", "y", "z")]
    log.topic(3, "vehicle_local_position", [CLOCK, *place, ("bool", "xy_valid")])
    log.topic(0, "vehicle_attitude", [CLOCK, ("float[4]", "q"), ("uint8_t[4]", "_padding0")])
    log.topic(1, "vehicle_angular_velocity", [CLOCK, ("float[3]", "xyz")])
    log.topic(2, "actuator_outputs", [CLOCK, ("uint32_t", "noutputs"), ("float[16]", "output")])
    log.topic(4, "cpuload", [CLOCK, ("float", "load")])
    log.add("I", b"\x0bchar[3] sysPX4")
    for k, row in enumerate(rows):
        time = 5_000_000 + round(1e6 * row[0])
        output = np.zeros(16)
        output[order] = pwm[k]
        log.write(2, "QI16f", time, 4, *output)
        log.write(3, "Q3f?", time, *(column[k] for column in ned["position"]), True)
        log.write(0, "Q4f", time, *(column[k] for column in ned["attitude"]))
        log.write(1, "Q3f", time, *(column[k] for column in ned["rates"]))
        if k % 50 == 0:
            log.write(4, "Qf", time, 0.5)
    return log.data


VARIABLES = [
    *(f"stateEstimate.{name}" for name in ("x", "y", "z", "qx", "qy", "qz", "qw")),
    *(f"gyro.{axis}" for axis in "xyz"),
]


def usd_bytes(version, events, content):
    """A log of the micro-SD deck: events (number, name, variables), and what follows."""
    data = b"\xbc" + struct.pack("<HH", version, len(events))
    for number, name, variables in events:
        data += struct.pack("<H", number) + name.encode() + b"\0"
        data += struct.pack("<H", len(variables))
        data += b"".join(variable.encode() + b"\0" for variable in variables)
    data += content
    return data + struct.pack("<I", zlib.crc32(data))


def usd_of(rows, pwm, version=2):
    """A log of a Crazyflie, with motors M1 to M4 in the order of cf2x."""
    variables = [f"{name}(f)" for name in VARIABLES]
    variables += [f"motor.m{k}(H)" for k in range(1, 5)]
    events = [(7, "fixedFrequency", variables), (9, "estPosition", ["source(B)", "x(f)"])]
    content = b""
    for k, row in enumerate(rows):
        stamp = struct.pack("<HI", 7, round(1e3 * row[0]) + 100)
        if version == 2:
            stamp = struct.pack("<HQ", 7, round(1e6 * row[0]) + 100_000)
        motors = [round(one) for one in pwm[k]]
        content += stamp + struct.pack("<10f4H", *row[1:8], *np.rad2deg(row[8:11]), *motors)
    other = struct.pack("<HQ" if version == 2 else "<HI", 9, 100_000) + struct.pack("<Bf", 1, 2)
    return usd_bytes(version, events, content + other)


def airsim_of(rows, vehicles=("Drone1",)):
    """A recording of AirSim with four columns of rotor speeds, which users add."""
    ned, lines = to_ned(rows), []
    names = "VehicleName TimeStamp POS_X POS_Y POS_Z Q_W Q_X Q_Y Q_Z M1 M2 M3 M4 ImageFile"
    for k, row in enumerate(rows):
        numbers = [column[k] for column in (*ned["position"], *ned["attitude"])]
        cells = [vehicles[k % len(vehicles)], 1_700_000_000_000 + round(1e3 * row[0])]
        lines.append([*cells, *(f"{one:.9g}" for one in (*numbers, *row[11:15])), "img.png"])
    return "\n".join("\t".join(map(str, line)) for line in [names.split(), *lines]) + "\n"
