"""Actions that include a message to other drones."""

import dataclasses

import numpy as np

from bulletuav.control.actions.base import Action
from bulletuav.errors import shown

MAX_CHOICES = 10_000
"""Maximum number of discrete actions with a message"""


def add_message(action: Action, size: int, tokens: int | None) -> Action:
    """Add a message to the numbers of each drone.

    Continuous actions have `size` further numbers from -1 to 1 after their own. A discrete action
    is a choice of a move and tokens together, C `tokens`^`size` choices: the move is the quotient
    of the choice and `tokens`^`size`, and the tokens are the digits of the remainder in base
    `tokens`, the most significant one first.

    Args:
        action: The action without a message.
        size: Number of numbers, or of tokens, in a message.
        tokens: Number of different tokens; None for continuous messages.

    Returns:
        The action with a message.

    Raises:
        ValueError: If the action is discrete and the message is not or has too many values, or
            drones differ in their number of numbers.
    """
    if action.choices is not None:
        return _add_tokens(action, size, tokens)
    counts = sorted({action.size(drone) for drone in range(len(action.labels))})
    if len(counts) > 1:
        raise ValueError(
            f"communication needs drones with the same number of numbers in an action, and they "
            f"have {shown(counts)}: choose another action, or leave communication out"
        )
    labels = tuple(f"message {k + 1}" for k in range(size))
    ones = np.ones((len(action.labels), size))
    encode = action.encode

    def encode_silent(vector: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        assert encode is not None
        numbers = encode(vector, commanded)
        return np.concatenate([numbers, np.zeros((*numbers.shape[:2], size))], axis=-1)

    return dataclasses.replace(
        action,
        labels=tuple((*own, *labels) for own in action.labels),
        low=np.concatenate([action.low, -ones], axis=1),
        high=np.concatenate([action.high, ones], axis=1),
        encode=None if encode is None else encode_silent,
    )


def _add_tokens(action: Action, size: int, tokens: int | None) -> Action:
    """Return a discrete action of a move and tokens; see `add_message`."""
    if tokens is None:
        raise ValueError(
            f"communication has continuous messages, and action {action.name!r} is discrete: give "
            f"communication tokens, such as 4, or choose a continuous action"
        )
    moves, messages = action.choices or 0, tokens**size
    if moves * messages > MAX_CHOICES:
        raise ValueError(
            f"communication has {tokens}^{size} different messages: with {moves} moves at most "
            f"{MAX_CHOICES} choices are possible; lower its size or tokens"
        )

    def decode(choice: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        return action.decode(np.floor_divide(choice, messages), commanded)

    label = f"move {messages} + message, of {moves} moves and {messages} messages"
    return dataclasses.replace(
        action,
        labels=((label,),) * len(action.labels),
        high=np.full_like(action.high, moves * messages - 1),
        decode=decode,
        choices=moves * messages,
    )


def read_message(
    actions: np.ndarray, size: int, tokens: int | None, is_discrete: bool
) -> np.ndarray:
    """Return the messages in actions of `add_message`.

    Args:
        actions: (..., A) actions.
        size: Number of numbers, or of tokens, in a message.
        tokens: Number of different tokens; None for continuous messages.
        is_discrete: Whether the actions are choices.

    Returns:
        (..., size) numbers from -1 to 1, or indices of tokens. Numbers are rounded to the nearest
        of as many evenly spaced values as there are tokens.
    """
    if is_discrete:
        assert tokens is not None
        weights = tokens ** np.arange(size - 1, -1, -1)
        digits: np.ndarray = np.floor_divide(actions[..., :1], weights) % tokens
        return digits
    numbers = actions[..., -size:]
    if tokens is None:
        return numbers
    nearest: np.ndarray = np.rint((numbers + 1) / 2 * (tokens - 1))
    return nearest
