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
        gravity=G,
    ):
        self.a, self.command, self.wind = (
            airframe,
            np.asarray(command, float),
            np.asarray(wind, float),
        )
        self.lag, self.drag, self.ground_effect, self.gravity = lag, drag, ground_effect, gravity
        self.x, self.y, self.turn = np.array(airframe.rotors).T
        self.J = np.diag(airframe.inertia)

    def speeds(self, initial, t):
        """Rotor speeds t seconds after the command, closed form."""
        tau = np.where(self.command > initial, self.a.lag_up, self.a.lag_down)
        if not self.lag or (tau == 0).all():
            return self.command
        return self.command + (initial - self.command) * np.exp(-t / tau)

    def wrench(self, position, quaternion, velocity, speeds):
        """Force (world) and torque (body)."""
        a, R = self.a, Rotation.from_quat(quaternion).as_matrix()
        thrusts = a.thrust_coefficient * speeds**2
        total = thrusts.sum()
        if self.ground_effect:
            R_p, k = a.propeller_radius, a.ground_effect_gain
            h = max(position[2], R_p * np.sqrt(15 * k / 4) / 4)
            total *= 1 + max(R[2, 2], 0) * k * (R_p / (4 * h)) ** 2
        force = total * R[:, 2] - np.array([0, 0, a.mass * self.gravity])
        if self.drag:
            D = np.diag([a.drag_xy, a.drag_xy, a.drag_z])
            force -= R @ D @ R.T @ (velocity - self.wind) * speeds.sum()
        yaw = a.thrust_coefficient * a.torque_ratio * speeds**2
        return force, np.array([self.y @ thrusts, -self.x @ thrusts, self.turn @ yaw])

    def rates_slope(self, rates, torque):
        return np.linalg.solve(self.J, torque - np.cross(rates, self.J @ rates))

    def solve(self, position, quaternion, velocity, rates, initial_speeds, duration):
        """(position, quaternion, velocity, rates) after `duration`, to 1e-10."""
        initial_speeds = np.asarray(initial_speeds, float)

        def slope(t, s):
            force, torque = self.wrench(
                s[:3], s[3:7] / np.linalg.norm(s[3:7]), s[7:10], self.speeds(initial_speeds, t)
            )
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
                [s[7:10], turn, force / self.a.mass, self.rates_slope(s[10:13], torque)]
            )

        start = np.concatenate([position, quaternion, velocity, rates])
        end = solve_ivp(slope, (0, duration), start, rtol=1e-10, atol=1e-12, method="DOP853").y[
            :, -1
        ]
        return end[:3], end[3:7] / np.linalg.norm(end[3:7]), end[7:10], end[10:13]

    def engine_scheme(self, position, quaternion, velocity, rates, initial_speeds, dt, steps):
        """Integrate by the declared scheme of `bullet`.

        That is semi-implicit Euler, rates by RK4 under a constant torque, R+ = R exp(dt w+).
        """
        p, v, w = (np.array(value, float) for value in (position, velocity, rates))
        R, n = Rotation.from_quat(quaternion), np.asarray(initial_speeds, float)
        for _ in range(steps):
            n = np.asarray(self.speeds(n, dt))
            force, torque = self.wrench(p, R.as_quat(), v, n)
            k1 = self.rates_slope(w, torque)
            k2 = self.rates_slope(w + dt / 2 * k1, torque)
            k3 = self.rates_slope(w + dt / 2 * k2, torque)
            k4 = self.rates_slope(w + dt * k3, torque)
            w = w + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            v = v + dt * force / self.a.mass
            p = p + dt * v
            R = R * Rotation.from_rotvec(dt * w)
        return p, R.as_quat(), v, w
