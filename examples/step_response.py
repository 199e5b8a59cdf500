"""A Crazyflie steps one metre to the side under each controller; prints overshoot and settling time."""

import numpy as np

import bulletuav


def step_response(controller: str, effects: tuple[str, ...]) -> tuple[float, float]:
    """Overshoot in percent and seconds until the error stays below 5 %."""
    start = np.array((0.0, 0.0, 2.0))
    aviary = bulletuav.Aviary(
        "hover",
        airframe="cf2x",
        action="target_position",
        controller=controller,
        effects=effects,
        start=(tuple(start),),
        decision_hz=60,
        horizon=600,
    )
    aviary.reset(seeds=0)
    action = aviary.action.encode((start + np.array((1.0, 0.0, 0.0))).reshape(1, 1, 3))
    track = []
    while aviary.alive.any():
        aviary.step(action)
        track.append(aviary.swarm.position[0, 0, 0])
    aviary.close()
    error = np.array(track) - 1.0
    return 100 * max(0.0, error.max()), (np.flatnonzero(np.abs(error) > 0.05)[-1] + 1) / 60


if __name__ == "__main__":
    all_effects = ("lag", "drag", "ground_effect", "downwash")
    for controller, effects in (("lee", all_effects), ("pid", all_effects[1:])):
        overshoot, settling = step_response(controller, effects)
        print(
            f"{controller}: overshoot {overshoot:.1f} %, settles in {settling:.2f} s with {', '.join(effects)}"
        )
