"""Energy of flight: power consumption of drones, and the charge of their batteries."""

import math

import numpy as np

from bulletuav.compiled.gather import gathered, pack_numbers, scatter, three
from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.lanes import WIDTH, lane_zeros, lanes_row
from bulletuav.compiled.program import Program
from bulletuav.envs.options import EnvOptions
from bulletuav.envs.rows import add_rows, add_value
from bulletuav.geometry.rotation import vec3
from bulletuav.vehicle.battery import (
    Battery,
    battery_speed_ratio,
    drain_batteries,
    loaded_voltage,
    resting_voltage,
)
from bulletuav.vehicle.parameters import PARAMETERS
from bulletuav.vehicle.power import (
    ROTARY_WING,
    W20,
    RotaryWing,
    airframe_wing,
    fill_actuator_power,
    propulsion_power,
    rotor_power,
)
from bulletuav.vehicle.swarm import Swarm
from bulletuav.vehicle.wing_power import WING_POWER, wing_power, winged_power

MASS = list(PARAMETERS.names or ()).index("mass")
"""Index of the mass among the numbers of a row of `PARAMETERS`, which begins with it"""


class Energy:
    """Power of all drones, and their batteries.

    With the option `energy` "zeng" power follows from the rotary-wing formula, at the velocity
    relative to the air, from the present mass and gravity, and from the pull of cables. With
    "actuator", and always if the option `gravity` is 0, it is the power of the simulated rotors. So
    it is for aircraft with wings; dynamics without rotors compute theirs from the drag polar, see
    `bulletuav.vehicle.wing_power`. All are electrical, with the losses of the airframe's motors.

    Attributes:
        power: (W, N) mean power over the last decision, W.
        voltage: (W, N) voltage of the batteries, V; 0 if the airframe has no battery model.
    """

    def __init__(
        self,
        options: EnvOptions,
        parameters: np.ndarray,
        supply: np.ndarray,
        local_gravity: np.ndarray,
        has_rotors: bool,
    ) -> None:
        """Start with full batteries.

        Args:
            options: Options of the environment.
            parameters: (W, N) rows of `PARAMETERS` that the dynamics uses.
            supply: (W, N) fraction of the commanded rotor speed that motors reach; written with the
                effect "voltage".
            local_gravity: (W, N) gravitational acceleration that acts on the drones, m/s^2.
            has_rotors: Whether the dynamics simulates rotors.
        """
        self.power, self.voltage = np.zeros((2, *parameters.shape))
        self._battery = Battery(parameters.shape, _capacities(options))
        # Cells, resistance and nominal voltage of each drone
        self._packs = np.zeros((options.num_drones, 3))
        for row, airframe in zip(self._packs, options.airframe, strict=True):
            if airframe.pack is not None:
                row[:] = airframe.pack.cells, airframe.pack.resistance, airframe.pack.voltage
        self._supply = supply if "voltage" in options.effects else np.ones(parameters.shape)
        self._parameters, self._gravity = parameters, local_gravity
        self._period = 1 / options.decision_hz
        self._wings: np.ndarray | None = None
        # The rotary-wing formula computes power from the weight, so it needs gravity
        if options.energy == "zeng" and options.gravity > 0:
            # Drones that cannot hover have none; their power is replaced
            wings = [
                airframe_wing(airframe, options.gravity) if airframe.hover_speed() > 0 else W20
                for airframe in options.airframe
            ]
            self._wings = np.array([wings] * len(parameters), dtype=ROTARY_WING)
            # Constant, so packed once, block by block
            self._packed = lane_zeros(-(-parameters.size // WIDTH), len(RotaryWing._fields))
            pack_numbers(self._wings.view(float).reshape(*parameters.shape, -1), self._packed)
            # The same numbers as in the rows, which change in flight
            self._numbers = parameters.view(float).reshape(*parameters.shape, -1)
        self._winged = np.array([wing_power(airframe) for airframe in options.airframe], WING_POWER)
        self._has_rotors = has_rotors

    def add_start(self, program: Program, worlds: np.ndarray, charge: np.ndarray) -> None:
        """Add to a program that batteries of worlds (W,) bool that start an episode are charged.

        Args:
            program: Program that is extended.
            worlds: Worlds that start.
            charge: Its first rows are the charges (N,) of these worlds.
        """
        add_rows(program, worlds, charge, self._battery.charge)
        add_value(program, worlds, 0.0, self.power)

    def add_voltage(self, program: Program, net: np.ndarray | None = None) -> None:
        """Add to a program that voltages are computed from charge and power.

        Args:
            program: Program that is extended.
            net: (W, N) power that batteries deliver, W, if it differs from that of the drones.
        """
        if self._packs.any():
            given = (self._battery.charge, self.power if net is None else net, self._packs)
            program.call(_fill_voltage, *given, self.voltage, self._supply)

    def add_to(
        self,
        program: Program,
        before: Swarm,
        after: Swarm,
        wind: np.ndarray,
        payload: np.ndarray,
        flown: np.ndarray,
        pull: np.ndarray,
        charging: np.ndarray | None = None,
    ) -> None:
        """Add to a program that a decision drains the batteries, and charges them.

        Args:
            program: Program that is extended.
            before: State before the decision.
            after: State after the decision.
            wind: (W, N, 3) wind during the decision, m/s.
            payload: (W, N) power of equipment in addition to flight, W.
            flown: (W, N) bool, drones active before the decision; only their batteries are drained.
            pull: (W, N) force of cables on the drones, downwards, N.
            charging: (W, N) power that charges the batteries, W; None if nothing does.
        """
        if self._wings is None:
            speeds = (before.rotor_speed, after.rotor_speed)
            program.call(fill_actuator_power, *speeds, self._parameters, self.power)
            program.call(_add_losses, self._parameters, self.power)
        else:
            velocities = (before.velocity, after.velocity, wind)
            given = (self._numbers, self._gravity, pull, self._wings, self._packed)
            program.call(_fill_propulsion, *velocities, *given, self.power)
            if self._has_rotors and self._winged["num_rotors"].any():
                speeds = (before.rotor_speed, after.rotor_speed)
                program.call(_fill_shaft_power, *speeds, self._parameters, self._winged, self.power)
            elif self._winged["num_rotors"].any():
                air = (self._parameters, self._gravity, self._period)
                rows = (self._winged, self._wings[0])
                program.call(_fill_winged_power, *velocities, *air, *rows, self.power)
        program.call(_add_payload, payload, flown, self.power)
        battery, net = self._battery, self.power
        if charging is not None:
            net = np.zeros_like(self.power)
            program.call(_subtract, self.power, charging, net)
        program.call(drain_batteries, net, self._period, flown, battery.energy, battery.charge)
        self.add_voltage(program, net)

    def kept(self) -> dict[str, np.ndarray]:
        """Return the arrays (W, N) by name that follow from the last decision."""
        energy = {"full": self._battery.energy, "supply": self._supply}
        return {"power": self.power, "voltage": self.voltage, **energy}

    def readings(self) -> dict[str, np.ndarray]:
        """Return what drones measure of their energy.

        Returns:
            "charge", the fraction of the energy that is left, "power", W, and "voltage", V, 0 if
            the airframe has no battery model: (W, N) each, overwritten in each decision.
        """
        return {"charge": self._battery.charge, "power": self.power, "voltage": self.voltage}


def _capacities(options: EnvOptions) -> np.ndarray:
    """Return the energy of full batteries, W h: (N,), or one number; infinite for no limit."""
    if options.battery_capacity == "airframe":
        return np.array([one.pack.capacity for one in options.airframe if one.pack is not None])
    return np.array(
        math.inf if options.battery_capacity is None else options.battery_capacity, float
    )


@kernel
def _fill_propulsion(
    before: np.ndarray,
    after: np.ndarray,
    wind: np.ndarray,
    numbers: np.ndarray,
    gravity: np.ndarray,
    pull: np.ndarray,
    wings: np.ndarray,
    packed: np.ndarray,
    power: np.ndarray,
) -> None:
    """Compute the power (W, N) at the mean of two velocities (W, N, 3) relative to the air, W.

    Args:
        before: Velocities before the decision, m/s.
        after: Velocities after the decision.
        wind: Velocity of the air, m/s.
        numbers: (W, N, P) numbers of the rows of `PARAMETERS`.
        gravity: (W, N) gravitational acceleration that acts on the drones, m/s^2.
        pull: (W, N) force of cables on the drones, downwards, N.
        wings: (W, N) rows of `ROTARY_WING`.
        packed: (B, numbers, `WIDTH`) the same rows, block by block.
        power: Written.
    """
    for b in range(packed.shape[0]):
        first = b * WIDTH
        begin, end, air = three(before, first), three(after, first), three(wind, first)
        # Airspeed in the middle of the decision
        velocity = (
            (begin[0] + end[0]) / 2 - air[0],
            (begin[1] + end[1]) / 2 - air[1],
            (begin[2] + end[2]) / 2 - air[2],
        )
        wing = lanes_row(wings, packed, b)
        weight = gathered(numbers, first, MASS) * gathered(gravity, first, 0)
        load = (weight + gathered(pull, first, 0)) / wing.weight
        count = min(power.size - first, WIDTH)
        scatter(power, first, count, propulsion_power(velocity, wing, load))


@kernel
def _fill_shaft_power(
    before: np.ndarray,
    after: np.ndarray,
    parameters: np.ndarray,
    winged: np.ndarray,
    power: np.ndarray,
) -> None:
    """Replace the power (W, N) of drones with wings by that of their simulated rotors, W.

    Args:
        before: (W, N, R) rotor speeds before the decision, rad/s.
        after: (W, N, R) rotor speeds after the decision.
        parameters: (W, N) rows of `PARAMETERS`.
        winged: (N,) rows of `WING_POWER`.
        power: Written.
    """
    for w in range(power.shape[0]):
        for i in range(power.shape[1]):
            if winged[i].num_rotors > 0.0:
                row = parameters[w, i]
                shafts = rotor_power(before[w, i], after[w, i], row)
                power[w, i] = shafts / row.efficiency + row.electronics


@kernel
def _fill_winged_power(
    before: np.ndarray,
    after: np.ndarray,
    wind: np.ndarray,
    parameters: np.ndarray,
    gravity: np.ndarray,
    period: float,
    winged: np.ndarray,
    rotary: np.ndarray,
    power: np.ndarray,
) -> None:
    """Replace the power (W, N) of drones with wings by that of their drag polar, W.

    Args:
        before: (W, N, 3) velocities before the decision, m/s.
        after: (W, N, 3) velocities after the decision.
        wind: (W, N, 3) velocity of the air, m/s.
        parameters: (W, N) rows of `PARAMETERS`.
        gravity: (W, N) gravitational acceleration that acts on the drones, m/s^2.
        period: Duration of the decision, s.
        winged: (N,) rows of `WING_POWER`.
        rotary: (N,) rows of `ROTARY_WING` of their lift rotors.
        power: Written.
    """
    for w in range(power.shape[0]):
        for i in range(power.shape[1]):
            if winged[i].num_rotors > 0.0:
                begin, end = vec3(before, w, i), vec3(after, w, i)
                air, mass = vec3(wind, w, i), parameters[w, i].mass
                velocity = (
                    (begin[0] + end[0]) / 2 - air[0],
                    (begin[1] + end[1]) / 2 - air[1],
                    (begin[2] + end[2]) / 2 - air[2],
                )
                force = (
                    mass * ((end[0] - begin[0]) / period),
                    mass * ((end[1] - begin[1]) / period),
                    mass * ((end[2] - begin[2]) / period + gravity[w, i]),
                )
                power[w, i] = winged_power(velocity, force, winged[i], rotary[i])


@kernel
def _add_losses(parameters: np.ndarray, power: np.ndarray) -> None:
    """Convert shaft power (W, N) to electrical power, W."""
    for w in range(power.shape[0]):
        for i in range(power.shape[1]):
            row = parameters[w, i]
            power[w, i] = power[w, i] / row.efficiency + row.electronics


@kernel
def _fill_voltage(
    charge: np.ndarray,
    power: np.ndarray,
    packs: np.ndarray,
    voltage: np.ndarray,
    supply: np.ndarray,
) -> None:
    """Compute the voltage of all batteries, and the fraction of rotor speeds that motors reach.

    Args:
        charge: (W, N) fraction of the energy that is left.
        power: (W, N) power drawn, W.
        packs: (N, 3) cells, resistance (ohm) and nominal voltage (V) of each drone's battery.
        voltage: (W, N) written, V.
        supply: (W, N) written.
    """
    for w in range(voltage.shape[0]):
        for i in range(voltage.shape[1]):
            cells, resistance, nominal = packs[i]
            # Without a battery model the initial values stay
            if cells > 0.0:
                # Voltage at rest minus the drop of the current, as a fraction of speed
                rest = cells * resting_voltage(charge[w, i])
                voltage[w, i] = loaded_voltage(rest, power[w, i], resistance)
                supply[w, i] = battery_speed_ratio(voltage[w, i], nominal)


@kernel
def _subtract(power: np.ndarray, charging: np.ndarray, net: np.ndarray) -> None:
    """Write the power (W, N) that batteries deliver, W: negative while they are charged."""
    for w in range(power.shape[0]):
        for i in range(power.shape[1]):
            net[w, i] = power[w, i] - charging[w, i]


@kernel
def _add_payload(payload: np.ndarray, flown: np.ndarray, power: np.ndarray) -> None:
    """Add the payload to the power (W, N) of drones that flew; set that of others to 0."""
    for w in range(power.shape[0]):
        for i in range(power.shape[1]):
            power[w, i] = power[w, i] + payload[w, i] if flown[w, i] else 0.0
