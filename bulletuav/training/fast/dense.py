"""Dense networks of single precision: forward and backward passes, and the optimizer Adam.

A network is a range of one array of parameters. Its layers follow each other, each as a weight
matrix (outputs, inputs) in C order and the biases (outputs,). Activations are arrays (units,
`BLOCK`) of a block of samples. Loops run over the samples of a block, which are independent, and
sums over units or samples run in a fixed order. The compiler therefore vectorises the loops without
any reordering, and results have the same bits for all widths of vectors.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import func, kernel

BLOCK = 64
"""Number of samples in a block"""
UNROLLED = 4
"""Number of terms that one pass over a block adds to a sum"""
BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-5
"""Constants of Adam; those of stable-baselines3's PPO"""
ZERO, ONE = np.float32(0.0), np.float32(1.0)
# Rational approximation of tanh; beyond the limit it rounds to 1. Coefficients of Eigen
TANH_LIMIT = np.float32(7.90531110763549805)
P1, P3, P5 = map(np.float32, (4.89352455891786e-03, 6.37261928875436e-04, 1.48572235717979e-05))
P7, P9 = map(np.float32, (5.12229709037114e-08, -8.60467152213735e-11))
P11, P13 = map(np.float32, (2.00018790482477e-13, -2.76076847742355e-16))
Q0, Q2 = map(np.float32, (4.89352518554385e-03, 2.26843463243900e-03))
Q4, Q6 = map(np.float32, (1.18534705686654e-04, 1.19825839466702e-06))


def count_parameters(widths: np.ndarray) -> int:
    """Return the number of parameters of a network.

    Args:
        widths: (layers + 1,) number of inputs, and of outputs of each layer.
    """
    return int(((widths[:-1] + 1) * widths[1:]).sum())


def draw_orthogonal(rng: np.random.Generator, outputs: int, inputs: int, gain: float) -> np.ndarray:
    """Draw an orthogonal matrix, by Gram-Schmidt with a fixed order of summation.

    Args:
        rng: Random generator.
        outputs: Number of rows.
        inputs: Number of columns.
        gain: Factor of the orthonormal rows, or columns if these are fewer.

    Returns:
        (outputs, inputs) float32.
    """
    size, length = sorted((outputs, inputs))
    rows = rng.standard_normal((size, length))
    orthonormalise(rows)
    matrix = rows if outputs <= inputs else rows.T
    return (gain * matrix).astype(np.float32)


@kernel
def orthonormalise(rows: np.ndarray) -> None:
    """Make rows (n, length >= n) orthonormal, by the modified Gram-Schmidt method."""
    count, length = rows.shape
    for i in range(count):
        for j in range(i):
            along = 0.0
            for k in range(length):
                along += rows[i, k] * rows[j, k]
            for k in range(length):
                rows[i, k] -= along * rows[j, k]
        square = 0.0
        for k in range(length):
            square += rows[i, k] * rows[i, k]
        for k in range(length):
            rows[i, k] /= math.sqrt(square)


@func
def multiply_block(
    parameters: np.ndarray, start: int, inputs: int, outputs: int, x: np.ndarray, y: np.ndarray
) -> None:
    """Write W x + b to y.

    Args:
        parameters: (P,) float32.
        start: Index of the first weight of the layer.
        inputs: Number of inputs.
        outputs: Number of outputs.
        x: (>= inputs, `BLOCK`) float32.
        y: (>= outputs, `BLOCK`) float32, written.
    """
    for j in range(outputs):
        row = start + j * inputs
        bias = parameters[start + outputs * inputs + j]
        for s in range(BLOCK):
            y[j, s] = bias
        k = 0
        while k + UNROLLED <= inputs:
            w0, w1 = parameters[row + k], parameters[row + k + 1]
            w2, w3 = parameters[row + k + 2], parameters[row + k + 3]
            for s in range(BLOCK):
                one = y[j, s] + w0 * x[k, s] + w1 * x[k + 1, s]
                y[j, s] = one + w2 * x[k + 2, s] + w3 * x[k + 3, s]
            k += UNROLLED
        while k < inputs:
            w0 = parameters[row + k]
            for s in range(BLOCK):
                y[j, s] += w0 * x[k, s]
            k += 1


@func
def multiply_back(
    parameters: np.ndarray, start: int, inputs: int, outputs: int, dy: np.ndarray, dx: np.ndarray
) -> None:
    """Write the gradient of the inputs of a layer, transpose(W) dy, to dx.

    Args:
        parameters: (P,) float32.
        start: Index of the first weight of the layer.
        inputs: Number of inputs.
        outputs: Number of outputs.
        dy: (>= outputs, `BLOCK`) gradients of the outputs.
        dx: (>= inputs, `BLOCK`) written.
    """
    for k in range(inputs):
        for s in range(BLOCK):
            dx[k, s] = ZERO
        j = 0
        while j + UNROLLED <= outputs:
            place = start + j * inputs + k
            w0, w1 = parameters[place], parameters[place + inputs]
            w2, w3 = parameters[place + 2 * inputs], parameters[place + 3 * inputs]
            for s in range(BLOCK):
                one = dx[k, s] + w0 * dy[j, s] + w1 * dy[j + 1, s]
                dx[k, s] = one + w2 * dy[j + 2, s] + w3 * dy[j + 3, s]
            j += UNROLLED
        while j < outputs:
            w0 = parameters[start + j * inputs + k]
            for s in range(BLOCK):
                dx[k, s] += w0 * dy[j, s]
            j += 1


@func
def add_gradient(
    gradient: np.ndarray,
    start: int,
    inputs: int,
    outputs: int,
    x: np.ndarray,
    dy: np.ndarray,
    turned: np.ndarray,
) -> None:
    """Add the gradient of the weights and biases of a layer, a sum over samples in their order.

    Args:
        gradient: (P,) gradients, added to.
        start: Index of the first weight of the layer.
        inputs: Number of inputs.
        outputs: Number of outputs.
        x: (>= inputs, `BLOCK`) inputs.
        dy: (>= outputs, `BLOCK`) gradients of the outputs.
        turned: (`BLOCK`, >= inputs) work array for the inputs of each sample.
    """
    # Sums over samples are loops over inputs, which are independent
    for k in range(inputs):
        for s in range(BLOCK):
            turned[s, k] = x[k, s]
    for j in range(outputs):
        row, total = gradient[start + j * inputs : start + (j + 1) * inputs], ZERO
        # Eight samples in a pass, which reads and writes each sum once
        for s in range(0, BLOCK, 8):
            d0, d1, d2, d3 = dy[j, s], dy[j, s + 1], dy[j, s + 2], dy[j, s + 3]
            d4, d5, d6, d7 = dy[j, s + 4], dy[j, s + 5], dy[j, s + 6], dy[j, s + 7]
            total += ((d0 + d1) + (d2 + d3)) + ((d4 + d5) + (d6 + d7))
            for k in range(inputs):
                one = row[k] + d0 * turned[s, k] + d1 * turned[s + 1, k]
                one = one + d2 * turned[s + 2, k] + d3 * turned[s + 3, k]
                one = one + d4 * turned[s + 4, k] + d5 * turned[s + 5, k]
                row[k] = one + d6 * turned[s + 6, k] + d7 * turned[s + 7, k]
        gradient[start + outputs * inputs + j] += total


@func
def apply_tanh(units: int, y: np.ndarray) -> None:
    """Apply tanh to the first units of y (>= units, `BLOCK`); the error is below 4e-7."""
    for j in range(units):
        for s in range(BLOCK):
            x = y[j, s]
            x = x if x < TANH_LIMIT else TANH_LIMIT
            x = x if x > -TANH_LIMIT else -TANH_LIMIT
            q = x * x
            odd = P1 + q * (P3 + q * (P5 + q * (P7 + q * (P9 + q * (P11 + q * P13)))))
            y[j, s] = x * odd / (Q0 + q * (Q2 + q * (Q4 + q * Q6)))


@func
def multiply_slope(units: int, y: np.ndarray, dy: np.ndarray) -> None:
    """Multiply the gradients dy of y = tanh(z) by its derivative 1 - y^2."""
    for j in range(units):
        for s in range(BLOCK):
            dy[j, s] *= ONE - y[j, s] * y[j, s]


@func
def apply_relu(units: int, y: np.ndarray) -> None:
    """Apply max(y, 0) to the first units of y (>= units, `BLOCK`)."""
    for j in range(units):
        for s in range(BLOCK):
            y[j, s] = y[j, s] if y[j, s] > ZERO else ZERO


@func
def mask_slope(units: int, y: np.ndarray, dy: np.ndarray) -> None:
    """Set the gradients dy of y = max(z, 0) to 0 where y is 0."""
    for j in range(units):
        for s in range(BLOCK):
            dy[j, s] = dy[j, s] if y[j, s] > ZERO else ZERO


@func
def forward(
    parameters: np.ndarray, start: int, widths: np.ndarray, values: np.ndarray, rectified: bool
) -> None:
    """Compute the layers of a network.

    Args:
        parameters: (P,) float32.
        start: Index of the first parameter of the network.
        widths: (layers + 1,) number of inputs, and of outputs of each layer.
        values: (layers + 1, max width, `BLOCK`) inputs, and outputs of each layer, written.
        rectified: If True, each layer ends with max(y, 0), otherwise each but the last with tanh.
    """
    last = len(widths) - 2
    for k in range(last + 1):
        inputs, outputs = widths[k], widths[k + 1]
        multiply_block(parameters, start, inputs, outputs, values[k], values[k + 1])
        if rectified:
            apply_relu(outputs, values[k + 1])
        elif k < last:
            apply_tanh(outputs, values[k + 1])
        start += (inputs + 1) * outputs


@func
def backward(
    parameters: np.ndarray,
    gradient: np.ndarray,
    start: int,
    widths: np.ndarray,
    values: np.ndarray,
    changes: np.ndarray,
    turned: np.ndarray,
    rectified: bool,
    to_inputs: bool,
) -> None:
    """Add the gradients of the parameters of a network, from those of its outputs.

    Args:
        parameters: (P,) float32.
        gradient: (P,) gradients of the parameters, added to.
        start: Index of the first parameter of the network.
        widths: (layers + 1,) number of inputs, and of outputs of each layer.
        values: (layers + 1, max width, `BLOCK`) of `forward`.
        changes: (layers + 1, max width, `BLOCK`) gradients of `values`: those of the outputs are
            read, and the others written.
        turned: (`BLOCK`, max width) work array.
        rectified: As in `forward`.
        to_inputs: Whether the gradients of the inputs are written, too.
    """
    for k in range(len(widths) - 1):
        start += (widths[k] + 1) * widths[k + 1]
    for k in range(len(widths) - 2, -1, -1):
        inputs, outputs = widths[k], widths[k + 1]
        start -= (inputs + 1) * outputs
        if rectified:
            mask_slope(outputs, values[k + 1], changes[k + 1])
        elif k + 2 < len(widths):
            multiply_slope(outputs, values[k + 1], changes[k + 1])
        add_gradient(gradient, start, inputs, outputs, values[k], changes[k + 1], turned)
        if k > 0 or to_inputs:
            multiply_back(parameters, start, inputs, outputs, changes[k + 1], changes[k])


@func
def adam(
    parameters: np.ndarray,
    gradient: np.ndarray,
    mean: np.ndarray,
    square: np.ndarray,
    step: int,
    rate: float,
    max_norm: float,
) -> None:
    """Clip the norm of a gradient, and make a step of Adam.

    References:
        D. P. Kingma, J. Ba, Adam: a method for stochastic optimization (2015), algorithm 1.

    Args:
        parameters: (P,) float32, changed.
        gradient: (P,) gradients, clipped in place.
        mean: (P,) running means of the gradients, changed.
        square: (P,) running means of their squares, changed.
        step: Number of this step, from 1.
        rate: Learning rate.
        max_norm: Maximum norm of the gradient.
    """
    total = 0.0
    for k in range(len(gradient)):
        total += np.float64(gradient[k]) * np.float64(gradient[k])
    scale = np.float32(min(max_norm / (math.sqrt(total) + 1e-6), 1.0))
    # Products instead of powers, whose bits depend on the C library
    left_1, left_2 = 1.0, 1.0
    for _ in range(min(step, 40_000)):
        left_1 *= BETA_1
        left_2 *= BETA_2
    pace = np.float32(rate / (1.0 - left_1))
    root = np.float32(1.0 / math.sqrt(1.0 - left_2))
    keep_1, new_1 = np.float32(BETA_1), np.float32(1.0 - BETA_1)
    keep_2, new_2 = np.float32(BETA_2), np.float32(1.0 - BETA_2)
    tiny = np.float32(EPSILON)
    for k in range(len(gradient)):
        one = gradient[k] * scale
        gradient[k] = one
        mean[k] = keep_1 * mean[k] + new_1 * one
        square[k] = keep_2 * square[k] + new_2 * one * one
        parameters[k] -= pace * mean[k] / (np.sqrt(square[k]) * root + tiny)
