import numpy as np
import pytest
from scipy import stats

from bulletuav.network.arrivals import Arrivals, Tasks, make_tasks
from bulletuav.network.queueing import mean_wait, response_exceeds, wait_exceeds
from bulletuav.network.server import serve_tasks

INF = np.inf


def generators(worlds, seed=0):
    return [np.random.default_rng((seed, w)) for w in range(worlds)]


def drawn(arrivals, rngs, flying=None):
    """The tasks of one decision; all worlds fly unless told."""
    flying = np.ones(len(rngs), dtype=bool) if flying is None else flying
    first = np.zeros(len(flying) + 1, dtype=np.int64)
    uniform = arrivals.draw(rngs, flying, first, np.empty(0))
    return Tasks(first, *make_tasks(first, uniform, arrivals.cumulative, *arrivals.decision))


def draw(worlds, rates, dt, seed=0, bits=(1.0, 3.0)):
    return drawn(Arrivals(rates, dt, bits), generators(worlds, seed))


def world_of(tasks, w):
    """The tasks of one world, as a batch of one."""
    begin, end = tasks.first[w : w + 2]
    return Tasks(np.array([0, end - begin]), *(array[begin:end] for array in tasks[1:]))


def part(tasks, some, since=0.0):
    """Some of the tasks of one world, with the times since `since`."""
    return Tasks(
        np.array([0, np.count_nonzero(some)]),
        tasks.user[some],
        tasks.time[some] - since,
        tasks.bits[some],
    )


def tasks_of(*tasks):
    """One world's tasks from (time, user, bits)."""
    time, user, bits = np.array(tasks, dtype=float).reshape(-1, 3).T
    return Tasks(np.array([0, len(time)]), user.astype(np.int64), time, bits)


class Server:
    """One world or several where a task of b bits takes b seconds to compute."""

    def __init__(
        self, users=1, drones=1, cores=1, worlds=1, uplink=INF, deadline=INF, frequency=1.0
    ):
        self.assignment = np.zeros((worlds, users), dtype=np.int64)
        self.uplink = np.empty((worlds, users))
        self.uplink[:] = uplink
        self.link_free, self.core_free = (
            np.zeros((worlds, users)),
            np.zeros((worlds, drones, cores)),
        )
        self.deadline, self.frequency = deadline, frequency

    def __call__(self, tasks, dt=1.0):
        network = (self.assignment, self.uplink, 1.0, self.frequency, self.deadline, dt)
        return serve_tasks(tasks, *network, self.link_free, self.core_free)


def totals(*served):
    """Sums of the numbers of tasks, latency, busy time and cycles over decisions."""
    names = ("generated", "arrived", "completed", "latency", "busy", "cycles")
    return {name: sum(getattr(one, name) for one in served) for name in names}


def error_of(values):
    """Mean of independent values and its standard error."""
    return np.mean(values), np.std(values, ddof=1) / np.sqrt(len(values))


def test_one_core_serves_two_tasks_in_turn():
    server = Server()
    served = server(tasks_of((0.0, 0, 1.0), (0.5, 0, 1.0)))
    assert (served.generated, served.arrived, served.completed, served.cycles) == (2, 2, 2, 2)
    assert (served.latency, served.busy, served.backlog) == (1.0 + 1.5, 1.0, 1.0)
    rest = server(tasks_of())
    assert (rest.generated, rest.arrived, rest.latency, rest.busy, rest.backlog) == (
        0,
        0,
        0,
        1.0,
        0,
    )


def test_cores_share_the_work():
    server = Server(cores=2)
    served = server(tasks_of((0.0, 0, 0.5), (0.0, 0, 1.0), (0.25, 0, 0.5)))
    assert (served.latency, served.busy, served.backlog) == (0.5 + 1.0 + 0.75, 2.0, 0.0)
    assert server(tasks_of((0.0, 0, 2.0))).backlog == 0.5


def test_a_task_that_would_be_late_is_turned_away_and_takes_no_core():
    server = Server(deadline=1.25)
    served = server(tasks_of((0.0, 0, 1.0), (0.5, 0, 1.0), (0.75, 0, 0.75)))
    assert (served.arrived, served.completed, served.cycles) == (3, 2, 1.75)
    assert served.latency == 1.0 + 1.25 + 1.0
    assert served.backlog == 0.75
    on_time = Server(deadline=1.5)(tasks_of((0.0, 0, 1.0), (0.5, 0, 1.0)))
    assert (on_time.completed, on_time.latency) == (2, 2.5)


def test_an_uplink_sends_one_task_at_a_time():
    server = Server(users=2, uplink=2.0, frequency=INF)
    served = server(tasks_of((0.0, 0, 1.0), (0.25, 0, 1.0), (0.25, 1, 1.0)), 0.75)
    assert served.latency == 0.5 + 0.75 + 0.5
    assert server.link_free.tolist() == [[0.25, 0.0]]
    assert server(tasks_of((0.0, 0, 1.0), (0.0, 1, 1.0))).latency == 0.75 + 0.5


def test_an_upload_that_would_be_late_is_not_begun():
    server = Server(users=2, uplink=2.0, deadline=0.625, frequency=INF)
    served = server(tasks_of((0.0, 0, 1.0), (0.25, 0, 1.0), (0.5, 1, 1.0)))
    assert (served.arrived, served.completed, served.latency) == (3, 2, 0.5 + 0.625 + 0.5)
    assert server.link_free.tolist() == [[0.0, 0.0]]
    server(tasks_of((0.0, 0, 1.0), (0.25, 0, 1.0), (0.5, 0, 1.0)), 0.75)
    assert server.link_free.tolist() == [
        [0.25, 0.0]
    ]  # the third took the time that the second would have needed
    server.link_free[:] = 5.0  # left by tasks with more time
    assert server(tasks_of((0.0, 0, 1.0))).completed == 0
    assert server.link_free.tolist() == [[4.0, 4.0]]


def test_tasks_are_served_in_the_order_of_arrival():
    server = Server(users=2, uplink=[[1.0, INF]])
    served = server(tasks_of((0.0, 0, 1.0), (0.5, 1, 1.0)), 3.0)
    assert served.latency == 1.0 + 2.5
    server = Server(users=2, uplink=[[0.5, INF]])
    served = server(tasks_of((0.0, 0, 0.25), (0.5, 1, 1.0)), 3.0)
    assert served.latency == 0.75 + 1.25  # both arrive at 0.5: the older goes first


def test_drones_serve_their_own_users():
    server = Server(users=3, drones=3, cores=1)
    server.assignment[:] = [[2, 0, 2]]
    served = server(tasks_of((0.0, 0, 1.0), (0.0, 1, 0.5), (0.0, 2, 1.0)))
    assert served.arrived.tolist() == served.completed.tolist() == [[1, 0, 2]]
    assert served.latency.tolist() == [[0.5, 0.0, 3.0]]
    assert served.busy.tolist() == [[0.5, 0.0, 1.0]]
    assert served.backlog.tolist() == [[0.0, 0.0, 1.0]]


@pytest.mark.parametrize(("deadline", "active_targets"), [(0.5, 0.5), (INF, 0.0)])
def test_users_without_drone_or_rate_lose_their_tasks_at_once(deadline, active_targets):
    server = Server(users=2, uplink=[[1.0, 0.0]], deadline=deadline)
    server.assignment[:] = [[-1, 0]]
    served = server(tasks_of((0.0, 0, 0.1), (0.0, 1, 0.1)))
    assert (served.generated, served.arrived, served.completed, served.latency) == (
        2,
        1,
        0,
        active_targets,
    )
    assert np.count_nonzero(server.link_free) == np.count_nonzero(server.core_free) == 0


def test_a_core_does_not_wait_for_an_upload_under_way():
    server = Server(users=2, uplink=[[1.0, INF]])
    served = server(tasks_of((0.5, 0, 1.0)))
    assert (served.completed, served.latency, served.busy, served.backlog) == (1, 2.0, 0.0, 1.0)
    assert server.link_free.tolist() == [[0.5, 0.0]]
    served = server(tasks_of((0.0, 1, 1.0)), 2.0)
    assert (served.latency, served.busy, served.backlog) == (2.0, 2.0, 0.0)


@pytest.mark.parametrize("deadline", [INF, 0.3])
def test_one_decision_equals_two_of_half_its_length(deadline):
    tasks = draw(1, [3.0, 5.0, 9.0], 2.0, seed=4, bits=(0.1, 0.3))
    early, late = (
        tasks.time < 0.9,
        tasks.time >= 1.0,
    )  # between them an upload would cross the boundary
    one, two = (Server(users=3, cores=3, uplink=40.0, deadline=deadline) for _ in range(2))
    together = totals(one(part(tasks, early | late), 2.0))
    first = two(part(tasks, early))
    assert not two.link_free.any()
    assert first.backlog > 0
    apart = totals(first, two(part(tasks, late, since=1.0)))
    assert together["completed"] > 10
    assert (together["completed"] < together["arrived"]) == (deadline < INF)
    for name, value in together.items():
        np.testing.assert_allclose(apart[name], value, rtol=1e-12, err_msg=name)
    np.testing.assert_allclose(
        np.sort(two.core_free), np.sort(one.core_free), atol=1e-12
    )  # idle cores are alike
    np.testing.assert_allclose(two.link_free, one.link_free, atol=1e-12)


@pytest.mark.parametrize("deadline", [INF, 0.8])
def test_work_is_done_once(deadline):
    """However uploads cross the ends of decisions and cores idle until they come."""
    worlds, drones, cores, dt = 20, 3, 2, 0.25
    server = Server(
        users=12,
        drones=drones,
        cores=cores,
        worlds=worlds,
        uplink=6.0,
        deadline=deadline,
        frequency=3.0,
    )
    server.assignment[:] = np.arange(12) % (drones + 1) - 1
    rngs, results = generators(worlds), []
    for step in range(200):
        flying = np.full(worlds, step < 80)
        served = server(drawn(Arrivals(np.full(12, 0.9), dt, (0.5, 3.0)), rngs, flying), dt)
        assert (served.completed <= served.arrived).all()
        assert (served.arrived.sum(axis=1) <= served.generated).all()
        assert (served.busy <= cores * dt * (1 + 1e-12)).all()
        np.testing.assert_array_equal(served.backlog, server.core_free.mean(axis=2))
        results.append(served)
    total = totals(*results)
    assert not server.core_free.any()
    assert (total["completed"] > 0).all()
    assert (total["completed"] < total["arrived"]).any() == (deadline < INF)
    np.testing.assert_allclose(total["busy"], total["cycles"] / 3.0, rtol=1e-11)
    if deadline < INF:
        assert (total["latency"] <= deadline * total["arrived"]).all()


def test_worlds_are_served_as_if_alone():
    tasks = draw(5, [2.0, 3.0, 4.0], 2.0, bits=(0.1, 0.5))
    batch = Server(users=3, drones=2, cores=2, worlds=5, uplink=2.0, deadline=0.7)
    batch.assignment[:] = np.random.default_rng(1).integers(-1, 2, batch.assignment.shape)
    served = batch(tasks)
    for w in range(5):
        alone = Server(users=3, drones=2, cores=2, uplink=2.0, deadline=0.7)
        alone.assignment[:] = batch.assignment[w]
        for together, single in zip(served, alone(world_of(tasks, w)), strict=True):
            assert together[w].tolist() == single[0].tolist()
        assert batch.link_free[w].tolist() == alone.link_free[0].tolist()
        assert batch.core_free[w].tolist() == alone.core_free[0].tolist()


@pytest.mark.parametrize(("cores", "arrival_rate", "rate"), [(4, 3.0, 1.0), (4, 5.0, 4.0)])
def test_exponential_sizes_meet_erlang(cores, arrival_rate, rate):
    """A task that came at the end of a decision would wait as tasks do.

    Poisson arrivals see time averages.
    """
    worlds, dt, users = 1000, 8.0 / rate, 3
    server = Server(users=users, cores=cores, worlds=worlds, frequency=rate)
    rng, rngs = np.random.default_rng(5), generators(worlds, 6)
    late = np.array([1.0, 4.0]) / rate
    waits, missed, results = [], [], []
    for step in range(60):
        tasks = drawn(Arrivals(np.full(users, arrival_rate / users), dt, (1.0, 1.0)), rngs)
        served = server(tasks._replace(bits=rng.exponential(size=len(tasks.bits))), dt)
        if step < 10:  # it began empty
            continue
        results.append(served)
        waits.append(server.core_free[:, 0].min(axis=1))
        one_each = Tasks(
            np.arange(worlds + 1),
            np.zeros(worlds, dtype=np.int64),
            np.zeros(worlds),
            rng.exponential(size=worlds),
        )
        for time in late:
            probe = Server(users=users, cores=cores, worlds=worlds, frequency=rate, deadline=time)
            probe.core_free[:] = server.core_free
            missed.append(1 - probe(one_each).completed[:, 0])
    total, queue = totals(*results), (cores, arrival_rate, rate)
    assert total["generated"].sum() > 400_000
    wait = (total["latency"] - total["cycles"] / rate)[:, 0] / total["completed"].mean()
    missed = np.reshape(missed, (-1, 2, worlds)).mean(axis=0)
    compared = [(wait, mean_wait(*queue)), (total["busy"][:, 0] / (50 * dt), arrival_rate / rate)]
    compared += [
        (np.mean(np.array(waits) > t, axis=0), wait_exceeds(*queue, t)) for t in (0.0, 0.5 / rate)
    ]
    compared += [(missed[k], response_exceeds(*queue, late[k])) for k in range(2)]
    for values, expected in compared:
        mean, error = error_of(values)
        assert abs(mean - expected) < 3.5 * error
        assert error < 0.05 * expected


@pytest.mark.parametrize("where", ["core", "uplink"])
def test_uniform_sizes_meet_pollaczek_and_khinchine(where):
    """A core or an uplink with sizes uniform between a and b is M/G/1.

    Wq = lambda E[S^2] / (2 (1 - rho)).
    """
    low, high, arrival_rate, worlds = 0.5, 1.5, 0.7, 1500
    speeds = {"core": {}, "uplink": {"uplink": 1.0, "frequency": INF}}[where]
    server, rngs, results = Server(worlds=worlds, **speeds), generators(worlds, 3), []
    for _ in range(12):
        tasks = drawn(Arrivals([arrival_rate], 25.0, (low, high)), rngs)
        results.append(server(tasks, 25.0))
    total = totals(*results[2:])
    wait = (total["latency"] - total["cycles"])[:, 0] / total["completed"].mean()
    square = (high**3 - low**3) / (3 * (high - low))  # E[S^2]
    mean, error = error_of(wait)
    assert abs(mean - arrival_rate * square / (2 * (1 - arrival_rate))) < 3.5 * error
    assert error < 0.02 * mean


def test_arrivals_are_poisson():
    rates = np.array([0.5, 0.0, 2.0, 1.5, 0.0])
    tasks = draw(20000, rates, 1.5, seed=1)
    world = np.repeat(np.arange(20000), np.diff(tasks.first))
    counts = np.zeros((20000, 5))
    np.add.at(counts, (world, tasks.user), 1)
    mean, error = counts.mean(axis=0), np.sqrt(1.5 * rates / 20000)
    assert (np.abs(mean - 1.5 * rates) <= 4 * error).all()
    assert (np.abs(counts.var(axis=0) - 1.5 * rates) <= 4 * error * np.sqrt(1 + 3 * rates)).all()
    between = np.corrcoef(counts[:, [0, 2, 3]].T)[np.triu_indices(3, 1)]
    assert (np.abs(between) < 4 / np.sqrt(20000)).all()  # users do not feel each other


@pytest.mark.parametrize("dt", [0.05, 1.0, 400.0])
def test_gaps_are_exponential_whatever_the_decision(dt):
    steps = round(400 / dt)
    rngs, times = generators(4, 2), [[], [], [], []]
    for step in range(steps):
        tasks = drawn(Arrivals([1.0, 2.0], dt, (1.0, 3.0)), rngs)
        for w in range(4):
            times[w].append(world_of(tasks, w).time + step * dt)
    gaps = np.concatenate([np.diff(np.concatenate(one)) for one in times])
    assert abs(len(gaps) - 4800) < 4 * np.sqrt(4800)
    assert stats.kstest(gaps, "expon", (0, 1 / 3)).pvalue > 0.01


def test_times_ascend_within_the_decision_and_sizes_keep_their_bounds():
    tasks = draw(300, [5.0, 20.0], 2.0, bits=(2e6, 3e6))
    assert len(tasks.user) == len(tasks.time) == len(tasks.bits) == tasks.first[-1]
    for w in range(300):
        assert (np.diff(world_of(tasks, w).time) > 0).all()
    assert 0 <= tasks.time.min() < tasks.time.max() <= 2
    assert 2e6 <= tasks.bits.min() < 2.001e6 < 2.999e6 < tasks.bits.max() <= 3e6
    for values, least, span in ((tasks.bits, 2e6, 1e6), (tasks.time, 0, 2)):
        assert stats.kstest(values, "uniform", (least, span)).pvalue > 0.01
    between = np.corrcoef([tasks.user, tasks.time, tasks.bits])[np.triu_indices(3, 1)]
    assert (np.abs(between) < 4 / np.sqrt(len(tasks.bits))).all()
    assert (draw(3, [9.0], 1.0, bits=(5, 5)).bits == 5).all()


@pytest.mark.parametrize(("number", "user"), [(0.0, 1), (0.5, 3), (1 - 2**-53, 3)])
def test_users_of_rate_0_have_no_tasks(number, user):
    class Fixed(np.random.Generator):
        def poisson(self, mean):
            return 2

        def random(self, count):
            return np.full(count, number) if number else np.array([0.5, 0.5, 0, 0, 0.5, 0.5, 0.5])

    tasks = drawn(Arrivals([0, 0.1, 0, 0.1, 0], 1.0, (1.0, 1.0)), [Fixed(np.random.PCG64())])
    assert tasks.user.tolist() == [user, user]


def test_worlds_draw_from_their_own_generators_alone():
    arrivals = Arrivals([9.0, 2.0], 2.0, (1.0, 3.0))
    as_int = drawn(arrivals, generators(4))
    rngs = [None, *generators(4)[1:]]
    some = drawn(arrivals, rngs, np.array([False, True, True, False]))
    assert np.diff(some.first)[[0, 3]].tolist() == [0, 0]
    for w in (1, 2):
        for one, same in zip(world_of(as_int, w), world_of(some, w), strict=True):
            assert len(one) > 1
            np.testing.assert_array_equal(one, same)
    assert rngs[3].random() == generators(4)[3].random()  # a world that does not fly draws nothing
    assert rngs[2].random() != generators(4)[2].random()
    assert drawn(arrivals, [None], np.array([False])).first.tolist() == [0, 0]
    assert draw(2, [0.0, 0.0], 2.0).first.tolist() == [0, 0, 0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rates": [1.0, -1.0]}, "at least 0"),
        ({"rates": [1.0, np.nan]}, "finite numbers of tasks per second"),
        ({"rates": [[1.0, 2.0]] * 3}, r"shape \(3, 2\): \(users,\) is needed"),
        ({"rates": []}, r"\(users,\)"),
        ({"rates": 3.0}, r"shape \(\)"),
        ({"rates": "many"}, "rates are not numbers"),
        ({"dt": 0.0}, "dt is 0.0: seconds above 0"),
        ({"bits": (2.0, 1.0)}, "low <= high"),
        ({"bits": (0.0, 1.0)}, "above 0"),
        ({"bits": 5.0}, "bits is 5.0: a list or tuple"),
    ],
)
def test_wrong_numbers_are_named(changes, message):
    given = {"rates": [1.0, 2.0], "dt": 1.0, "bits": (1.0, 2.0), **changes}
    with pytest.raises(ValueError, match=message):
        Arrivals(**given)
