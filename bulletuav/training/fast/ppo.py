"""PPO of single precision: choice of actions, advantages, and updates.

J. Schulman, F. Wolski, P. Dhariwal, A. Radford, O. Klimov, Proximal policy optimization algorithms
(2017), with the details of stable-baselines3. Rewards that are NaN mark absent drones.
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.functions import exp, log, moderate_exp
from bulletuav.compiled.kernel import func, kernel
from bulletuav.training.fast.dense import BLOCK, ZERO, adam, backward, forward
from bulletuav.training.fast.sets import (
    Sets,
    SetsWork,
    add_features_gradient,
    compute_features,
)

HALF_LOG_2_PI = 0.5 * math.log(2.0 * math.pi)
MAX_EXPONENT = 20.0
"""Bound of the logarithm of probability ratios"""
TINY_DEVIATION = 1e-8
"""Added to the standard deviation of advantages, as in stable-baselines3"""
INVALID = np.float32(-1e8)
"""Log probability of masked choices, as in sb3-contrib; its exponential is 0"""


class Networks(NamedTuple):
    """Networks in one array of parameters.

    The last parameters are the log standard deviations of continuous actions.

    Attributes:
        sets: Layout of the features.
        set_starts: (G,) index of the first parameter of the network of each kind of entity.
        set_widths: (G, 3) their widths.
        actor_start: Index of the first parameter of the actor.
        actor: (layers + 1,) widths of the actor.
        critic_start: Index of the first parameter of the critic.
        critic: (layers + 1,) widths of the critic, whose inputs are the features, and then the
            state if it is a central critic.
        choices: Number of discrete choices, for which the actor computes logits; 0 for continuous
            actions, of which it computes the means.
    """

    sets: Sets
    set_starts: np.ndarray
    set_widths: np.ndarray
    actor_start: int
    actor: np.ndarray
    critic_start: int
    critic: np.ndarray
    choices: int


class Work(NamedTuple):
    """Work arrays: activations and gradients of a block of samples, see `dense` and `sets`."""

    sets: SetsWork
    actor: np.ndarray
    actor_changes: np.ndarray
    critic: np.ndarray
    critic_changes: np.ndarray
    turned: np.ndarray
    chosen: np.ndarray


class Rollout(NamedTuple):
    """Arrays of T decisions of M slots in W worlds.

    Attributes:
        encoded: (T + 1, M, E) float32, encoded observations.
        states: (T + 1, W, K) float32, compressed states for a central critic; K = 0 without one.
        actions: (T, M, A) float32, not clipped; or (T, M, 1) choices.
        masks: (T, M, C) bool, valid choices; C = 0 without masks.
        log_densities: (T, M) float32, log probability densities of the actions.
        values: (T + 1, M) float32, estimates of the critic.
        rewards: (T, M) float32, NaN for absent drones.
        done: (T, M) float32, 1 where the decision ended the episode of the slot.
        advantages: (T, M) float32.
        returns: (T, M) float32.
    """

    encoded: np.ndarray
    states: np.ndarray
    actions: np.ndarray
    masks: np.ndarray
    log_densities: np.ndarray
    values: np.ndarray
    rewards: np.ndarray
    done: np.ndarray
    advantages: np.ndarray
    returns: np.ndarray


class Losses(NamedTuple):
    """Constants of the loss.

    Attributes:
        clip: Clip range of probability ratios.
        entropy: Factor of the entropy.
        value: Factor of the squared error of the critic.
        max_norm: Maximum norm of the gradient.
    """

    clip: float
    entropy: float
    value: float
    max_norm: float


@func
def _run_block(
    parameters: np.ndarray, networks: Networks, work: Work, encoded: np.ndarray, states: np.ndarray
) -> None:
    """Compute actor and critic for the rows `work.chosen` of encoded observations.

    Args:
        parameters: (P,) float32.
        networks: The networks.
        work: Work arrays, written.
        encoded: (M, E) rows.
        states: (W, K) states, each of M / W consecutive rows.
    """
    features, inputs = work.actor[0], work.critic[0]
    compute_features(
        parameters,
        networks.sets,
        networks.set_starts,
        networks.set_widths,
        encoded,
        work.chosen,
        work.sets,
        features,
    )
    seen, drones = networks.actor[0], encoded.shape[0] // states.shape[0]
    for k in range(seen):
        for s in range(BLOCK):
            inputs[k, s] = features[k, s]
    if states.shape[1] > 0:
        for s in range(BLOCK):
            state = states[work.chosen[s] // drones]
            for k in range(states.shape[1]):
                inputs[seen + k, s] = state[k]
    forward(parameters, networks.actor_start, networks.actor, work.actor, False)
    forward(parameters, networks.critic_start, networks.critic, work.critic, False)


@kernel
def run_networks(
    parameters: np.ndarray,
    networks: Networks,
    work: Work,
    encoded: np.ndarray,
    states: np.ndarray,
    means: np.ndarray,
    values: np.ndarray,
) -> None:
    """Compute actor and critic for encoded observations.

    Args:
        parameters: (P,) float32.
        networks: The networks.
        work: Work arrays.
        encoded: (M, E) rows.
        states: (W, K) states, each of M / W consecutive rows.
        means: (M, A) means of the actions, or (M, C) logits of the choices, written.
        values: (M,) values, written.
    """
    count = encoded.shape[0]
    actor_last, critic_last = len(networks.actor) - 1, len(networks.critic) - 1
    for first in range(0, count, BLOCK):
        for s in range(BLOCK):
            work.chosen[s] = min(first + s, count - 1)
        _run_block(parameters, networks, work, encoded, states)
        for s in range(min(BLOCK, count - first)):
            for a in range(means.shape[1]):
                means[first + s, a] = work.actor[actor_last, a, s]
            values[first + s] = work.critic[critic_last, 0, s]


@kernel
def sample_actions(
    parameters: np.ndarray, noise: np.ndarray, actions: np.ndarray, log_densities: np.ndarray
) -> None:
    """Add noise to the means of actions.

    Args:
        parameters: (P,) of the networks.
        noise: (M, A) standard normal numbers.
        actions: (M, A) means, replaced by actions.
        log_densities: (M,) log probability densities, written.
    """
    size = actions.shape[1]
    first = len(parameters) - size
    for m in range(actions.shape[0]):
        total = 0.0
        for a in range(size):
            log_std = float(parameters[first + a])
            number = float(noise[m, a])
            actions[m, a] = actions[m, a] + exp(log_std) * number
            total -= 0.5 * number * number + log_std + HALF_LOG_2_PI
        log_densities[m] = total


@func
def _log_softmax(logits: np.ndarray, valid: np.ndarray) -> None:
    """Replace logits (C,) by log probabilities.

    Args:
        logits: (C,) float32, replaced; those of masked choices by `INVALID`.
        valid: (C,) bool, at least one of which is True; or (0,) without masks.
    """
    is_masked = len(valid) > 0
    most = -np.inf
    for a in range(len(logits)):
        if is_masked and not valid[a]:
            logits[a] = INVALID
        most = max(most, float(logits[a]))
    total = 0.0
    for a in range(len(logits)):
        total += exp(float(logits[a]) - most)
    shift = most + log(total)
    for a in range(len(logits)):
        is_valid = not is_masked or valid[a]
        logits[a] = np.float32(float(logits[a]) - shift) if is_valid else INVALID


@kernel
def sample_choices(
    uniform: np.ndarray,
    logits: np.ndarray,
    masks: np.ndarray,
    actions: np.ndarray,
    log_densities: np.ndarray,
) -> None:
    """Draw choices from the categorical distributions of logits.

    Args:
        uniform: (M,) uniform random numbers from 0 to 1.
        logits: (M, C) float32, replaced by log probabilities.
        masks: (M, C) bool, valid choices; (M, 0) without masks.
        actions: (M, 1) float32 choices, written.
        log_densities: (M,) log probabilities of the choices, written.
    """
    for m in range(logits.shape[0]):
        row, total, choice = logits[m], 0.0, 0
        _log_softmax(row, masks[m])
        for a in range(len(row)):
            probability = exp(float(row[a]))
            # Rounding can leave a sum below 1: the last possible choice then is the choice
            if probability > 0.0 and (total <= uniform[m]):
                choice = a
            total += probability
        actions[m, 0] = choice
        log_densities[m] = row[choice]


@kernel
def compute_advantages(rollout: Rollout, gamma: float, decay: float) -> None:
    """Compute generalised advantage estimates and returns.

    J. Schulman, P. Moritz, S. Levine, M. Jordan, P. Abbeel, High-dimensional continuous control
    using generalized advantage estimation (2016), equation 16.

    Args:
        rollout: Advantages and returns are written.
        gamma: Discount factor.
        decay: Factor lambda.
    """
    decisions, slots = rollout.rewards.shape
    for m in range(slots):
        after = 0.0
        for t in range(decisions - 1, -1, -1):
            reward = rollout.rewards[t, m]
            if np.isnan(reward):
                after = 0.0
                rollout.advantages[t, m] = ZERO
                rollout.returns[t, m] = ZERO
                continue
            goes_on = 1.0 - rollout.done[t, m]
            value = float(rollout.values[t, m])
            error = reward + gamma * goes_on * rollout.values[t + 1, m] - value
            after = error + gamma * decay * goes_on * after
            rollout.advantages[t, m] = after
            rollout.returns[t, m] = after + value


@kernel
def compute_gradient(
    parameters: np.ndarray,
    gradient: np.ndarray,
    networks: Networks,
    work: Work,
    rollout: Rollout,
    chosen: np.ndarray,
    losses: Losses,
    found: np.ndarray,
) -> None:
    """Compute the gradient of the loss of a minibatch.

    Args:
        parameters: (P,) float32.
        gradient: (P,) written.
        networks: The networks.
        work: Work arrays.
        rollout: The rollout.
        chosen: (B,) indices t M + m of the samples.
        losses: Constants of the loss.
        found: (5,) losses of the policy, of the critic and of the entropy, fraction of clipped
            ratios, and approximate Kullback-Leibler divergence, added to.
    """
    choices = networks.choices
    # Number of standard deviations
    slots, size = rollout.rewards.shape[1], 0 if choices > 0 else rollout.actions.shape[2]
    encoded = rollout.encoded.reshape(-1, rollout.encoded.shape[2])
    worlds = rollout.states.shape[1]
    states = rollout.states.reshape(len(rollout.states) * worlds, rollout.states.shape[2])
    count, clip = len(chosen), losses.clip
    first_std = len(parameters) - size
    sets, starts, widths = networks.sets, networks.set_starts, networks.set_widths
    actor_last, critic_last = len(networks.actor) - 1, len(networks.critic) - 1
    for k in range(len(gradient)):
        gradient[k] = ZERO
    for a in range(size):
        gradient[first_std + a] = -losses.entropy
    # Advantages have mean 0 and standard deviation 1 in each minibatch
    mean, square = 0.0, 0.0
    for c in range(count):
        mean += float(rollout.advantages[chosen[c] // slots, chosen[c] % slots]) / count
    for c in range(count):
        away = rollout.advantages[chosen[c] // slots, chosen[c] % slots] - mean
        square += away * away / max(count - 1, 1)
    spread = 1.0 / (math.sqrt(square) + TINY_DEVIATION) if count > 1 else 1.0
    mean = mean if count > 1 else 0.0
    normal = 0.0
    for a in range(size):
        normal += float(parameters[first_std + a]) + HALF_LOG_2_PI
    for first in range(0, count, BLOCK):
        used = min(BLOCK, count - first)
        for s in range(BLOCK):
            work.chosen[s] = chosen[first + min(s, used - 1)]
        _run_block(parameters, networks, work, encoded, states)
        means, values = work.actor[actor_last], work.critic[critic_last]
        of_means, of_values = work.actor_changes[actor_last], work.critic_changes[critic_last]
        for s in range(BLOCK):
            t, m = work.chosen[s] // slots, work.chosen[s] % slots
            log_density, entropy, choice = -normal, normal + 0.5 * size, 0
            if choices > 0:
                _log_softmax(means[:choices, s], rollout.masks[t, m])
                choice = int(rollout.actions[t, m, 0])
                log_density = float(means[choice, s])
                for a in range(choices):
                    probability = exp(float(means[a, s]))
                    of_means[a, s] = probability
                    entropy -= probability * means[a, s]
            for a in range(size):
                inverse = exp(-float(parameters[first_std + a]))
                away = (float(rollout.actions[t, m, a]) - means[a, s]) * inverse
                log_density -= 0.5 * away * away
            difference = log_density - rollout.log_densities[t, m]
            ratio = moderate_exp(min(max(difference, -MAX_EXPONENT), MAX_EXPONENT))
            advantage = (rollout.advantages[t, m] - mean) * spread
            error = float(values[0, s]) - rollout.returns[t, m]
            # The last block repeats its last sample, without weight
            weight = 1.0 / count if s < used else 0.0
            # The derivative is 0 where the clipped ratio is the minimum
            is_free = ratio < 1.0 + clip if advantage > 0.0 else ratio > 1.0 - clip
            pull = -advantage * ratio * weight if is_free else 0.0
            for a in range(size):
                inverse = exp(-float(parameters[first_std + a]))
                away = (float(rollout.actions[t, m, a]) - means[a, s]) * inverse
                of_means[a, s] = pull * away * inverse
                gradient[first_std + a] += np.float32(pull * (away * away - 1.0))
            for a in range(choices):
                probability = float(of_means[a, s])
                spread_out = losses.entropy * weight * probability * (means[a, s] + entropy)
                taken = 1.0 if a == choice else 0.0
                of_means[a, s] = pull * (taken - probability) + spread_out
            of_values[0, s] = 2.0 * losses.value * error * weight
            clipped = min(max(ratio, 1.0 - clip), 1.0 + clip)
            found[0] -= min(ratio * advantage, clipped * advantage) * weight
            found[1] += error * error * weight
            found[2] -= entropy * weight
            found[3] += weight if clipped != ratio else 0.0
            found[4] += (ratio - 1.0 - difference) * weight
        has_sets = sets.kinds.shape[0] > 0
        backward(
            parameters,
            gradient,
            networks.actor_start,
            networks.actor,
            work.actor,
            work.actor_changes,
            work.turned,
            False,
            has_sets,
        )
        backward(
            parameters,
            gradient,
            networks.critic_start,
            networks.critic,
            work.critic,
            work.critic_changes,
            work.turned,
            False,
            has_sets,
        )
        if has_sets:
            of_features = work.actor_changes[0]
            for k in range(len(sets.own), networks.actor[0]):
                for s in range(BLOCK):
                    of_features[k, s] += work.critic_changes[0, k, s]
            add_features_gradient(
                parameters, gradient, sets, starts, widths, work.sets, of_features
            )


@kernel
def update_networks(
    parameters: np.ndarray,
    gradient: np.ndarray,
    moments: np.ndarray,
    networks: Networks,
    work: Work,
    rollout: Rollout,
    order: np.ndarray,
    ends: np.ndarray,
    step: int,
    rate: float,
    losses: Losses,
    found: np.ndarray,
) -> None:
    """Make a step of Adam for each minibatch.

    Args:
        parameters: (P,) float32, changed.
        gradient: (P,) work array.
        moments: (2, P) running means of Adam, changed.
        networks: The networks.
        work: Work arrays.
        rollout: The rollout, with advantages and returns.
        order: Indices t M + m of the samples of all minibatches.
        ends: (minibatches + 1,) bounds of the minibatches in `order`.
        step: Number of steps of Adam before.
        rate: Learning rate.
        losses: Constants of the loss.
        found: (5,) sums over minibatches, see `compute_gradient`.
    """
    for b in range(len(ends) - 1):
        chosen = order[ends[b] : ends[b + 1]]
        compute_gradient(parameters, gradient, networks, work, rollout, chosen, losses, found)
        moment, square = moments[0], moments[1]
        adam(parameters, gradient, moment, square, step + b + 1, rate, losses.max_norm)
