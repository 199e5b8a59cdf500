import itertools

import mpmath
import pytest
from mpmath import mpf

from bulletuav.city.sight_probability import SIGMOIDS
from bulletuav.city.statistics import KINDS
from bulletuav.network.propagation import EXCESS
from bulletuav.reproduction import find_reproduction
from bulletuav.reproduction.formulas import formula_row, printed_row
from bulletuav.reproduction.table import Settings
from bulletuav.reproduction.tables import air_to_ground, erlang, propulsion, tr38901

EXACT = 1e-14  # relative: constants are numbers of double precision


@pytest.fixture(autouse=True)
def thirty_digits():
    with mpmath.workdps(30):
        yield


def exact(*values):
    """Decimal numbers as they are written, not as binary numbers."""
    return [mpf(str(value)) for value in values]


# Rows


@pytest.mark.parametrize(
    ("ours", "verdict"),
    [(4.8849, "within"), (4.8751, "within"), (4.8851, "outside"), (4.8749, "outside")],
)
def test_half_a_unit_of_the_last_printed_digit_is_no_difference(ours, verdict):
    assert printed_row("a", ours, "4.88").verdict == verdict


def test_whole_printed_numbers_are_rounded_too():
    assert printed_row("power", 79.6, "80").verdict == "within"
    assert printed_row("power", 79.4, "80").verdict == "outside"
    assert printed_row("power", 79.4, "80", why="rounded").verdict == "explained"


@pytest.mark.parametrize("scale", [1e-8, 1.0, 1e8])
def test_formulas_agree_to_a_relative_difference(scale):
    assert formula_row("x", scale * (1 + 9e-10), scale).verdict == "within"
    assert formula_row("x", scale * (1 + 1.1e-9), scale).verdict == "outside"


# Tables


@pytest.mark.parametrize(
    ("name", "rows", "verdict", "others"),
    [
        ("erlang", 79, "outside", 7),
        ("propulsion", 37, "explained", 4),
        ("tr38901", 75, "explained", 0),
        ("air-to-ground", 52, "explained", 0),
    ],
)
def test_all_other_rows_agree(name, rows, verdict, others):
    reports = []
    outcome = find_reproduction(name).compute(Settings(progress=reports.append))
    verdicts = [row.verdict for row in outcome.rows]
    assert (len(verdicts), verdicts.count(verdict)) == (rows, others)
    assert verdicts.count("within") == rows - others
    assert len({row.name for row in outcome.rows}) == rows
    assert reports[-1] == 1.0
    assert all(axes.get_xlabel() and axes.get_ylabel() for axes in outcome.figure.axes)


def test_wrong_formula_is_outside(monkeypatch):
    monkeypatch.setattr(tr38901, "LAWS", {**tr38901.LAWS, "UMa LoS": tr38901.LAWS["UMi LoS"]})
    verdicts = {row.name: row.verdict for row in tr38901.REPRODUCTION.compute(Settings()).rows}
    assert verdicts["ns-3: UMa LoS at 10 m"] == "outside"
    assert verdicts["ns-3: UMi LoS at 10 m"] == "within"


# Erlang


def blocked(servers, load):
    terms = [load**k / mpmath.factorial(k) for k in range(servers + 1)]
    return terms[-1] / sum(terms)


def waiting(servers, load):
    terms = [load**k / mpmath.factorial(k) for k in range(servers)]
    last = load**servers / mpmath.factorial(servers) * servers / (servers - load)
    return last / (sum(terms) + last)


@pytest.mark.parametrize("queue", erlang.QUEUES)
def test_constants_of_queues(queue):
    servers, (arrivals, service) = queue[0], exact(*queue[1:])
    load = arrivals / service
    found = blocked(servers, load), waiting(servers, load)
    wait = found[1] / (servers * service - arrivals)
    assert erlang.QUEUES[queue] == pytest.approx([float(x) for x in (*found, wait)], rel=EXACT)


@pytest.mark.parametrize("queue", erlang.LATE)
def test_constants_of_late_responses(queue):
    servers, (arrivals, service, time) = queue[0], exact(*queue[1:])
    chance, spare = waiting(servers, arrivals / service), servers * service - arrivals

    def density(wait):
        return chance * spare * mpmath.exp(-spare * wait - service * (time - wait))

    # Tasks that do not wait, tasks that wait longer, and tasks that wait and are then served late
    late = (1 - chance) * mpmath.exp(-service * time) + chance * mpmath.exp(-spare * time)
    late += mpmath.quad(density, [0, time])
    assert erlang.LATE[queue] == pytest.approx(float(late), rel=EXACT)


def test_capacity_grows_faster_than_the_number_of_servers():
    loads = [erlang.find_capacity(servers, 0.02) for servers in (1, 2, 4, 8, 16)]
    assert loads[0] == pytest.approx(0.02 / 0.98, rel=1e-12)
    assert all(more > 2 * less for less, more in itertools.pairwise(loads))


# Propulsion


def drone(weight, radius, area, speed, plate):
    weight, radius, area, speed, plate = exact(weight, radius, area, speed, plate)
    density, solidity = exact(1.225, 0.05)
    blade = mpf("0.0015") * density * solidity * area * (speed * radius) ** 3
    velocity = mpmath.sqrt(weight / (2 * density * area))
    drag = plate / (solidity * area)
    return blade, mpf("1.1") * weight * velocity, speed * radius, velocity, drag, area


def power(speed, blade, induced, tip, velocity, drag, area):
    """Their eq. 12 as written, with its cancellation."""
    x = speed**2 / (2 * velocity**2)
    return (
        blade * (1 + 3 * speed**2 / tip**2)
        + induced * mpmath.sqrt(mpmath.sqrt(1 + x**2) - x)
        + drag * mpf("1.225") * mpf("0.05") * area * speed**3 / 2
    )


LIGHT = (20, 0.4, 0.503, 300, 0.0151)
HEAVY = (100, 0.5, 0.79, 400, 0.01185)


@pytest.mark.parametrize("speed", propulsion.POWERS)
def test_constants_of_powers(speed):
    found = [float(power(mpf(speed), *drone(*sizes))) for sizes in (LIGHT, HEAVY)]
    assert propulsion.POWERS[speed] == pytest.approx(found, rel=EXACT)


def test_constants_of_the_best_speeds():
    light = drone(*LIGHT)
    _, induced, tip, velocity, _, area = light
    alone = power(mpf(500), 0, induced, tip, velocity, 0, area)
    assert pytest.approx(float(alone), rel=EXACT) == propulsion.INDUCED_AT_500
    endurance, least, far, energy = (mpf(x) for x in propulsion.BEST)
    assert abs(mpmath.diff(lambda v: power(v, *light), endurance)) < 1e-12
    assert abs(mpmath.diff(lambda v: power(v, *light) / v, far)) < 1e-12
    assert float(least) == pytest.approx(float(power(endurance, *light)), rel=EXACT)
    assert float(energy) == pytest.approx(float(power(far, *light) / far), rel=EXACT)


# Path loss


def log(x):
    return mpmath.log(x, 10)


def far(distance, height, other):
    return mpmath.sqrt(distance**2 + (height - other) ** 2)


def expected_loss(law, distance, base, user, frequency):
    d, base, user, f = exact(distance, base, user, frequency)
    intercept, slope = (mpf(28), mpf(22)) if law.startswith("UMa") else (mpf("32.4"), mpf(21))
    bend = 4 * (base - 1) * (user - 1) * f * 10 / 3
    decades = log(far(d, base, user))
    loss = intercept + slope * decades + 20 * log(f)
    if d > bend:
        excess = (20 - slope / 2) * log(bend**2 + (base - user) ** 2)
        loss = intercept + 40 * decades + 20 * log(f) - excess
    above = user - mpf("1.5")
    if law == "UMa NLoS":
        other = mpf("13.54") + mpf("39.08") * decades + 20 * log(f) - mpf("0.6") * above
        return max(loss, other)
    if law == "UMi NLoS":
        other = mpf("22.4") + mpf("35.3") * decades + mpf("21.3") * log(f) - mpf("0.3") * above
        return max(loss, other)
    return loss


@pytest.mark.parametrize("link", tr38901.LOSSES)
def test_constants_of_losses(link):
    assert tr38901.LOSSES[link] == pytest.approx(float(expected_loss(*link)), rel=EXACT)


def sight(distance, certain, decay):
    if distance <= certain:
        return mpf(1)
    return certain / distance + mpmath.exp(-distance / decay) * (1 - certain / distance)


def test_constants_of_sight():
    for distance, chance in tr38901.UMI_SIGHT.items():
        assert chance == pytest.approx(float(sight(mpf(distance), 18, 36)), rel=EXACT)
    for (distance, user), chance in tr38901.UMA_SIGHT.items():
        d, user = exact(distance, user)
        lift = mpf("1.25") * (max(user - 13, mpf(0)) / 10) ** mpf("1.5")
        gain = lift * (d / 100) ** 3 * mpmath.exp(-d / 150)
        assert chance == pytest.approx(float(sight(d, 18, 63) * (1 + gain)), rel=EXACT)


@pytest.mark.parametrize("link", tr38901.AERIAL)
def test_constants_of_drones(link):
    d, h = exact(*link)
    micro, macro = far(d, h, 10), far(d, h, 25)
    free = 20 * log(4 * mpmath.pi * micro * 2 * mpf(10) ** 9 / 299792458)
    los = max(free, mpf("30.9") + (mpf("22.25") - log(h) / 2) * log(micro) + 20 * log(2))
    nlos = mpf("32.4") + (mpf("43.2") - mpf("7.6") * log(h)) * log(micro) + 20 * log(2)
    certain = max(mpf("294.05") * log(h) - mpf("432.94"), 18)
    chance = sight(d, certain, mpf("233.98") * log(h) - mpf("0.95"))
    found = [float(x) for x in (los, max(los, nlos), chance)]
    assert tr38901.AERIAL[link][0] == pytest.approx(found, rel=EXACT)
    blocked = (46 - 7 * log(h)) * log(macro) + 20 * log(40 * mpmath.pi * 2 / 3) - mpf("17.5")
    chance = sight(d, max(460 * log(h) - 700, 18), 4300 * log(h) - 3800)
    found = [float(x) for x in (28 + 22 * log(macro) + 20 * log(2), blocked, chance)]
    assert tr38901.AERIAL[link][1] == pytest.approx(found, rel=EXACT)


@pytest.mark.parametrize("angles", tr38901.GAINS)
def test_constants_of_antennas(angles):
    """The direction by the turns of the standard, as vectors instead of its eq. 7.1-7 and 7.1-8."""
    zenith, azimuth, bearing, downtilt = (mpmath.radians(angle) for angle in exact(*angles))
    sine, cosine = mpmath.sin(zenith), mpmath.cos(zenith)
    x, y = sine * mpmath.cos(azimuth - bearing), sine * mpmath.sin(azimuth - bearing)
    ahead = x * mpmath.cos(downtilt) - cosine * mpmath.sin(downtilt)
    up = x * mpmath.sin(downtilt) + cosine * mpmath.cos(downtilt)
    elevation = mpmath.degrees(mpmath.asin(up))
    sideways = mpmath.degrees(mpmath.atan2(y, ahead))
    loss = min(12 * (elevation / 65) ** 2, 30) + min(12 * (sideways / 65) ** 2, 30)
    assert tr38901.GAINS[angles] == pytest.approx(float(8 - min(loss, 30)), rel=1e-13)


# Line of sight


@pytest.mark.parametrize("kind", SIGMOIDS)
def test_constants_of_sigmoids(kind):
    a, b = exact(*SIGMOIDS[kind])
    found = [
        float(1 / (1 + a * mpmath.exp(-b * (elevation - a))))
        for elevation in air_to_ground.ELEVATIONS
    ]
    assert air_to_ground.SIGHT[kind] == pytest.approx(found, rel=EXACT)


@pytest.mark.parametrize("kind", KINDS)
def test_constants_of_p1410(kind):
    alpha, beta, gamma = exact(KINDS[kind].alpha, KINDS[kind].beta, KINDS[kind].gamma)
    for (distance, height), chance in zip(
        air_to_ground.RAYS, air_to_ground.P1410[kind], strict=True
    ):
        passed = int(mpf(distance) / 1000 * mpmath.sqrt(alpha * beta))
        found = mpf(1)
        for i in range(passed):
            ray = height - (i + mpf("0.5")) / passed * (height - mpf("1.5"))
            found *= 1 - mpmath.exp(-(ray**2) / (2 * gamma**2))
        assert chance == pytest.approx(float(found), rel=EXACT)


@pytest.mark.parametrize("place", air_to_ground.MEAN_LOSS)
def test_constants_of_mean_losses(place):
    kind, elevation = place
    (a, b), (clear, covered) = exact(*SIGMOIDS[kind]), exact(*EXCESS[kind])
    chance = 1 / (1 + a * mpmath.exp(-b * (elevation - a)))
    away = 100 / mpmath.sin(mpmath.pi * elevation / 180)
    free = 20 * log(8 * mpf(10) ** 9 * mpmath.pi * away / 299792458)
    mean = float(free + chance * clear + (1 - chance) * covered)
    assert air_to_ground.MEAN_LOSS[place] == pytest.approx(mean, rel=EXACT)
