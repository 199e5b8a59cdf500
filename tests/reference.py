"""Independent model of one drone in plain numpy, to compare the compiled one with.

It is written from the formulas.
"""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

G = 9.80665


class Reference:
    """One drone with constant rotor commands.

    Its forces are those of the literature; it shares nothing with the package.
    """

    def __init__(
        self,
        airframe,
        command,
        *,
        wind=(0, 0, 0),
        lag=True,
        drag=True,
        ground_effect=True,
        rotor_inertia=True,
        gravity=G,
    ):
        self.a, self.command, self.wind = (
            airframe,
            np.asarray(command, float),
            np.asarray(wind, float),
        )
        self.lag, self.drag, self.ground_effect, self.gravity = lag, drag, ground_effect, gravity
        self.rotor_inertia = airframe.rotor_inertia if lag and rotor_inertia else 0.0
        self.x, self.y, self.turn = np.array(airframe.rotors).T
        self.J = np.diag(airframe.inertia)
        self.push, self.twist = np.zeros(3), np.zeros(3)

    def speeds(self, initial, t):
        """Rotor speeds t seconds after the command, closed form."""
        tau = np.where(self.command > initial, self.a.lag_up, self.a.lag_down)
        if not self.lag or (tau == 0).all():
            return self.command
        return self.command + (initial - self.command) * np.exp(-t / tau)

    def winding(self, speeds):
        """How fast the rotors speed up, rad/s^2."""
        tau = np.where(self.command > speeds, self.a.lag_up, self.a.lag_down)
        if not self.lag or (tau == 0).all():
            return np.zeros_like(speeds)
        return (self.command - speeds) / tau

    def wrench(self, position, quaternion, velocity, speeds, winding):
        """Force (world) and torque (body), but for the torques that the rates make."""
        a, R = self.a, Rotation.from_quat(quaternion).as_matrix()
        thrusts = a.thrust_coefficient * speeds**2
        yaw = a.thrust_coefficient * a.torque_ratio * speeds**2
        if self.ground_effect:
            places = np.stack([self.x, self.y, np.zeros_like(self.x)])
            heights = position[2] + (R @ places)[2]
            near = np.clip(1 - heights / a.ground_effect_reach, 0, 1) ** 3
            thrusts = thrusts * (1 + max(R[2, 2], 0) * a.ground_effect_gain * near)
        torque = np.array([self.y @ thrusts, -self.x @ thrusts, self.turn @ yaw])
        torque[2] += self.rotor_inertia * self.turn @ winding
        force = thrusts.sum() * R[:, 2] - np.array([0, 0, a.mass * self.gravity])
        if self.drag:
            v = R.T @ (velocity - self.wind)
            of_rotors = -np.array([a.drag_xy, a.drag_xy, a.drag_z]) * v * speeds.sum()
            areas = np.array([a.body_drag[0], a.body_drag[0], a.body_drag[1]])
            of_body = -0.5 * 1.225 * areas * np.linalg.norm(v) * v
            force += R @ (of_rotors + of_body)
            sideways = of_rotors * (1, 1, 0)
            torque += np.cross([0, 0, a.drag_height], sideways)
        return force + self.push, torque + self.twist

    def blow_on(self, other, way, speeds, quaternion):
        """Let the wake push and tip another drone (m away, z negative) until it is told anew."""
        a = self.a
        square = a.arm**2 + (0.1 * way[2]) ** 2
        thrust = a.thrust_coefficient * np.sum(np.square(speeds))
        push = 0.32 * thrust * a.arm / np.sqrt(square) * np.exp(-(way[:2] @ way[:2]) / 2 / square)
        tip = other.a.arm**2 * push / square
        other.push = np.array([0, 0, -push])
        # The side under the upper drone goes down
        about = np.array([tip * way[1], -tip * way[0], 0])
        other.twist = Rotation.from_quat(quaternion).inv().apply(about)

    def rates_slope(self, rates, torque, speeds):
        """Euler's equation, with the damping by the rotors and their angular momentum."""
        momentum = np.array([0, 0, -self.rotor_inertia * self.turn @ speeds])
        if self.drag:
            hover = len(self.turn) * self.a.hover_speed()
            torque = torque - self.a.damping * np.diag(self.J) * rates * speeds.sum() / hover
        return np.linalg.solve(self.J, torque - np.cross(rates, self.J @ rates + momentum))

    def solve(self, position, quaternion, velocity, rates, initial_speeds, duration):
        """(position, quaternion, velocity, rates) after `duration`, to 1e-10."""
        initial_speeds = np.asarray(initial_speeds, float)

        def slope(t, s):
            speeds = self.speeds(initial_speeds, t)
            q = s[3:7] / np.linalg.norm(s[3:7])
            force, torque = self.wrench(s[:3], q, s[7:10], speeds, self.winding(speeds))
            x, y, z, w = s[3:7]
            p, q, r = s[10:13]
            turn = 0.5 * np.array(
                [
                    w * p + y * r - z * q,
                    w * q + z * p - x * r,
                    w * r + x * q - y * p,
                    -x * p - y * q - z * r,
                ]
            )
            return np.concatenate(
                [s[7:10], turn, force / self.a.mass, self.rates_slope(s[10:13], torque, speeds)]
            )

        start = np.concatenate([position, quaternion, velocity, rates])
        end = solve_ivp(slope, (0, duration), start, rtol=1e-10, atol=1e-12, method="DOP853").y[
            :, -1
        ]
        return end[:3], end[3:7] / np.linalg.norm(end[3:7]), end[7:10], end[10:13]
