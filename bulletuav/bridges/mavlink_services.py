"""Messages to and from one MAVLink vehicle, without sockets."""

import math
from collections.abc import Sequence

from bulletuav.bridges import mavlink_setpoints as setpoints
from bulletuav.bridges.mavlink_commands import COMMANDS, Request, set_mode
from bulletuav.bridges.mavlink_missions import ACCEPTED
from bulletuav.bridges.mavlink_telemetry import Streams, tell
from bulletuav.bridges.mavlink_vehicle import Vehicle
from bulletuav.bridges.mavlink_wire import (
    COMPONENT,
    Command,
    Message,
    RefusedError,
    Result,
    Sender,
    Told,
    text,
)
from bulletuav.bridges.setpoints import AirspaceCommand, Setpoint

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
SAME_AGAIN = 1.0
"""How long a text about setpoints is not told again, s"""
MISSION_CURRENT = 42


class Services:
    """Answers clients of one vehicle, and tells what is due.

    Attributes:
        vehicle: The vehicle.
        streams: How often each message is sent.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        """Serve a vehicle."""
        self.vehicle, self.streams = vehicle, Streams(vehicle.system)
        self._commander: Sender | None = None
        self._complained = -math.inf

    def answer(self, message: Message, sender: Sender) -> list[Told]:
        """Take a message.

        Args:
            message: From a client.
            sender: Who sent it.

        Returns:
            Answers to this client; none to a message that is for others, or not known.
        """
        # 0 is for all; messages to others are not answered
        if getattr(message, "target_system", 0) not in (0, self.vehicle.system):
            return []
        if getattr(message, "target_component", 0) not in (0, COMPONENT):
            return []
        # By kind: commands, setpoints, missions, and the rest
        kind = message.get_type()
        if kind in COMMAND_MESSAGES:
            return self._obey(message, sender)
        if kind in SETPOINTS:
            return self._follow(message, sender)
        if kind in MISSIONS:
            return self.vehicle.missions.answer(message, sender, self.vehicle.pilot.now)
        try:
            return self._answer_others(message, sender)
        except RefusedError as error:
            return [text(str(error))]

    def _answer_others(self, message: Message, sender: Sender) -> list[Told]:
        """Answer what is neither a command nor a setpoint nor about missions."""
        kind = message.get_type()
        if kind in PARAMETERS:
            return self.vehicle.parameters.answer(message)
        if kind == "SET_MODE":
            set_mode(self.vehicle, message.custom_mode >> 16 & 255, message.custom_mode >> 24)
        elif kind == "MISSION_SET_CURRENT":
            self.vehicle.pilot.jump(message.seq)
            return [tell(self.vehicle, MISSION_CURRENT)]
        elif kind == "TIMESYNC" and message.tc1 == 0:
            return [Told("timesync", (self.vehicle.stamp * 10**6, message.ts1))]
        elif kind == "PING" and message.target_system == 0:
            return [Told("ping", (message.time_usec, message.seq, *sender[:2]))]
        return []

    def _obey(self, message: Message, sender: Sender) -> list[Told]:
        """Do what a command says, and acknowledge it."""
        result, said = Result.UNSUPPORTED, list[Told]()
        if message.command in COMMANDS:
            try:
                does, request = COMMANDS[message.command], Request.of(message)
                said = list(does(self.vehicle, self.streams, request))
                result = Result.ACCEPTED
            except RefusedError as error:
                result, said = error.result, [text(str(error))]
        return [Told("command_ack", (message.command, result, 0, 0, *sender[:2])), *said]

    def _follow(self, message: Message, sender: Sender) -> list[Told]:
        """Take a setpoint; those of a second client are refused while the first sends some."""
        pilot, vehicle, kind = self.vehicle.pilot, self.vehicle, message.get_type()
        try:
            # Two clients at once would make the vehicle jump to and fro
            if self._commander not in (None, sender) and pilot.hears:
                raise RefusedError("setpoints refused: another client sends some")
            # Each message has frames and masks of its own
            wanted: Setpoint | AirspaceCommand
            if kind == "SET_ATTITUDE_TARGET":
                wanted = setpoints.of_attitude(message, vehicle.airframe)
            elif kind == "SET_POSITION_TARGET_LOCAL_NED":
                wanted = setpoints.of_local(message, vehicle.site, pilot.state)
            else:
                wanted = setpoints.of_global(message, vehicle.site, pilot.state)
            pilot.follow(wanted)
            self._commander = sender
        # Setpoints come many times a second: the same complaint is told seldom
        except RefusedError as error:
            if pilot.now - self._complained < SAME_AGAIN:
                return []
            self._complained = pilot.now
            return [text(str(error))]
        return []

    def due(self, tick: int) -> list[Told]:
        """Tell all clients what is due in a step."""
        vehicle, pilot = self.vehicle, self.vehicle.pilot
        told = [tell(vehicle, number) for number in self.streams.due(tick)]
        told += vehicle.missions.due(pilot.now)
        told += [Told("mission_item_reached", (number,)) for number in pilot.route.reached]
        if pilot.route.reached:
            told.append(tell(vehicle, MISSION_CURRENT))
        told += [text(words) for words in pilot.said]
        pilot.route.reached.clear()
        pilot.said.clear()
        return told


def refusal_of(answers: Sequence[Told]) -> str:
    """Return why a client's message was refused, by its answers; empty if it was not."""
    reasons = []
    for answer in answers:
        if answer.name == "statustext":
            reasons.append(answer.fields[1].decode())
        elif answer.name == "command_ack" and answer.fields[1] != Result.ACCEPTED:
            reasons.append(f"result {Result(answer.fields[1]).name}")
        elif answer.name == "mission_ack" and answer.fields[2] != ACCEPTED:
            reasons.append(f"mission result {answer.fields[2]}")
    return "; ".join(reasons)


def describe(message: Message) -> str:
    """Name a message, and its command if it has one."""
    kind: str = message.get_type()
    if kind not in COMMAND_MESSAGES:
        return kind
    known = message.command in tuple(Command)
    return f"{kind} {Command(message.command).name if known else message.command}"


def packed(frames: Sequence[bytes], most: int) -> list[bytes]:
    """Join frames to datagrams of at most some bytes."""
    found = [b""]
    for frame in frames:
        if len(found[-1]) + len(frame) > most:
            found.append(b"")
        found[-1] += frame
    return [one for one in found if one]
