"""Gated recurrent unit of single precision: steps, and gradients through whole sequences.

The network has a dense layer with tanh, a gated recurrent unit (GRU) of the same width, and a dense
layer. Parameters and blocks of samples are those of `bulletuav.training.fast.dense`, whose sums
have a fixed order. Here each sample of a block is one drone, whose sequence is an episode.

References:
    K. Cho et al., Learning phrase representations using RNN encoder-decoder (2014); gates in the
    order and with the biases of PyTorch's `GRU`.
"""

from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.training.fast.dense import (
    BLOCK,
    ONE,
    ZERO,
    adam,
    add_gradient,
    apply_tanh,
    multiply_back,
    multiply_block,
    multiply_slope,
)

HALF, TWO = np.float32(0.5), np.float32(2.0)


class GruSizes(NamedTuple):
    """Widths of the network.

    Attributes:
        inputs: Number of inputs D.
        hidden: Width H of the first layer and of the hidden state.
        outputs: Number of outputs A.
    """

    inputs: int
    hidden: int
    outputs: int


class Steps(NamedTuple):
    """Values of the network at T steps of a block, float32.

    Attributes:
        inputs: (T, D, `BLOCK`) inputs.
        encoded: (T, H, `BLOCK`) outputs of the first layer.
        from_inputs: (3 H, `BLOCK`) work array: parts of the gates from the first layer.
        from_hidden: (T, 3 H, `BLOCK`) parts of the gates from the hidden state.
        gates: (T, 3 H, `BLOCK`) reset gate, update gate and candidate state.
        hidden: (T + 1, H, `BLOCK`) hidden states, before each step and after the last.
        outputs: (T, A, `BLOCK`) outputs.
    """

    inputs: np.ndarray
    encoded: np.ndarray
    from_inputs: np.ndarray
    from_hidden: np.ndarray
    gates: np.ndarray
    hidden: np.ndarray
    outputs: np.ndarray


class Changes(NamedTuple):
    """Work arrays of the gradients of one step, float32.

    Attributes:
        outputs: (A, `BLOCK`) gradients of the outputs.
        hidden: (H, `BLOCK`) gradients of the hidden state after the step.
        before: (H, `BLOCK`) gradients of the hidden state before the step.
        from_inputs: (3 H, `BLOCK`) gradients of the parts of the gates from the first layer.
        from_hidden: (3 H, `BLOCK`) gradients of the parts of the gates from the hidden state.
        encoded: (H, `BLOCK`) gradients of the outputs of the first layer.
        turned: (`BLOCK`, max(D, H)) work array of `add_gradient`.
    """

    outputs: np.ndarray
    hidden: np.ndarray
    before: np.ndarray
    from_inputs: np.ndarray
    from_hidden: np.ndarray
    encoded: np.ndarray
    turned: np.ndarray


def count_gru(sizes: GruSizes) -> int:
    """Return the number of parameters of the network."""
    return int(_start(sizes, 3) + (sizes.hidden + 1) * sizes.outputs)


def make_steps(sizes: GruSizes, length: int) -> Steps:
    """Allocate the values of T steps; the first hidden state is zero."""
    inputs, hidden, outputs = sizes
    shapes = (
        (length, inputs),
        (length, hidden),
        (3 * hidden,),
        (length, 3 * hidden),
        (length, 3 * hidden),
        (length + 1, hidden),
        (length, outputs),
    )
    return Steps(*(np.zeros((*shape, BLOCK), np.float32) for shape in shapes))


def make_changes(sizes: GruSizes) -> Changes:
    """Allocate the gradients of a step."""
    inputs, hidden, outputs = sizes
    rows = (outputs, hidden, hidden, 3 * hidden, 3 * hidden, hidden)
    shapes = (*((width, BLOCK) for width in rows), (BLOCK, max(inputs, hidden)))
    return Changes(*(np.zeros(shape, np.float32) for shape in shapes))


def gru_arrays(parameters: np.ndarray, sizes: GruSizes) -> dict[str, np.ndarray]:
    """Return views of the parameters by the names of PyTorch modules `encoder`, `gru`, `decoder`.

    Args:
        parameters: (P,) float32.
        sizes: Widths of the network.
    """
    inputs, hidden, outputs = sizes
    shapes = ((hidden, inputs), (3 * hidden, hidden), (3 * hidden, hidden), (outputs, hidden))
    names = (
        ("encoder.weight", "encoder.bias"),
        ("gru.weight_ih_l0", "gru.bias_ih_l0"),
        ("gru.weight_hh_l0", "gru.bias_hh_l0"),
        ("decoder.weight", "decoder.bias"),
    )
    found = {}
    for k, ((weight, bias), (rows, columns)) in enumerate(zip(names, shapes, strict=True)):
        start = _start(sizes, k)
        end = start + rows * columns
        found[weight] = parameters[start:end].reshape(rows, columns)
        found[bias] = parameters[end : end + rows]
    return found


@func
def _start(sizes: GruSizes, layer: int) -> int:
    """Return the index of the first parameter: 0 encoder, 1 and 2 of the gates, 3 decoder."""
    inputs, hidden, _ = sizes
    gates = (hidden + 1) * 3 * hidden
    return (inputs + 1) * hidden + (layer - 1) * gates if layer > 0 else 0


@func
def _step(parameters: np.ndarray, sizes: GruSizes, steps: Steps, t: int) -> None:
    """Compute step t of a block from its inputs and the hidden state before it."""
    inputs, width, outputs = sizes
    hidden, gates, parts = steps.hidden[t], steps.gates[t], steps.from_hidden[t]
    encoded, given = steps.encoded[t], steps.from_inputs
    multiply_block(parameters, 0, inputs, width, steps.inputs[t], encoded)
    apply_tanh(width, encoded)
    multiply_block(parameters, _start(sizes, 1), width, 3 * width, encoded, given)
    multiply_block(parameters, _start(sizes, 2), width, 3 * width, hidden, parts)
    # The logistic function of x is (1 + tanh(x / 2)) / 2
    for j in range(2 * width):
        for s in range(BLOCK):
            gates[j, s] = HALF * (given[j, s] + parts[j, s])
    apply_tanh(2 * width, gates)
    for j in range(2 * width):
        for s in range(BLOCK):
            gates[j, s] = HALF + HALF * gates[j, s]
    candidate = gates[2 * width :]
    for j in range(width):
        for s in range(BLOCK):
            candidate[j, s] = given[2 * width + j, s] + gates[j, s] * parts[2 * width + j, s]
    apply_tanh(width, candidate)
    after = steps.hidden[t + 1]
    for j in range(width):
        for s in range(BLOCK):
            update = gates[width + j, s]
            after[j, s] = (ONE - update) * candidate[j, s] + update * hidden[j, s]
    multiply_block(parameters, _start(sizes, 3), width, outputs, after, steps.outputs[t])


@func
def _step_back(
    parameters: np.ndarray,
    gradient: np.ndarray,
    sizes: GruSizes,
    steps: Steps,
    changes: Changes,
    t: int,
) -> None:
    """Add the gradients of step t, and replace those of the hidden state by those before it."""
    inputs, width, outputs = sizes
    hidden, gates, parts = steps.hidden[t], steps.gates[t], steps.from_hidden[t]
    dh, before, turned = changes.hidden, changes.before, changes.turned
    of_inputs, of_hidden = changes.from_inputs, changes.from_hidden
    last = _start(sizes, 3)
    add_gradient(gradient, last, width, outputs, steps.hidden[t + 1], changes.outputs, turned)
    multiply_back(parameters, last, width, outputs, changes.outputs, before)
    for j in range(width):
        for s in range(BLOCK):
            reset, update = gates[j, s], gates[width + j, s]
            candidate = gates[2 * width + j, s]
            d = dh[j, s] + before[j, s]
            to_candidate = d * (ONE - update) * (ONE - candidate * candidate)
            to_update = d * (hidden[j, s] - candidate) * update * (ONE - update)
            to_reset = to_candidate * parts[2 * width + j, s] * reset * (ONE - reset)
            of_inputs[j, s] = to_reset
            of_inputs[width + j, s] = to_update
            of_inputs[2 * width + j, s] = to_candidate
            of_hidden[j, s] = to_reset
            of_hidden[width + j, s] = to_update
            of_hidden[2 * width + j, s] = to_candidate * reset
            dh[j, s] = d * update
    first, second, encoded = _start(sizes, 1), _start(sizes, 2), changes.encoded
    add_gradient(gradient, second, width, 3 * width, hidden, of_hidden, turned)
    multiply_back(parameters, second, width, 3 * width, of_hidden, before)
    for j in range(width):
        for s in range(BLOCK):
            dh[j, s] += before[j, s]
    add_gradient(gradient, first, width, 3 * width, steps.encoded[t], of_inputs, turned)
    multiply_back(parameters, first, width, 3 * width, of_inputs, encoded)
    multiply_slope(width, steps.encoded[t], encoded)
    add_gradient(gradient, 0, inputs, width, steps.inputs[t], encoded, turned)


@kernel
def run_gru(
    parameters: np.ndarray,
    sizes: GruSizes,
    steps: Steps,
    rows: np.ndarray,
    hidden: np.ndarray,
    outputs: np.ndarray,
) -> None:
    """Compute one step of M drones.

    Args:
        parameters: (P,) float32.
        sizes: Widths of the network.
        steps: Values of one step, overwritten.
        rows: (M, D) inputs, float32.
        hidden: (M, H) hidden states, float32, changed.
        outputs: (M, A) outputs, float32, written.
    """
    for start in range(0, len(rows), BLOCK):
        count = min(BLOCK, len(rows) - start)
        for s in range(count):
            for k in range(sizes.inputs):
                steps.inputs[0, k, s] = rows[start + s, k]
            for k in range(sizes.hidden):
                steps.hidden[0, k, s] = hidden[start + s, k]
        _step(parameters, sizes, steps, 0)
        for s in range(count):
            for k in range(sizes.hidden):
                hidden[start + s, k] = steps.hidden[1, k, s]
            for k in range(sizes.outputs):
                outputs[start + s, k] = steps.outputs[0, k, s]


@kernel
def add_gru_gradient(
    parameters: np.ndarray,
    gradient: np.ndarray,
    sizes: GruSizes,
    steps: Steps,
    changes: Changes,
    rows: np.ndarray,
    labels: np.ndarray,
    lengths: np.ndarray,
    chosen: np.ndarray,
) -> float:
    """Add the gradient of the mean squared error of outputs over the steps of some sequences.

    Args:
        parameters: (P,) float32.
        gradient: (P,) float32, added to.
        sizes: Widths of the network.
        steps: Values of T steps, overwritten except the first hidden state, which is zero.
        changes: Work arrays.
        rows: (S, T, D) inputs of S sequences, float32.
        labels: (S, T, A) desired outputs, float32.
        lengths: (S,) number of steps of each sequence.
        chosen: (B,) indices of sequences, B a multiple of `BLOCK`.

    Returns:
        The mean squared error.
    """
    count = 0
    for k in chosen:
        count += lengths[k]
    scale = np.float32(1.0 / max(count * sizes.outputs, 1))
    total = 0.0
    for start in range(0, len(chosen), BLOCK):
        longest = 0
        for s in range(BLOCK):
            longest = max(longest, lengths[chosen[start + s]])
        for t in range(longest):
            for s in range(BLOCK):
                for k in range(sizes.inputs):
                    steps.inputs[t, k, s] = rows[chosen[start + s], t, k]
            _step(parameters, sizes, steps, t)
        for k in range(sizes.hidden):
            for s in range(BLOCK):
                changes.hidden[k, s] = ZERO
        for t in range(longest - 1, -1, -1):
            for s in range(BLOCK):
                k = chosen[start + s]
                for j in range(sizes.outputs):
                    error = steps.outputs[t, j, s] - labels[k, t, j]
                    error = error if t < lengths[k] else ZERO
                    changes.outputs[j, s] = TWO * scale * error
                    total += np.float64(error * error)
            _step_back(parameters, gradient, sizes, steps, changes, t)
    return float(total * scale)


@kernel
def step_adam(
    parameters: np.ndarray,
    gradient: np.ndarray,
    moments: np.ndarray,
    step: int,
    rate: float,
    max_norm: float,
) -> None:
    """Make a step of Adam, and set the gradient to zero.

    Args:
        parameters: (P,) float32, changed.
        gradient: (P,) float32, set to zero.
        moments: (2, P) float32, running means of the gradients and of their squares, changed.
        step: Number of this step, from 1.
        rate: Learning rate.
        max_norm: Maximum norm of the gradient.
    """
    adam(parameters, gradient, moments[0], moments[1], step, rate, max_norm)
    gradient[:] = ZERO
