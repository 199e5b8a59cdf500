"""The ladder of dynamics by name, the cheapest first."""

from collections.abc import Callable
from functools import partial

from bulletuav.dynamics.base import Dynamics, Flight
from bulletuav.dynamics.bullet import BulletDynamics
from bulletuav.dynamics.kinematic import DOUBLE_INTEGRATOR, POINT_MASS, SINGLE_INTEGRATOR, Kinematic
from bulletuav.dynamics.rigid_body import RigidBody

LADDER: dict[str, Callable[[Flight], Dynamics]] = {
    "single_integrator": partial(Kinematic, SINGLE_INTEGRATOR),
    "double_integrator": partial(Kinematic, DOUBLE_INTEGRATOR),
    "point_mass": partial(Kinematic, POINT_MASS),
    "rigid_body": RigidBody,
    "bullet": BulletDynamics,
}
