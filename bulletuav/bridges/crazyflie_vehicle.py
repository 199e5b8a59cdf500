"""One virtual Crazyflie: its supervisor, its services, and who decides what it does."""

from collections.abc import Callable
from enum import IntFlag

from bulletuav.bridges.crazyflie_planner import Planner
from bulletuav.bridges.crazyflie_services import LogService, MemoryService, ParameterService
from bulletuav.bridges.crazyflie_setpoints import Commander, Motors
from bulletuav.bridges.crazyflie_tables import Telemetry
from bulletuav.bridges.crtp import (
    MOST_DATA,
    PROTOCOL_VERSION,
    Errno,
    MalformedError,
    Packet,
    Port,
    pack,
    unpack,
)
from bulletuav.bridges.setpoints import AirspaceCommand, SetpointController, State
from bulletuav.vehicle.airframe import Airframe

LINK_NAME = b"Bitcraze Crazyflie"
"""What the link's source tells; clients go on only if it is this"""
TUMBLED_AFTER = 1.0
"""How long a drone is upside down until its motors stop, s"""
WATCHDOG = 1.0
"""Longest time between packets of the emergency watchdog, once there was one, s"""
MOTIONS = (7, 8, 11, 12, 13)
"""Commands of the planner that move the drone"""
TURNING = 0.1
"""Share of the greatest rotor speed from which on a drone is said to fly"""


class Bits(IntFlag):
    """What the supervisor tells."""

    CAN_BE_ARMED = 1
    ARMED = 2
    AUTO_ARMED = 4
    CAN_FLY = 8
    FLYING = 16
    TUMBLED = 32
    LOCKED = 64
    CRASHED = 128
    PLANNER_ACTIVE = 256
    PLANNER_FINISHED = 512
    PLANNER_DISABLED = 1024


class Vehicle:
    """One virtual Crazyflie, without its body: packets in, commands and packets out.

    Attributes:
        parameters: Its parameters.
        logs: Its log blocks.
        malformed: How many packets could not be read.
        refusal: Why the last packet's command was refused, with the remedy; empty if it was not.
    """

    def __init__(self, airframe: Airframe, recover: Callable[[], bool]) -> None:
        """Switch it on, armed, as those without a need for arming are.

        Args:
            airframe: Of its body.
            recover: Function that puts the body on its feet, and tells whether it could.
        """
        self._airframe, self._recover = airframe, recover
        self.parameters, self.logs, self._memory = ParameterService(), LogService(), MemoryService()
        self._motors, self._guide = Motors(airframe), SetpointController(airframe)
        self._commander = Commander(self._motors)
        self._planner = Planner(airframe, self._memory.content)
        self._armed, self._locked, self._crashed = True, False, False
        self._upright_at, self._now = 0.0, 0.0
        self._watchdog: float | None = None
        self._state: State = ([0.0] * 3, [0.0, 0.0, 0.0, 1.0], [0.0] * 3, [0.0] * 3)
        self._rotor_speed = [0.0] * len(airframe.rotors)
        self._acceleration = [0.0] * 3
        self.malformed, self.refusal = 0, ""

    def leave(self) -> None:
        """Forget what belongs to a client that has gone."""
        self.logs.clear()

    def sense(
        self,
        state: State,
        acceleration: list[float],
        rotor_speed: list[float],
        now: float,
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
            self._upright_at = now
        if self._tumbled and self._flies:
            self._crashed = True
        if self._watchdog is not None and now - self._watchdog > WATCHDOG:
            self._locked = True

    @property
    def _tumbled(self) -> bool:
        """Whether it has been upside down for a while."""
        return self._now - self._upright_at > TUMBLED_AFTER

    @property
    def _flies(self) -> bool:
        """Whether its rotors turn."""
        return max(self._rotor_speed) > TURNING * self._airframe.max_rotor_speed

    @property
    def _can_fly(self) -> bool:
        """Whether its motors may turn."""
        return self._armed and not (self._locked or self._crashed or self._tumbled)

    @property
    def bits(self) -> Bits:
        """What the supervisor tells."""
        ready = not (self._locked or self._crashed or self._tumbled)
        told = {
            Bits.CAN_BE_ARMED: ready,
            Bits.ARMED: self._armed,
            Bits.AUTO_ARMED: True,
            Bits.CAN_FLY: self._can_fly,
            Bits.FLYING: self._flies,
            Bits.TUMBLED: self._tumbled,
            Bits.LOCKED: self._locked,
            Bits.CRASHED: self._crashed,
            Bits.PLANNER_ACTIVE: self._planner.flies and self._commander.released,
            Bits.PLANNER_FINISHED: self._planner.finished(self._now),
            Bits.PLANNER_DISABLED: not self._planner.flies,
        }
        return Bits(sum(bit for bit, is_set in told.items() if is_set))

    def order(self, period: float) -> AirspaceCommand | None:
        """Tell the command of the next step, or None for motors off."""
        setpoint = self._commander.current(self._now)
        if not self._can_fly:
            self._commander.drop()
            self._planner.stop()
            return None
        if self._planner.flies and (setpoint is None or self._commander.released):
            self._commander.drop()
            self._guide.reset()
            return self._planner.order(self._state, self._now)
        if setpoint is None or (setpoint.z_mode == "thrust" and setpoint.z == 0):
            self._guide.reset()
            return None
        return self._guide.compute_command(setpoint, self._state, period)

    def telemetry(self, pressure: Callable[[float], float]) -> Telemetry:
        """Tell what can be logged now."""
        most = self._airframe.max_rotor_speed
        target = self._planner.target(self._now) or self._state[0]
        return Telemetry(
            self._state,
            self._acceleration,
            [one / most for one in self._rotor_speed],
            (self._motors.command(self._rotor_speed), target, int(self.bits)),
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
        if packet.port == Port.LOG:
            return self.logs.answer(packet, tick)
        if packet.port == Port.PARAMETERS:
            return self.parameters.answer(packet)
        if packet.port == Port.MEMORY:
            return self._memory.answer(packet)
        if packet.port in (Port.ATTITUDE_SETPOINT, Port.SETPOINT):
            self._take_setpoint(packet)
            return []
        if packet.port == Port.PLANNER:
            error = self._planner.take(packet.data, self._state, self._now)
            if packet.data[0] in MOTIONS:
                self._require_flight()
            if error:
                self.refusal = f"command {packet.data[0]} is answered by {Errno(error).name}"
            return [packet._replace(data=packet.data[:3] + bytes([error]))]
        if packet.port == Port.SUPERVISOR:
            return self._supervise(packet)
        if packet.port == Port.PLATFORM:
            return self._about(packet)
        if packet.port == Port.LINK:
            return self._link(packet)
        # Positions from outside are not needed: the drone knows its own.
        return []

    @property
    def _obstacle(self) -> str:
        """What keeps its motors from turning, with the remedy."""
        if self._locked:
            return "an emergency stop locked it; restart the server"
        if self._crashed or self._tumbled:
            return "it has crashed; send the supervisor's request to recover"
        return "it is not armed; arm it first"

    def _require_flight(self) -> None:
        """Note that a command will have no effect, as with the firmware, if motors may not turn."""
        if not self._can_fly:
            self.refusal = f"it cannot fly: {self._obstacle}"

    def _take_setpoint(self, packet: Packet) -> None:
        """Take a low-level setpoint, which ends plans, or its end."""
        if packet.port == Port.SETPOINT and packet.channel == 1:
            (request,) = unpack("B", packet.data)
            if request:
                raise MalformedError(f"request {request} about setpoints: 0 is needed")
            self._commander.release()
            return
        # Zeros stop motors that stand still anyway
        if any(packet.data):
            self._require_flight()
        values = self.parameters.values
        is_rate = not values["flightmode.stabModeRoll"] and not values["flightmode.stabModePitch"]
        self._commander.take(packet, self._now, (is_rate, not values["flightmode.stabModeYaw"]))
        self._planner.stop()

    def _supervise(self, packet: Packet) -> list[Packet]:
        """Answer the supervisor's port."""
        (request,) = unpack("B", packet.data)
        # Channel 0 asks for the state, which is told as bits
        if packet.channel == 0:
            if request != 0x0C:
                raise MalformedError(f"request {request} to the supervisor: 12 is needed")
            return [packet._replace(data=pack("BH", request | 0x80, int(self.bits)))]
        # The other channel commands: arm, stand up, stop at once, feed the watchdog
        success = 1
        if request == 1:
            (_, arms) = unpack("BB", packet.data)
            success = not arms or Bits.CAN_BE_ARMED in self.bits
            if success:
                self._armed = bool(arms)
            else:
                self.refusal = f"it cannot be armed: {self._obstacle}"
            outcome = self._armed
        elif request == 2:
            outcome = success = self._stand_up()
            if not success:
                self.refusal = f"it cannot recover: {self._obstacle}, or there is no room to stand"
        elif request == 3:
            self._locked = outcome = True
        elif request == 4:
            self._watchdog, outcome = self._now, not self._locked
        else:
            raise MalformedError(f"command {request} to the supervisor: from 1 to 4 is needed")
        return [packet._replace(data=pack("BBB", request | 0x80, success, outcome))]

    def _stand_up(self) -> bool:
        """Recover from a crash: the body is put on its feet, as somebody would."""
        if self._locked or (self._tumbled and not self._recover()):
            return False
        self._crashed, self._upright_at = False, self._now
        return True

    def _about(self, packet: Packet) -> list[Packet]:
        """Answer the platform's port: versions; and arming as older clients ask for it."""
        (request,) = unpack("B", packet.data)
        if packet.channel == 0:
            if request in (1, 2):
                self._supervise(Packet(Port.SUPERVISOR, 1, packet.data))
            return [packet]
        if packet.channel == 1 and request in (0, 1):
            told = bytes([PROTOCOL_VERSION]) if request == 0 else b"bulletuav\0"
            return [packet._replace(data=bytes([request]) + told)]
        raise MalformedError(f"request {request} on channel {packet.channel} of the platform")

    @staticmethod
    def _link(packet: Packet) -> list[Packet]:
        """Answer the link: an echo, its source, or nothing for its sink."""
        if packet.channel == 1:
            return [packet._replace(data=LINK_NAME.ljust(MOST_DATA, b"\0"))]
        return [packet] if packet.channel == 0 else []
