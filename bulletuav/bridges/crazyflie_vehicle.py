"""One virtual Crazyflie without its body: supervisor, services, and priority of its commanders."""

from collections.abc import Callable
from enum import IntFlag

from bulletuav.bridges.crazyflie_high_level import HighLevelCommander
from bulletuav.bridges.crazyflie_policy import OUT_OF_TREE, FoundationController, Target
from bulletuav.bridges.crazyflie_services import CrtpParameterService, LogService, MemoryService
from bulletuav.bridges.crazyflie_setpoints import Commander, ThrustMap
from bulletuav.bridges.crazyflie_toc import PARAMETERS, Telemetry
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
from bulletuav.bridges.setpoints import AirspaceCommand, Setpoint, SetpointController, State
from bulletuav.vehicle.airframe import Airframe

LINK_NAME = b"Bitcraze Crazyflie"
"""Reply on the link's source channel; clients connect only if it is this text"""
TUMBLE_TIMEOUT = 1.0
"""Time upside down after which a drone counts as tumbled and its motors stop, s"""
WATCHDOG_TIMEOUT = 1.0
"""Maximum time between packets of the emergency-stop watchdog, after the first of them, s"""
MOTION_COMMANDS = (7, 8, 11, 12, 13)
"""Commands of the high-level commander that move the drone"""
CONTROLLER = "stabilizer.controller"
"""Parameter that selects the controller"""
MIN_FLYING_SPEED_FRACTION = 0.1
"""Fraction of the maximum rotor speed above which a drone counts as flying"""


class SupervisorBits(IntFlag):
    """Bit field of the supervisor's state, as in the firmware (`supervisor.info`)."""

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
    """Firmware of one virtual Crazyflie: takes CRTP packets, returns answers and flight commands.

    The body flies in the airspace of a `CrazyflieFleet`, which passes its state to `update_state`.

    Attributes:
        parameters: Parameter service.
        logs: Log service with the client's log blocks.
        malformed: Number of packets that could not be parsed.
        refusal: Reason why the last packet had no effect, with a remedy; empty if it had one.
    """

    def __init__(self, airframe: Airframe, set_upright: Callable[[], bool]) -> None:
        """Initialise the drone as armed, as firmware does that needs no arming.

        Args:
            airframe: Airframe of the body.
            set_upright: Function that places the body upright and returns True if there was space.
        """
        self._airframe, self._set_upright = airframe, set_upright
        self.parameters, self.logs, self._memory = (
            CrtpParameterService(),
            LogService(),
            MemoryService(),
        )
        self._thrust_map, self._guide = ThrustMap(airframe), SetpointController(airframe)
        self._commander = Commander(self._thrust_map)
        self._high_level = HighLevelCommander(airframe, self._memory.content)
        self._policy: FoundationController | None = None
        self._is_armed, self._is_locked, self._is_crashed = True, False, False
        self._last_upright_time, self._now = 0.0, 0.0
        self._watchdog_time: float | None = None
        self._state: State = ([0.0] * 3, [0.0, 0.0, 0.0, 1.0], [0.0] * 3, [0.0] * 3)
        self._rotor_speed = [0.0] * len(airframe.rotors)
        self._acceleration = [0.0] * 3
        self.malformed, self.refusal = 0, ""

    def reset_client(self) -> None:
        """Delete the log blocks of a client that has disconnected."""
        self.logs.clear()

    def update_state(
        self, state: State, acceleration: list[float], rotor_speed: list[float], now: float
    ) -> None:
        """Set the measured state, and update the supervisor: tumble, crash and watchdog.

        Args:
            state: State of the body.
            acceleration: (3,) mean acceleration over the last step, m/s^2.
            rotor_speed: (R,) rotor speeds, rad/s.
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
        """True if the drone has been upside down for longer than `TUMBLE_TIMEOUT`."""
        return self._now - self._last_upright_time > TUMBLE_TIMEOUT

    @property
    def _is_flying(self) -> bool:
        """True if any rotor turns faster than an idle motor."""
        return max(self._rotor_speed) > MIN_FLYING_SPEED_FRACTION * self._airframe.max_rotor_speed

    @property
    def _can_fly(self) -> bool:
        """True if the supervisor allows the motors to turn."""
        return self._is_armed and not (self._is_locked or self._is_crashed or self._is_tumbled)

    @property
    def supervisor_bits(self) -> SupervisorBits:
        """State of the supervisor."""
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

    def order(self, period: float) -> AirspaceCommand | None:
        """Return the flight command of the next step, or None for motors off.

        A low-level setpoint takes priority over the high-level commander until the client releases
        control or the setpoint times out.

        Args:
            period: Duration of the step, s.
        """
        command, setpoint = self._follow_commanders(period)
        if self._policy is None:
            return command
        target: Target | None
        if setpoint is None:
            target = self._high_level.target(self._now)
        else:
            target = (*setpoint.xy, setpoint.z), setpoint.feedforward[:3]
        return self._policy.compute_command(command, target, self._state)

    def _follow_commanders(self, period: float) -> tuple[AirspaceCommand | None, Setpoint | None]:
        """Return the command of the commander in control, and the low-level setpoint if any."""
        setpoint = self._commander.current(self._now)
        if not self._can_fly:
            self._commander.clear()
            self._high_level.stop()
            return None, None
        if self._high_level.has_plan and (setpoint is None or self._commander.is_released):
            self._commander.clear()
            self._guide.reset()
            return self._high_level.order(self._state, self._now), None
        if setpoint is None or (setpoint.z_mode == "thrust" and setpoint.z == 0):
            self._guide.reset()
            return None, None
        return self._guide.compute_command(setpoint, self._state, period), setpoint

    def telemetry(self, pressure: Callable[[float], float]) -> Telemetry:
        """Return the present values of all log variables.

        Args:
            pressure: Function that returns the air pressure (Pa) at a height (m).
        """
        max_speed = self._airframe.max_rotor_speed
        plan = self._high_level.target(self._now)
        target = self._state[0] if plan is None else plan[0].tolist()
        return Telemetry(
            self._state,
            self._acceleration,
            [speed / max_speed for speed in self._rotor_speed],
            (self._thrust_map.command(self._rotor_speed), target, int(self.supervisor_bits)),
            pressure,
        )

    def answer(self, packet: Packet, tick: int) -> list[Packet]:
        """Handle a packet from the client.

        Args:
            packet: Packet from the client.
            tick: Present time in units of 10 ms.

        Returns:
            Packets to send back. A malformed packet is counted and has no answer.
        """
        self.refusal = ""
        try:
            return self._answer(packet, tick)
        except MalformedError as error:
            self.malformed += 1
            self.refusal = str(error)
            return []

    def _answer(self, packet: Packet, tick: int) -> list[Packet]:
        """Dispatch a packet to the service of its port."""
        if packet.port == CrtpPort.LOG:
            return self.logs.answer(packet, tick)
        if packet.port == CrtpPort.PARAM:
            answers = self.parameters.answer(packet)
            self._select_controller()
            return answers
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
                self.refusal = f"command {packet.data[0]} returned {Errno(error).name}"
            return [packet._replace(data=packet.data[:3] + bytes([error]))]
        if packet.port == CrtpPort.SUPERVISOR:
            return self._handle_supervisor(packet)
        if packet.port == CrtpPort.PLATFORM:
            return self._handle_platform(packet)
        if packet.port == CrtpPort.LINK:
            return self._handle_link(packet)
        # External positions (localization port) are ignored: the drone knows its position
        return []

    def _select_controller(self) -> None:
        """Start or end the policy by the parameter; an airframe that it cannot fly resets both."""
        values = self.parameters.values
        if values[CONTROLLER] != OUT_OF_TREE:
            self._policy = None
        elif self._policy is None:
            try:
                self._policy = FoundationController(self._airframe)
            except ValueError as error:
                values[CONTROLLER] = PARAMETERS[CONTROLLER].value
                self.refusal = f"{CONTROLLER} is {OUT_OF_TREE}: {error}"

    @property
    def _blocking_reason(self) -> str:
        """Reason why the motors may not turn, with a remedy."""
        if self._is_locked:
            return "it is locked by an emergency stop; restart the server"
        if self._is_crashed or self._is_tumbled:
            return "it has crashed; send the supervisor's request to recover"
        return "it is not armed; arm it first"

    def _record_unless_flyable(self) -> None:
        """Record a refusal if the motors may not turn; as in the firmware the command is kept."""
        if not self._can_fly:
            self.refusal = f"it cannot fly: {self._blocking_reason}"

    def _handle_setpoint(self, packet: Packet) -> None:
        """Handle a low-level setpoint, which discards the plan, or a request to release control."""
        if packet.port == CrtpPort.SETPOINT_GENERIC and packet.channel == 1:
            (request,) = unpack_data("B", packet.data)
            if request:
                raise MalformedError(f"setpoint request {request}: 0 is needed")
            self._commander.release()
            return
        # A setpoint of zeros stops the motors, which is allowed in any state
        if any(packet.data):
            self._record_unless_flyable()
        values = self.parameters.values
        is_rate = not values["flightmode.stabModeRoll"] and not values["flightmode.stabModePitch"]
        self._commander.set_setpoint(
            packet, self._now, (is_rate, not values["flightmode.stabModeYaw"])
        )
        self._high_level.stop()

    def _handle_supervisor(self, packet: Packet) -> list[Packet]:
        """Handle a packet to the supervisor port."""
        (request,) = unpack_data("B", packet.data)
        # Channel 0 requests the state
        if packet.channel == 0:
            if request != 0x0C:
                raise MalformedError(f"supervisor request {request}: 12 is needed")
            return [
                packet._replace(data=pack_data("BH", request | 0x80, int(self.supervisor_bits)))
            ]
        # Commands on the other channel: arm, recover, emergency stop, feed the watchdog
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
                self.refusal = (
                    f"it cannot recover: {self._blocking_reason}, or there is no space to stand"
                )
        elif request == 3:
            self._is_locked = outcome = True
        elif request == 4:
            self._watchdog_time, outcome = self._now, not self._is_locked
        else:
            raise MalformedError(f"supervisor command {request}: from 1 to 4 is needed")
        return [packet._replace(data=pack_data("BBB", request | 0x80, success, outcome))]

    def _recover_from_crash(self) -> bool:
        """Place a tumbled body upright and clear the crash; return True on success."""
        if self._is_locked or (self._is_tumbled and not self._set_upright()):
            return False
        self._is_crashed, self._last_upright_time = False, self._now
        return True

    def _handle_platform(self, packet: Packet) -> list[Packet]:
        """Handle a packet to the platform port: versions, and arming requests of older clients."""
        (request,) = unpack_data("B", packet.data)
        if packet.channel == 0:
            if request in (1, 2):
                self._handle_supervisor(Packet(CrtpPort.SUPERVISOR, 1, packet.data))
            return [packet]
        if packet.channel == 1 and request in (0, 1):
            reply = bytes([PROTOCOL_VERSION]) if request == 0 else b"bulletuav\0"
            return [packet._replace(data=bytes([request]) + reply)]
        raise MalformedError(f"unknown platform request {request} on channel {packet.channel}")

    @staticmethod
    def _handle_link(packet: Packet) -> list[Packet]:
        """Handle a packet to the link port: echo, source, or sink, which has no answer."""
        if packet.channel == 1:
            return [packet._replace(data=LINK_NAME.ljust(MAX_DATA_SIZE, b"\0"))]
        return [packet] if packet.channel == 0 else []
