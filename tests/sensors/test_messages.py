"""Messages of the option `communication`: range, delay, losses, bandwidth, sight and jamming."""

import math

import numpy as np
import pytest
from scipy import stats
from sensing import moment_of, sensor_of, start

from bulletuav.sensors.messages import Channel, Jammer, Messages, as_channel
from bulletuav.vehicle.swarm import Swarm

PERIOD = 0.1


def at(position):
    """A swarm at rest at positions (N, 3)."""
    position = np.array(position, dtype=float)[None]
    shape = position.shape[:2]
    still = np.zeros(position.shape)
    upright = np.zeros((*shape, 4))
    upright[..., 3] = 1
    return Swarm(position, upright, still, still, np.zeros((*shape, 4)), np.zeros((*shape, 0)))


def fly(channel, position, decisions, message=None, mask=None, neighbours=None, discrete=False):
    """The observations (T, N, slots, numbers) of drones at rest, and the infos of each decision."""
    swarm, drones = at(position), len(position)
    neighbours = neighbours or drones - 1
    sensor = sensor_of(
        Messages(channel, discrete), (1, drones), period=PERIOD, num_neighbours=neighbours
    )
    rng = np.random.default_rng(7)
    start(sensor, 0, swarm, rng)
    seen, infos = [], []
    for step in range(1, decisions + 1):
        action = np.zeros((1, drones, 3 + channel.size)) if message is None else message(step)
        one = {"steps": step, "rngs": [rng], "action": action, "mask": mask}
        reading = sensor.measure(moment_of(swarm, **one))["messages"]
        seen.append(reading.reshape(drones, neighbours, -1))
        infos.append({name: value[0].copy() for name, value in sensor.info().items()})
    return np.array(seen), infos


def counting(size=1, drones=2):
    """Actions whose message is a hundredth of the step, for each drone another multiple."""

    def message(step):
        action = np.zeros((1, drones, 3 + size))
        action[0, :, 3:] = step / 100 * (1 + np.arange(drones))[:, None]
        return action

    return message


def test_slots_are_the_nearest_drones_in_range():
    # Drone 0 hears 1 at 10 m, not 2 at 25 m; drone 2 hears 1 at 15 m
    seen, infos = fly(
        Channel(size=1, range=20.0), [(0, 0, 5), (10, 0, 5), (25, 0, 5)], 1, counting(1, 3)
    )
    expected = [[(1, 0.02), (0, 0)], [(1, 0.01), (1, 0.03)], [(1, 0.02), (0, 0)]]
    np.testing.assert_allclose(seen[0], expected)
    np.testing.assert_array_equal(infos[0]["messages_heard"], (1, 2, 1))
    np.testing.assert_array_equal(infos[0]["message_bits"], (32, 32, 32))


@pytest.mark.parametrize(("delay", "late"), [(0.0, 0), (0.1, 1), (0.25, 3), (0.3, 3)])
def test_messages_arrive_after_the_delay_in_whole_decisions(delay, late):
    seen, infos = fly(Channel(size=1, delay=delay), [(0, 0, 5), (10, 0, 5)], 6, counting())
    for step in range(1, 7):
        expected = (1, 0.02 * (step - late)) if step > late else (0, 0)
        np.testing.assert_allclose(seen[step - 1, 0, 0], expected)
        assert infos[step - 1]["messages_heard"][0] == max(step - late, 0)


def test_losses_are_independent_draws_of_the_world():
    decisions, loss = 1000, 0.3
    place = [(0, 0, 5), (10, 0, 5), (0, 10, 5)]
    seen, _ = fly(Channel(size=1, loss=loss), place, decisions, counting(1, 3))
    lost = 1 - seen[..., 0]
    count = decisions * 6
    low, high = stats.binom.interval(0.999, count, loss)
    assert low <= lost.sum() <= high
    # Both directions of a pair, and successive decisions, are independent
    for one, other in ((lost[:, 0, 0], lost[:, 1, 0]), (lost[1:, 0, 0], lost[:-1, 0, 0])):
        assert abs(np.corrcoef(one, other)[0, 1]) < 4 / math.sqrt(decisions)
    # What is lost leaves nothing behind
    assert (seen[lost == 1] == 0).all()


def test_bandwidth_makes_drones_send_in_every_third_decision():
    # 8 numbers have 256 bits; 1,000 bits/s are 100 bits in a decision
    channel = Channel(size=8, bandwidth=1000.0)
    assert channel.message_bits == 256
    seen, infos = fly(channel, [(0, 0, 5), (10, 0, 5)], 7, counting(8))
    np.testing.assert_array_equal(seen[:, 0, 0, 0], (1, 0, 0, 1, 0, 0, 1))
    assert [one["message_bits"][0] for one in infos] == [256, 256, 256, 512, 512, 512, 768]
    # 5 tokens of 8 have 15 bits, and 10 decisions a second need 150 bits/s
    for bandwidth, between in ((150.0, 1), (149.0, 2), (10.0, 15)):
        assert Channel(size=5, tokens=8, bandwidth=bandwidth).decisions_between(0.1) == between


def test_tokens_are_observed_as_ones_at_their_index():
    # -1, 0.1 and 1 are the tokens 0, 2 (nearest to 1.1 / 2 * 3 = 1.65) and 3 of 4
    def message(step):
        action = np.zeros((1, 2, 6))
        action[..., 3:] = (-1, 0.1, 1)
        return action

    seen, infos = fly(Channel(size=3, tokens=4), [(0, 0, 5), (10, 0, 5)], 1, message)
    expected = [1, *(1, 0, 0, 0), *(0, 0, 1, 0), *(0, 0, 0, 1)]
    np.testing.assert_array_equal(seen[0, 0, 0], expected)
    assert infos[0]["message_bits"][0] == 6


def test_discrete_actions_have_the_tokens_as_digits():
    # 3 + 9 * 2 + ... : the choice 5 * 9 + 7 is move 5 with the tokens 2, 1 in base 3
    seen, _ = fly(
        Channel(size=2, tokens=3),
        [(0, 0, 5), (10, 0, 5)],
        1,
        lambda step: np.full((1, 2, 1), 52.0),
        discrete=True,
    )
    np.testing.assert_array_equal(seen[0, 0, 0], [1, *(0, 0, 1), *(0, 1, 0)])


def test_drones_that_left_send_and_hear_nothing():
    place = [(0, 0, 5), (10, 0, 5), (20, 0, 5)]
    seen, infos = fly(Channel(size=1), place, 1, counting(1, 3), mask=[[True, False, True]])
    np.testing.assert_allclose(seen[0, 0], [(1, 0.03), (0, 0)])
    np.testing.assert_array_equal(seen[0, 1], 0)
    np.testing.assert_array_equal(infos[0]["messages_heard"], (1, 0, 1))
    np.testing.assert_array_equal(infos[0]["message_bits"], (32, 0, 32))


def test_more_neighbours_than_others_are_empty_slots():
    seen, _ = fly(Channel(size=1), [(0, 0, 5), (10, 0, 5)], 1, counting(), neighbours=3)
    np.testing.assert_allclose(seen[0, 0], [(1, 0.02), (0, 0), (0, 0)])


# Jamming


def test_a_jammer_drowns_messages_near_it():
    """Powers of 0 dB and a ratio of 10 dB: distances up to the jammer's times 10^-0.5."""
    place = [(0, 0, 5), (10, 0, 5)]
    for distance, arrives in ((31.7, 1), (31.5, 0)):
        jammer = {"path": [(0, distance, 5)]}
        seen, _ = fly(Channel(size=1, jammer=Jammer(**jammer)), place, 1, counting())
        assert seen[0, 0, 0, 0] == arrives
        # Drone 1 is farther away from it
        assert seen[0, 1, 0, 0] == 1
    # 20 dB more power: ten times as far
    for distance, arrives in ((317.0, 1), (315.0, 0)):
        jammer = {"path": [(0, distance, 5)], "power": 14.0, "min_ratio": 16.0}
        seen, _ = fly(Channel(size=1, jammer=Jammer(**jammer)), place, 1, counting())
        assert seen[0, 0, 0, 0] == arrives


def test_a_jammer_flies_along_its_closed_path():
    jammer = Jammer(path=[(0, 0, 0), (30, 0, 0), (30, 40, 0)], speed=10.0)  # 30 + 40 + 50 m
    for time, place in (
        (0.0, (0, 0, 0)),
        (2.0, (20, 0, 0)),
        (5.0, (30, 20, 0)),
        (9.5, (15, 20, 0)),
        (12.0, (0, 0, 0)),
        (26.0, (20, 0, 0)),
    ):
        np.testing.assert_allclose(jammer.position(time), place, atol=1e-9)
    # It comes near after 3 s
    passing = Jammer(path=[(0, 300, 5), (0, 0, 5)], speed=100.0)
    seen, _ = fly(Channel(size=1, jammer=passing), [(0, 0, 5), (10, 0, 5)], 60, counting())
    heard = seen[:, 0, 0, 0]
    assert heard[0] == heard[-1] == 1
    assert heard[29] == 0
    # Within 31.6 m for 0.316 s before and after
    assert (heard == 0).sum() == 7


# Bad input


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (3, "communication is 3: Channel, or a dict of size, tokens"),
        ({"sise": 3}, "attribute of communication: 'sise': did you mean 'size'"),
        ({"size": 0}, "size of communication is 0"),
        ({"size": 1.5}, "size of communication is 1.5"),
        ({"tokens": 1}, "tokens of communication is 1"),
        ({"range": 0.0}, "range of communication is 0: it must be above 0"),
        ({"range": math.nan}, "range of communication is nan"),
        ({"bandwidth": -3.0}, "bandwidth of communication is -3"),
        ({"loss": 1.0}, "no message arrives: lower it"),
        ({"loss": 1.1}, "loss of communication is 1.1"),
        ({"delay": 11.0}, "delay of communication is 11"),
        ({"line_of_sight": 1}, "line_of_sight of communication is 1"),
        ({"jammer": {}}, "it lacks a path"),
        ({"jammer": {"path": []}}, "path of a jammer is"),
        ({"jammer": {"path": [(0, 0)]}}, "path of a jammer is"),
        ({"jammer": {"path": [(0, 0, 1)], "speed": 2.0}}, "two of them or more"),
        ({"jammer": {"path": [(0, 0, 1)] * 2, "speed": 2.0}}, "has 1 different points"),
        ({"jammer": {"path": [(0, 0, 1), (1, 1, 1)]}}, "needs a speed above 0"),
        ({"jammer": {"path": [(0, 0, 1)], "power": 1e3}}, "power of a jammer is 1000"),
    ],
)
def test_invalid_channels(given, message):
    with pytest.raises(ValueError, match=message):
        as_channel(given)


@pytest.mark.parametrize("loss", [0.0, 0.4])
@pytest.mark.parametrize("range_", [6.0, math.inf])
def test_large_swarms_hear_as_small_ones_do(range_, loss):
    # 260 drones are searched by grids: compared with all pairs, in NumPy
    drones, slots = 260, 4
    rng = np.random.default_rng(3)
    position = rng.uniform(0, 30, (drones, 3))
    position[10:14] = position[14]
    mask = rng.random((1, drones)) < 0.9
    channel = Channel(size=1, range=range_, loss=loss)
    seen, infos = fly(channel, position, 1, counting(1, drones), mask=mask, neighbours=slots)
    arrives = np.random.default_rng(7).random((drones, drones)) >= loss
    square = ((position[None] - position[:, None]) ** 2).sum(axis=2)
    pairs = mask[0] & mask[0][:, None] & ~np.eye(drones, dtype=bool)
    heard = pairs & (np.sqrt(square) <= range_) & arrives
    np.testing.assert_array_equal(infos[0]["messages_heard"], heard.sum(axis=1))
    for i in range(drones):
        nearest = sorted(np.flatnonzero(pairs[i]), key=lambda j: (square[i, j], j))[:slots]
        expected = [(1, 0.01 * (1 + j)) if heard[i, j] else (0, 0) for j in nearest]
        expected += [(0, 0)] * (slots - len(expected))
        np.testing.assert_allclose(seen[0, i], expected, err_msg=str(i))
