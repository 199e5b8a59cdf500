"""Message handling of one MAVLink vehicle, without sockets."""

import logging
import math
from collections.abc import Sequence

from bulletuav.bridges import mavlink_setpoints
from bulletuav.bridges.mavlink_camera import CAMERA_COMPONENT, MavlinkCamera
from bulletuav.bridges.mavlink_commands import COMMANDS, CommandRequest, set_mode
from bulletuav.bridges.mavlink_gimbal import DEVICE_ID
from bulletuav.bridges.mavlink_missions import ACCEPTED
from bulletuav.bridges.mavlink_motions import Sticks, Target
from bulletuav.bridges.mavlink_protocol import (
    COMPONENT,
    Command,
    CommandResult,
    Message,
    OutgoingMessage,
    RefusedError,
    Sender,
    text,
)
from bulletuav.bridges.mavlink_telemetry import TelemetryRates, make_message
from bulletuav.bridges.mavlink_vehicle import MavlinkVehicle
from bulletuav.bridges.setpoints import AirspaceCommand, Setpoint
from bulletuav.bridges.sockets import LOG_NAME

SETPOINTS = (
    "SET_POSITION_TARGET_LOCAL_NED",
    "SET_POSITION_TARGET_GLOBAL_INT",
    "SET_ATTITUDE_TARGET",
)
MISSIONS = (
    "MISSION_COUNT",
    "MISSION_ITEM",
    "MISSION_ITEM_INT",
    "MISSION_REQUEST",
    "MISSION_REQUEST_INT",
    "MISSION_REQUEST_LIST",
    "MISSION_CLEAR_ALL",
    "MISSION_ACK",
)
PARAMETERS = ("PARAM_REQUEST_READ", "PARAM_REQUEST_LIST", "PARAM_SET")
COMMAND_MESSAGES = ("COMMAND_LONG", "COMMAND_INT")
LOG = logging.getLogger(LOG_NAME)
COMPLAINT_INTERVAL = 1.0
"""Minimum time between texts about denied setpoints, s"""
MISSION_CURRENT = 42
MAX_TARGET_SPEED = 100.0
"""Limit of the velocity of a target, m/s"""
STICK_DEADZONE = 0.05
"""Deflection below which a stick counts as centred, from 0 to 1"""


class Services:
    """Message handler of one vehicle: answers clients, and sends telemetry.

    Attributes:
        vehicle: The vehicle.
        streams: Intervals of the telemetry streams.
        camera: Camera; None for none.
    """

    def __init__(self, vehicle: MavlinkVehicle, camera: MavlinkCamera | None = None) -> None:
        """Initialise the handler of a vehicle."""
        self.camera = camera
        self.vehicle, self.streams = vehicle, TelemetryRates(vehicle.system_id)
        self._setpoint_sender: Sender | None = None
        self._warned: Sender | None = None
        self._last_complaint_time = -math.inf

    def answer(self, message: Message, sender: Sender) -> list[OutgoingMessage]:
        """Handle a message from a client.

        Args:
            message: Message from a client.
            sender: Sender of the message.

        Returns:
            Messages to send back to this client; none if the message is addressed to another
            system or is not supported.
        """
        # ID 0 is broadcast; messages to other systems and components are ignored
        system_id = getattr(message, "target_system", getattr(message, "target", 0))
        if system_id not in (0, self.vehicle.system_id):
            return []
        component = getattr(message, "target_component", 0)
        if component == CAMERA_COMPONENT and self.camera is not None:
            return self.camera.answer(message, sender)
        if component not in (0, COMPONENT):
            return []
        # Commands, setpoints and missions have answers of their own
        message_type = message.get_type()
        if message_type in COMMAND_MESSAGES:
            return self._handle_command(message, sender)
        if message_type in SETPOINTS or message_type == "MANUAL_CONTROL":
            return self._handle_setpoint(message, sender)
        if message_type in MISSIONS:
            return self.vehicle.missions.answer(message, sender, self.vehicle.pilot.now)
        try:
            return self._handle_other(message, sender)
        except RefusedError as error:
            return [text(str(error))]

    def _handle_other(self, message: Message, sender: Sender) -> list[OutgoingMessage]:
        """Handle parameters, modes, the current item, the target, the shell, time and pings."""
        message_type = message.get_type()
        if message_type in PARAMETERS:
            return self.vehicle.parameters.answer(message)
        if message_type == "SET_MODE":
            set_mode(self.vehicle, message.custom_mode >> 16 & 255, message.custom_mode >> 24)
        elif message_type == "MISSION_SET_CURRENT":
            self.vehicle.pilot.set_current_item(message.seq)
            return [make_message(self.vehicle, MISSION_CURRENT)]
        elif message_type == "FOLLOW_TARGET":
            self._set_target(message)
        elif message_type == "GIMBAL_MANAGER_SET_PITCHYAW":
            if message.gimbal_device_id in (0, DEVICE_ID):
                angles = (message.pitch, message.yaw, message.pitch_rate, message.yaw_rate)
                self.vehicle.gimbal.point(*angles, message.flags)
        elif message_type == "SERIAL_CONTROL":
            return self.vehicle.shell.answer(message)
        elif message_type == "TIMESYNC" and message.tc1 == 0:
            return [OutgoingMessage("timesync", (self.vehicle.time_boot_ms * 10**6, message.ts1))]
        elif message_type == "PING" and message.target_system == 0:
            return [OutgoingMessage("ping", (message.time_usec, message.seq, *sender[:2]))]
        return []

    def _handle_command(self, message: Message, sender: Sender) -> list[OutgoingMessage]:
        """Run a command, and return its COMMAND_ACK and further messages."""
        result, replies = CommandResult.UNSUPPORTED, list[OutgoingMessage]()
        if message.command in COMMANDS:
            try:
                handler, request = COMMANDS[message.command], CommandRequest.from_message(message)
                replies = list(handler(self.vehicle, self.streams, request))
                result = CommandResult.ACCEPTED
            except RefusedError as error:
                result, replies = error.result, [text(str(error))]
        return [
            OutgoingMessage("command_ack", (message.command, result, 0, 0, *sender[:2])),
            *replies,
        ]

    def _handle_setpoint(self, message: Message, sender: Sender) -> list[OutgoingMessage]:
        """Handle a setpoint or sticks; a second client's are denied while the first one sends."""
        pilot, vehicle, message_type = self.vehicle.pilot, self.vehicle, message.get_type()
        try:
            # Setpoints of two clients would make the vehicle jump back and forth
            is_commanded = pilot.has_recent_setpoint or pilot.has_recent_sticks
            if self._setpoint_sender not in (None, sender) and is_commanded:
                raise RefusedError("setpoints denied: another client sends setpoints")
            if message_type == "MANUAL_CONTROL":
                pilot.sticks = _read_sticks(message, pilot.now)
                self._setpoint_sender = sender
                return []
            # Frames and type masks differ between the messages
            setpoint: Setpoint | AirspaceCommand
            if message_type == "SET_ATTITUDE_TARGET":
                setpoint = mavlink_setpoints.parse_attitude_target(message, vehicle.airframe)
            elif message_type == "SET_POSITION_TARGET_LOCAL_NED":
                setpoint = mavlink_setpoints.parse_local_target(message, vehicle.site, pilot.state)
                self._warn_of_position(message, setpoint, sender)
            else:
                setpoint = mavlink_setpoints.parse_global_target(message, vehicle.site, pilot.state)
            pilot.set_offboard_setpoint(setpoint)
            self._setpoint_sender = sender
        # Setpoints arrive many times per second: limit the rate of error texts
        except RefusedError as error:
            if pilot.now - self._last_complaint_time < COMPLAINT_INTERVAL:
                return []
            self._last_complaint_time = pilot.now
            return [text(str(error))]
        return []

    def _warn_of_position(
        self, message: Message, setpoint: Setpoint | AirspaceCommand, sender: Sender
    ) -> None:
        """Log once for each client that a velocity setpoint has a position, too.

        A mask that leaves out nothing but the yaw is probably meant for the velocity alone.
        """
        selects_all = not message.type_mask & 0x1FF
        has_velocity = isinstance(setpoint, Setpoint) and any(setpoint.feedforward[:3])
        has_both = selects_all and has_velocity
        if has_both and message.x == message.y == message.z == 0 and self._warned != sender:
            self._warned = sender
            LOG.warning(
                "vehicle %d: setpoints with mask 0x%04X have position (0, 0, 0) besides their "
                "velocity, and the position counts: set bits 0 to 2 (mask 0x%04X) for the velocity "
                "alone",
                self.vehicle.system_id,
                message.type_mask,
                message.type_mask | 0b111,
            )

    def _set_target(self, message: Message) -> None:
        """Set the target of mode FOLLOW."""
        geodetic = (message.lat / 1e7, message.lon / 1e7, message.alt)
        position = self.vehicle.site.from_global(0, *geodetic)
        north, east, down = (
            min(max(value, -MAX_TARGET_SPEED), MAX_TARGET_SPEED) if math.isfinite(value) else 0.0
            for value in message.vel
        )
        self.vehicle.pilot.target = Target(position, (east, north, -down), self.vehicle.pilot.now)

    def due(self, tick: int) -> list[OutgoingMessage]:
        """Return the messages to send to all clients at a step."""
        vehicle, pilot = self.vehicle, self.vehicle.pilot
        messages = [make_message(vehicle, number) for number in self.streams.due(tick)]
        messages += vehicle.missions.due(pilot.now)
        messages += [
            OutgoingMessage("mission_item_reached", (number,)) for number in pilot.route.reached
        ]
        if pilot.route.reached:
            messages.append(make_message(vehicle, MISSION_CURRENT))
        messages += [text(status) for status in pilot.status_texts]
        if self.camera is not None:
            messages += self.camera.due(tick)
        pilot.route.reached.clear()
        pilot.status_texts.clear()
        return messages


def _read_sticks(message: Message, now: float) -> Sticks:
    """Convert a MANUAL_CONTROL: axes from -1000 to 1000, the throttle from 0 to 1000.

    Axes within the deadzone, and invalid ones (outside of -1000 to 1000), count as centred.
    """
    pitch, roll, throttle, yaw = (
        value / 1000 if STICK_DEADZONE <= abs(value) / 1000 <= 1.0 else 0.0
        for value in (message.x, message.y, 2 * message.z - 1000, message.r)
    )
    return Sticks(pitch, roll, throttle, yaw, now)


def find_refusal_reason(answers: Sequence[OutgoingMessage]) -> str:
    """Return the reason for which a message was denied, from its answers; empty if it was not."""
    reasons = []
    for answer in answers:
        if answer.name == "statustext":
            reasons.append(answer.fields[1].decode())
        elif answer.name == "command_ack" and answer.fields[1] != CommandResult.ACCEPTED:
            reasons.append(f"result {CommandResult(answer.fields[1]).name}")
        elif answer.name == "mission_ack" and answer.fields[2] != ACCEPTED:
            reasons.append(f"mission result {answer.fields[2]}")
    return "; ".join(reasons)


def describe_message(message: Message) -> str:
    """Return a message's name, with its command if there is one."""
    message_type: str = message.get_type()
    if message_type not in COMMAND_MESSAGES:
        return message_type
    is_known = message.command in tuple(Command)
    return f"{message_type} {Command(message.command).name if is_known else message.command}"


def join_frames(frames: Sequence[bytes], max_size: int) -> list[bytes]:
    """Join frames into datagrams of a maximum size, bytes."""
    datagrams = [b""]
    for frame in frames:
        if len(datagrams[-1]) + len(frame) > max_size:
            datagrams.append(b"")
        datagrams[-1] += frame
    return [datagram for datagram in datagrams if datagram]
