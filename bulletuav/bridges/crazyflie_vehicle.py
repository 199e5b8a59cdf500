"""One virtual Crazyflie: its supervisor, its services, and who decides what it does."""

from collections.abc import Callable
from enum import IntFlag

from bulletuav.bridges.crazyflie_high_level import HighLevelCommander
from bulletuav.bridges.crazyflie_services import CrtpParameterService, LogService, MemoryService
from bulletuav.bridges.crazyflie_setpoints import Commander, ThrustMap
from bulletuav.bridges.crazyflie_toc import Telemetry
from bulletuav.bridges.crtp import (
    MAX_DATA_SIZE,
    PROTOCOL_VERSION,
    CrtpPort,
    Errno,
    MalformedError,
    Packet,
    pack_data,
    unpack_data,
)
from bulletuav.bridges.setpoints import Guide, Order, State
from bulletuav.vehicle.airframe import Airframe

LINK_NAME = b"Bitcraze Crazyflie"
"""What the link's source tells; clients go on only if it is this"""
TUMBLE_TIMEOUT = 1.0
"""How long a drone is upside down until its motors stop, s"""
WATCHDOG_TIMEOUT = 1.0
"""Longest time between packets of the emergency watchdog, once there was one, s"""
MOTION_COMMANDS = (7, 8, 11, 12, 13)
"""Commands of the planner that move the drone"""
MIN_FLYING_SPEED_FRACTION = 0.1
"""Share of the greatest rotor speed from which on a drone is said to fly"""


class SupervisorBits(IntFlag):
    """What the supervisor tells."""

    CAN_BE_ARMED = 1
    ARMED = 2
    AUTO_ARMED = 4
    CAN_FLY = 8
    FLYING = 16
    TUMBLED = 32
    LOCKED = 64
    CRASHED = 128
    HL_CONTROL_ACTIVE = 256
    HL_TRAJECTORY_FINISHED = 512
    HL_CONTROL_DISABLED = 1024


class CrazyflieVehicle:
    """One virtual Crazyflie, without its body: packets in, commands and packets out.

    Attributes:
        parameters: Its parameters.
        logs: Its log blocks.
        malformed: How many packets could not be read.
        refusal: Why the last packet's command was refused, with the remedy; empty if it was not.
    """

    def __init__(self, airframe: Airframe, set_upright: Callable[[], bool]) -> None:
        """Switch it on, armed, as those without a need for arming are.

        Args:
            airframe: Of its body.
            recover: Function that puts the body on its feet, and tells whether it could.
        """
        self._airframe, self._set_upright = airframe, set_upright
        self.parameters, self.logs, self._memory = (
            CrtpParameterService(),
            LogService(),
            MemoryService(),
        )
        self._thrust_map, self._guide = ThrustMap(airframe), Guide(airframe)
        self._commander = Commander(self._thrust_map)
        self._high_level = HighLevelCommander(airframe, self._memory.content)
        self._is_armed, self._is_locked, self._is_crashed = True, False, False
        self._last_upright_time, self._now = 0.0, 0.0
        self._watchdog_time: float | None = None
        self._state: State = ([0.0] * 3, [0.0, 0.0, 0.0, 1.0], [0.0] * 3, [0.0] * 3)
        self._rotor_speed = [0.0] * len(airframe.rotors)
        self._acceleration = [0.0] * 3
        self.malformed, self.refusal = 0, ""

    def reset_client(self) -> None:
        """Forget what belongs to a client that has gone."""
        self.logs.clear()

    def update_state(
        self, state: State, acceleration: list[float], rotor_speed: list[float], now: float
    ) -> None:
        """Take the body's state over, and look whether it lies upside down.

        Args:
            state: State of the body.
            acceleration: (3,) of the last step, m/s^2.
            rotor_speed: (R,) rad/s.
            now: Time, s.
        """
        self._state, self._acceleration, self._now = state, acceleration, now
        self._rotor_speed = rotor_speed[: len(self._airframe.rotors)]
        x, y, _, _ = state[1]
        if 1 - 2 * (x * x + y * y) > 0:
            self._last_upright_time = now
        if self._is_tumbled and self._is_flying:
            self._is_crashed = True
        if self._watchdog_time is not None and now - self._watchdog_time > WATCHDOG_TIMEOUT:
            self._is_locked = True

    @property
    def _is_tumbled(self) -> bool:
        """Whether it has been upside down for a while."""
        return self._now - self._last_upright_time > TUMBLE_TIMEOUT

    @property
    def _is_flying(self) -> bool:
        """Whether its rotors turn."""
        return max(self._rotor_speed) > MIN_FLYING_SPEED_FRACTION * self._airframe.max_rotor_speed

    @property
    def _can_fly(self) -> bool:
        """Whether its motors may turn."""
        return self._is_armed and not (self._is_locked or self._is_crashed or self._is_tumbled)

    @property
    def supervisor_bits(self) -> SupervisorBits:
        """What the supervisor tells."""
        ready = not (self._is_locked or self._is_crashed or self._is_tumbled)
        flags = {
            SupervisorBits.CAN_BE_ARMED: ready,
            SupervisorBits.ARMED: self._is_armed,
            SupervisorBits.AUTO_ARMED: True,
            SupervisorBits.CAN_FLY: self._can_fly,
            SupervisorBits.FLYING: self._is_flying,
            SupervisorBits.TUMBLED: self._is_tumbled,
            SupervisorBits.LOCKED: self._is_locked,
            SupervisorBits.CRASHED: self._is_crashed,
            SupervisorBits.HL_CONTROL_ACTIVE: self._high_level.has_plan
            and self._commander.is_released,
            SupervisorBits.HL_TRAJECTORY_FINISHED: self._high_level.is_finished(self._now),
            SupervisorBits.HL_CONTROL_DISABLED: not self._high_level.has_plan,
        }
        return SupervisorBits(sum(bit for bit, is_set in flags.items() if is_set))

    def order(self, period: float) -> Order | None:
        """Tell the command of the next step, or None for motors off."""
        setpoint = self._commander.current(self._now)
        if not self._can_fly:
            self._commander.clear()
            self._high_level.stop()
            return None
        if self._high_level.has_plan and (setpoint is None or self._commander.is_released):
            self._commander.clear()
            self._guide.rest()
            return self._high_level.order(self._state, self._now)
        if setpoint is None or (setpoint.upward == "thrust" and setpoint.z == 0):
            self._guide.rest()
            return None
        return self._guide.order(setpoint, self._state, period)

    def telemetry(self, pressure: Callable[[float], float]) -> Telemetry:
        """Tell what can be logged now."""
        max_speed = self._airframe.max_rotor_speed
        target = self._high_level.target(self._now) or self._state[0]
        return Telemetry(
            self._state,
            self._acceleration,
            [speed / max_speed for speed in self._rotor_speed],
            (self._thrust_map.command(self._rotor_speed), target, int(self.supervisor_bits)),
            pressure,
        )

    def answer(self, packet: Packet, tick: int) -> list[Packet]:
        """Take a packet.

        Args:
            packet: From the client.
            tick: Present time in units of 10 ms.

        Returns:
            The answers; none to a packet that cannot be read, which is counted.
        """
        self.refusal = ""
        try:
            return self._answer(packet, tick)
        except MalformedError as error:
            self.malformed += 1
            self.refusal = str(error)
            return []

    def _answer(self, packet: Packet, tick: int) -> list[Packet]:
        """Pass a packet to the part that it is for."""
        if packet.port == CrtpPort.LOG:
            return self.logs.answer(packet, tick)
        if packet.port == CrtpPort.PARAM:
            return self.parameters.answer(packet)
        if packet.port == CrtpPort.MEM:
            return self._memory.answer(packet)
        if packet.port in (CrtpPort.SETPOINT, CrtpPort.SETPOINT_GENERIC):
            self._handle_setpoint(packet)
            return []
        if packet.port == CrtpPort.SETPOINT_HL:
            error = self._high_level.handle_command(packet.data, self._state, self._now)
            if packet.data[0] in MOTION_COMMANDS:
                self._record_unless_flyable()
            if error:
                self.refusal = f"command {packet.data[0]} is answered by {Errno(error).name}"
            return [packet._replace(data=packet.data[:3] + bytes([error]))]
        if packet.port == CrtpPort.SUPERVISOR:
            return self._handle_supervisor(packet)
        if packet.port == CrtpPort.PLATFORM:
            return self._handle_platform(packet)
        if packet.port == CrtpPort.LINK:
            return self._handle_link(packet)
        # Positions from outside are not needed: the drone knows its own.
        return []

    @property
    def _blocking_reason(self) -> str:
        """What keeps its motors from turning, with the remedy."""
        if self._is_locked:
            return "an emergency stop locked it; restart the server"
        if self._is_crashed or self._is_tumbled:
            return "it has crashed; send the supervisor's request to recover"
        return "it is not armed; arm it first"

    def _record_unless_flyable(self) -> None:
        """Note that a command will have no effect, as with the firmware, if motors may not turn."""
        if not self._can_fly:
            self.refusal = f"it cannot fly: {self._blocking_reason}"

    def _handle_setpoint(self, packet: Packet) -> None:
        """Take a low-level setpoint, which ends plans, or its end."""
        if packet.port == CrtpPort.SETPOINT_GENERIC and packet.channel == 1:
            (request,) = unpack_data("B", packet.data)
            if request:
                raise MalformedError(f"request {request} about setpoints: 0 is needed")
            self._commander.release()
            return
        # Zeros stop motors that stand still anyway
        if any(packet.data):
            self._record_unless_flyable()
        values = self.parameters.values
        is_rate = not values["flightmode.stabModeRoll"] and not values["flightmode.stabModePitch"]
        self._commander.set_setpoint(
            packet, self._now, (is_rate, not values["flightmode.stabModeYaw"])
        )
        self._high_level.stop()

    def _handle_supervisor(self, packet: Packet) -> list[Packet]:
        """Answer the supervisor's port."""
        (request,) = unpack_data("B", packet.data)
        # Channel 0 asks for the state, which is told as bits
        if packet.channel == 0:
            if request != 0x0C:
                raise MalformedError(f"request {request} to the supervisor: 12 is needed")
            return [
                packet._replace(data=pack_data("BH", request | 0x80, int(self.supervisor_bits)))
            ]
        # The other channel commands: arm, stand up, stop at once, feed the watchdog
        success = 1
        if request == 1:
            (_, arms) = unpack_data("BB", packet.data)
            success = not arms or SupervisorBits.CAN_BE_ARMED in self.supervisor_bits
            if success:
                self._is_armed = bool(arms)
            else:
                self.refusal = f"it cannot be armed: {self._blocking_reason}"
            outcome = self._is_armed
        elif request == 2:
            outcome = success = self._recover_from_crash()
            if not success:
                self.refusal = f"it cannot recover: {self._blocking_reason}, or there is no room to stand"
        elif request == 3:
            self._is_locked = outcome = True
        elif request == 4:
            self._watchdog_time, outcome = self._now, not self._is_locked
        else:
            raise MalformedError(f"command {request} to the supervisor: from 1 to 4 is needed")
        return [packet._replace(data=pack_data("BBB", request | 0x80, success, outcome))]

    def _recover_from_crash(self) -> bool:
        """Recover from a crash: the body is put on its feet, as somebody would."""
        if self._is_locked or (self._is_tumbled and not self._set_upright()):
            return False
        self._is_crashed, self._last_upright_time = False, self._now
        return True

    def _handle_platform(self, packet: Packet) -> list[Packet]:
        """Answer the platform's port: versions; and arming as older clients ask for it."""
        (request,) = unpack_data("B", packet.data)
        if packet.channel == 0:
            if request in (1, 2):
                self._handle_supervisor(Packet(CrtpPort.SUPERVISOR, 1, packet.data))
            return [packet]
        if packet.channel == 1 and request in (0, 1):
            reply = bytes([PROTOCOL_VERSION]) if request == 0 else b"bulletuav\0"
            return [packet._replace(data=bytes([request]) + reply)]
        raise MalformedError(f"request {request} on channel {packet.channel} of the platform")

    @staticmethod
    def _handle_link(packet: Packet) -> list[Packet]:
        """Answer the link: an echo, its source, or nothing for its sink."""
        if packet.channel == 1:
            return [packet._replace(data=LINK_NAME.ljust(MAX_DATA_SIZE, b"\0"))]
        return [packet] if packet.channel == 0 else []
