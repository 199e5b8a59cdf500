"""SuperSuit: `black_death_v3`, `pettingzoo_env_to_vec_env_v1` and `concat_vec_envs_v1` together.

Drones leave early, and ends are mixed: see `swarm.py`. The copies of the
environment that `concat_vec_envs_v1` makes by cloudpickle fly in one process or in two.
"""

import numpy as np
import supersuit
from swarm import DRONES, make_env

WORLDS = 2
STEPS = 300


class Ends:
    """Counts, from the infos of one world, how its episodes end."""

    def __init__(self):
        self.episodes = self.early = self.mixed = 0
        self._last = {}

    def see(self, infos, done):
        """A step: infos of departed drones are empty; with `done` they are of the next episode."""
        if done:
            over = [info["success"] > 0 or info["collision"] > 0 for info in self._last.values()]
            self.episodes += 1
            self.early += len(over) < DRONES
            self.mixed += any(over) and not all(over)
        else:
            self._last = {i: info for i, info in enumerate(infos) if info}


def make(worlds=0, **options):
    """One world as a vector environment of its drones; `worlds` copies of it if not zero."""
    env = supersuit.black_death_v3(make_env())
    env = supersuit.pettingzoo_env_to_vec_env_v1(env)
    return supersuit.concat_vec_envs_v1(env, worlds, **options) if worlds else env


def fly(name, env, worlds):
    """Fly with random actions; what came of it, in words, with the ends that matter asserted."""
    slots = worlds * DRONES
    assert env.num_envs == slots, f"{name}: {env.num_envs} slots, not {slots}"
    env.reset()
    rng, counts = np.random.default_rng(0), [Ends() for _ in range(worlds)]
    for _ in range(STEPS):
        actions = rng.uniform(-1, 1, (slots, *env.action_space.shape)).astype(np.float32)
        observations, rewards, *ends, infos = env.step(actions)  # SB3 has one array of ends
        done = np.any(np.array(ends, dtype=bool), axis=0).reshape(worlds, DRONES)
        assert observations.shape == (slots, *env.observation_space.shape)
        assert np.isfinite(observations).all()
        assert np.isfinite(rewards).all()
        assert (done.all(axis=1) == done.any(axis=1)).all(), f"{name}: drones end one by one"
        for k, count in enumerate(counts):
            count.see(infos[k * DRONES : (k + 1) * DRONES], done[k].all())
    env.close()
    early, mixed = (sum(getattr(count, what) for count in counts) for what in ("early", "mixed"))
    assert early > 0, f"{name}: no drone left early"
    assert mixed > 0, f"{name}: no last step mixed terminations with truncations"
    return f"{name} {sum(count.episodes for count in counts)}/{early}/{mixed}"


def main():
    """Fly each variant."""
    results = [
        fly("alone", make(), 1),
        fly("gymnasium", make(WORLDS, num_cpus=0, base_class="gymnasium"), WORLDS),
        fly("stable_baselines3", make(WORLDS, num_cpus=0, base_class="stable_baselines3"), WORLDS),
        fly("two processes", make(WORLDS, num_cpus=2, base_class="gymnasium"), WORLDS),
    ]
    print(f"supersuit: episodes/with early leavers/with mixed ends: {', '.join(results)}")


if __name__ == "__main__":
    main()
