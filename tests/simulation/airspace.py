"""`Airspace` behind the interface of the environment classes: an action is a command."""

from typing import Any

import numpy as np

from bulletuav import Airspace, SetpointLevel

from .faces import FACES, Face
from .forms import Form, pick
from .invariants import require

KEPT = ("dynamics", "seed", "wind", "turbulence", "effects", "contacts", "physics_hz", "airframe")
KEPT += ("friction", "restitution", "gravity", "max_speed", "controller", "randomization", "rays")
KEPT += ("wind_profile", "lidar_frame", "num_beams", "max_range", "lidar_elevations", "sensors")
KEPT += ("thermals",)
NO_PID = SetpointLevel.ACCELERATION
"""Level that the controller 'pid' does not take"""
SIZES = {SetpointLevel.VELOCITY: 3, SetpointLevel.ACCELERATION: 3, SetpointLevel.POSITION: 3}


class Space(Face):
    """An `Airspace` in a row of drones."""

    def make(self, form: Form, rng: np.random.Generator) -> Any:
        count = int(rng.integers(1, 5))
        self.places = np.array([(2.0 * k, 0.0, 5.0) for k in range(count)])
        options = {name: form.options[name] for name in KEPT if name in form.options}
        # Without weight nothing but ROTOR can be commanded, and only in dynamics with motors.
        gravity = options.get("gravity", 1.0)
        if isinstance(gravity, int | float) and gravity == 0:
            del options["gravity"]
        self.started = True
        return Airspace(self.places, **{"decision_hz": 24, "seed": 0, **options})

    def __init__(self, form: Form, rng: np.random.Generator) -> None:
        super().__init__(form, rng)
        self.started = True

    def twin(self, copy: Any) -> Face:
        face = super().twin(copy)
        face.started = True
        return face

    def reset(self, **keywords: Any) -> Any:
        self.env.place(None, self.places)
        return self.env.swarm

    def act(self, rng: np.random.Generator) -> Any:
        levels = [one for one in SIZES if one <= self.env.consumes]
        if self.form.options.get("controller") == "pid":
            levels = [one for one in levels if one != NO_PID]
        level = pick(rng, levels)
        drone = pick(rng, (None, int(rng.integers(len(self.places)))))
        return drone, level, rng.normal(0.0, 1.0, 3) + (0.0, 0.0, 2.0)

    def spoil(self, rng: np.random.Generator, action: Any) -> Any:
        drone, level, setpoint = action
        return pick(
            rng,
            (
                (99, level, setpoint),
                (-1.5, level, setpoint),
                (drone, "nonsense", setpoint),
                (drone, level, setpoint * np.nan),
                (drone, level, np.zeros(7)),
                (drone, level, "text"),
                (drone, None, setpoint),
            ),
        )

    def step(self, action: Any) -> Any:
        self.env.command(*action)
        self.env.step()
        return [*self.env.swarm, *self.env.contacts]

    def note(self) -> Any:
        return self.env.time

    def check_step(self, value: Any, before: Any) -> None:
        for array in self.env.swarm:
            require(np.isfinite(array).all(), "a state is not finite")
        norm = np.linalg.norm(self.env.swarm.quaternion, axis=-1)
        require(np.allclose(norm, 1.0), f"quaternions have norm {norm}")
        require(np.isclose(self.env.time, before + self.env.period), "time went on otherwise")


FACES["space"] = Space
