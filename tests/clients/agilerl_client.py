"""Train IPPO of AgileRL in the parallel environment."""

import torch
from agilerl.algorithms import IPPO
from agilerl.training.train_multi_agent_on_policy import train_multi_agent_on_policy
from agilerl.vector import PzDummyVecEnv
from library import make_env, report

STEPS = 512


def collect():
    """Return a function that flies a decision by the vector environment of one world."""
    env = PzDummyVecEnv(make_env())
    env.reset()
    actions = {agent: env.action_space(agent).sample() for agent in env.agents}
    return lambda: env.step(actions)


def train():
    """Train, and return the number of decisions."""
    env = PzDummyVecEnv(make_env())
    agents = list(env.agents)
    learner = IPPO(
        [env.single_observation_space(agent) for agent in agents],
        [env.single_action_space(agent) for agent in agents],
        agent_ids=agents,
        learn_step=128,
        batch_size=64,
        net_config={"encoder_config": {"hidden_size": [64]}},
    )
    before = {name: part.clone() for name, part in learner.actors.state_dict().items()}
    (learner,), _ = train_multi_agent_on_policy(
        env, "crossing", "IPPO", [learner], max_steps=STEPS, evo_steps=STEPS, verbose=False
    )
    after = learner.actors.state_dict()
    assert any(not torch.equal(before[name], after[name]) for name in before)
    return STEPS * len(agents)


if __name__ == "__main__":
    report(["agilerl", "torch"], "IPPO, parallel environment", [make_env], 1, collect, train)
