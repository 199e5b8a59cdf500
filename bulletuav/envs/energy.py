"""Energy of flight: power consumption of drones, and the charge of their batteries."""

import math

import numpy as np

from bulletuav.compiled.gather import gathered, pack_numbers, scatter, three
from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.lanes import WIDTH, lane_zeros, lanes_row
from bulletuav.compiled.program import Program
from bulletuav.envs.options import EnvOptions
from bulletuav.envs.rows import add_rows, add_value
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
    RotaryWing,
    airframe_wing,
    fill_actuator_power,
    propulsion_power,
)
from bulletuav.vehicle.swarm import Swarm

MASS = list(PARAMETERS.names or ()).index("mass")
"""Index of the mass among the numbers of a row of `PARAMETERS`, which begins with it"""


class Energy:
    """Power of all drones, and their batteries.

    With the option `energy` "zeng" power follows from the rotary-wing formula, at the velocity
    relative to the air, from the present mass and gravity, and from the pull of cables. With
    "actuator", and always if the option `gravity` is 0, it is the power of the simulated rotors.
    Both are electrical, with the losses of the airframe's motors.

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
    ) -> None:
        """Start with full batteries.

        Args:
            options: Options of the environment.
            parameters: (W, N) rows of `PARAMETERS` that the dynamics uses.
            supply: (W, N) fraction of the commanded rotor speed that motors reach; written with the
                effect "voltage".
            local_gravity: (W, N) gravitational acceleration that acts on the drones, m/s^2.
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
            wings = [airframe_wing(airframe, options.gravity) for airframe in options.airframe]
            self._wings = np.array([wings] * len(parameters), dtype=ROTARY_WING)
            # Constant, so packed once, block by block
            self._packed = lane_zeros(-(-parameters.size // WIDTH), len(RotaryWing._fields))
            pack_numbers(self._wings.view(float).reshape(*parameters.shape, -1), self._packed)
            # The same numbers as in the rows, which change in flight
            self._numbers = parameters.view(float).reshape(*parameters.shape, -1)

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
