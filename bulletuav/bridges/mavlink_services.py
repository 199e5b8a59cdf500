"""Messages to and from one MAVLink vehicle, without sockets."""

import math
from collections.abc import Sequence

from bulletuav.bridges import mavlink_setpoints
from bulletuav.bridges.mavlink_commands import COMMANDS, CommandRequest, set_mode
from bulletuav.bridges.mavlink_missions import ACCEPTED
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
from bulletuav.bridges.setpoints import Order, Setpoint

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
COMPLAINT_INTERVAL = 1.0
"""How long a text about setpoints is not told again, s"""
MISSION_CURRENT = 42


class Services:
    """Answers clients of one vehicle, and tells what is due.

    Attributes:
        vehicle: The vehicle.
        streams: How often each message is sent.
    """

    def __init__(self, vehicle: MavlinkVehicle) -> None:
        """Serve a vehicle."""
        self.vehicle, self.streams = vehicle, TelemetryRates(vehicle.system_id)
        self._setpoint_sender: Sender | None = None
        self._last_complaint_time = -math.inf

    def answer(self, message: Message, sender: Sender) -> list[OutgoingMessage]:
        """Take a message.

        Args:
            message: From a client.
            sender: Who sent it.

        Returns:
            Answers to this client; none to a message that is for others, or not known.
        """
        # 0 is for all; messages to others are not answered
        if getattr(message, "target_system", 0) not in (0, self.vehicle.system_id):
            return []
        if getattr(message, "target_component", 0) not in (0, COMPONENT):
            return []
        # By kind: commands, setpoints, missions, and the rest
        kind = message.get_type()
        if kind in COMMAND_MESSAGES:
            return self._handle_command(message, sender)
        if kind in SETPOINTS:
            return self._handle_setpoint(message, sender)
        if kind in MISSIONS:
            return self.vehicle.missions.answer(message, sender, self.vehicle.pilot.now)
        try:
            return self._handle_other(message, sender)
        except RefusedError as error:
            return [text(str(error))]

    def _handle_other(self, message: Message, sender: Sender) -> list[OutgoingMessage]:
        """Answer what is neither a command nor a setpoint nor about missions."""
        kind = message.get_type()
        if kind in PARAMETERS:
            return self.vehicle.parameters.answer(message)
        if kind == "SET_MODE":
            set_mode(self.vehicle, message.custom_mode >> 16 & 255, message.custom_mode >> 24)
        elif kind == "MISSION_SET_CURRENT":
            self.vehicle.pilot.set_current_item(message.seq)
            return [make_message(self.vehicle, MISSION_CURRENT)]
        elif kind == "TIMESYNC" and message.tc1 == 0:
            return [OutgoingMessage("timesync", (self.vehicle.time_boot_ms * 10**6, message.ts1))]
        elif kind == "PING" and message.target_system == 0:
            return [OutgoingMessage("ping", (message.time_usec, message.seq, *sender[:2]))]
        return []

    def _handle_command(self, message: Message, sender: Sender) -> list[OutgoingMessage]:
        """Do what a command says, and acknowledge it."""
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
        """Take a setpoint; those of a second client are refused while the first sends some."""
        pilot, vehicle, kind = self.vehicle.pilot, self.vehicle, message.get_type()
        try:
            # Two clients at once would make the vehicle jump to and fro
            if self._setpoint_sender not in (None, sender) and pilot.has_recent_setpoint:
                raise RefusedError("setpoints refused: another client sends some")
            # Each message has frames and masks of its own
            setpoint: Setpoint | Order
            if kind == "SET_ATTITUDE_TARGET":
                setpoint = mavlink_setpoints.parse_attitude_target(message, vehicle.airframe)
            elif kind == "SET_POSITION_TARGET_LOCAL_NED":
                setpoint = mavlink_setpoints.parse_local_target(message, vehicle.site, pilot.state)
            else:
                setpoint = mavlink_setpoints.parse_global_target(message, vehicle.site, pilot.state)
            pilot.set_offboard_setpoint(setpoint)
            self._setpoint_sender = sender
        # Setpoints come many times a second: the same complaint is told seldom
        except RefusedError as error:
            if pilot.now - self._last_complaint_time < COMPLAINT_INTERVAL:
                return []
            self._last_complaint_time = pilot.now
            return [text(str(error))]
        return []

    def due(self, tick: int) -> list[OutgoingMessage]:
        """Tell all clients what is due in a step."""
        vehicle, pilot = self.vehicle, self.vehicle.pilot
        messages = [make_message(vehicle, number) for number in self.streams.due(tick)]
        messages += vehicle.missions.due(pilot.now)
        messages += [
            OutgoingMessage("mission_item_reached", (number,)) for number in pilot.route.reached
        ]
        if pilot.route.reached:
            messages.append(make_message(vehicle, MISSION_CURRENT))
        messages += [text(status) for status in pilot.status_texts]
        pilot.route.reached.clear()
        pilot.status_texts.clear()
        return messages


def find_refusal_reason(answers: Sequence[OutgoingMessage]) -> str:
    """Return why a client's message was refused, by its answers; empty if it was not."""
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
    """Name a message, and its command if it has one."""
    kind: str = message.get_type()
    if kind not in COMMAND_MESSAGES:
        return kind
    is_known = message.command in tuple(Command)
    return f"{kind} {Command(message.command).name if is_known else message.command}"


def join_frames(frames: Sequence[bytes], max_size: int) -> list[bytes]:
    """Join frames to datagrams of at most some bytes."""
    datagrams = [b""]
    for frame in frames:
        if len(datagrams[-1]) + len(frame) > max_size:
            datagrams.append(b"")
        datagrams[-1] += frame
    return [datagram for datagram in datagrams if datagram]
