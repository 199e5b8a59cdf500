"""Measure the response of a Crazyflie to a lateral step of one metre, for each controller.

Prints the overshoot, and the time until the error stays below 5 %, for the controllers `lee` and
`pid`. The PID controller is tuned for motors without lag, so it flies without that effect.

Run it (it has no options):

    python examples/step_response.py

Takes 5 s, most of it for the start.
"""

import numpy as np

import bulletuav

DECISION_HZ = 60
START = np.array((0.0, 0.0, 2.0))  # m
STEP = np.array((1.0, 0.0, 0.0))  # m, to the east
EFFECTS = ("lag", "drag", "ground_effect", "downwash")
CONTROLLERS = {"lee": EFFECTS, "pid": EFFECTS[2:]}  # with their physical effects


def step_response(controller: str, effects: tuple[str, ...]) -> tuple[float, float]:
    """Fly the step.

    Args:
        controller: "lee" or "pid".
        effects: Physical effects to simulate in addition to rigid-body motion.

    Returns:
        The overshoot in percent, and the settling time until the error stays below 5 %, s.
    """
    aviary = bulletuav.Aviary(
        "hover",
        airframe="cf2x",
        action="target_position",
        controller=controller,
        effects=effects,
        start=(tuple(START),),
        decision_hz=DECISION_HZ,
        horizon=10 * DECISION_HZ,
    )
    aviary.reset(seeds=0)
    # Actions have the shape (worlds, drones, size of an action)
    action = aviary.action.encode((START + STEP).reshape(1, 1, 3))
    track = []
    while aviary.alive.any():
        aviary.step(action)
        track.append(aviary.swarm.position[0, 0, 0])
    aviary.close()

    error = np.array(track) - 1.0
    overshoot = 100 * max(0.0, error.max())
    last_outside = np.flatnonzero(np.abs(error) > 0.05)[-1]
    return overshoot, (last_outside + 1) / DECISION_HZ


def main() -> None:
    """Fly the step with each controller and print overshoot and settling time."""
    for controller, effects in CONTROLLERS.items():
        overshoot, settling = step_response(controller, effects)
        print(
            f"{controller}: overshoot {overshoot:.1f} %, settles in {settling:.2f} s "
            f"with {', '.join(effects)}"
        )


if __name__ == "__main__":
    main()
