"""Broken logs are refused, with column, value and remedy."""

import flown
import numpy as np
import pytest

from bulletuav import load_airframe
from bulletuav.cli import main
from bulletuav.identification.checks import check_log
from bulletuav.identification.flight import prepare_log
from bulletuav.identification.logs import ColumnSource, parse_map, read_log

DRONE = load_airframe("cf2x")
SECONDS = 12


def circle():
    """A flight by formulas: a circle, leaning inwards, at hover speed with sines."""
    time = np.arange(0, SECONDS, 0.01)
    zero = np.zeros_like(time)
    lean = 0.2 * np.sin(2 * time)
    roll = [np.sin(lean / 2), zero, zero, np.cos(lean / 2)]
    rates = [0.4 * np.cos(2 * time), 0.01 * np.sin(9 * time), 0.01 * np.sin(8 * time)]
    place = [np.cos(time), np.sin(time), 1 + 0.1 * np.sin(time)]
    speeds = [DRONE.hover_speed() + 20 * np.sin(3 * time + k) for k in range(4)]
    quaternion = [roll[0], 1e-3 * np.sin(time), 1e-3 * np.cos(time), roll[3]]
    return np.stack([time, *place, *quaternion, *rates, *speeds], axis=1)


@pytest.fixture
def check(tmp_path):
    """Writes rows, reads and checks them."""

    def run(rows, names=flown.COLUMNS, maps=()):
        path = flown.write_example_log(tmp_path / "log.csv", rows, names)
        return check_log(read_log(path, parse_map(maps), 4), DRONE)

    return run


def changed(column, values):
    rows = circle()
    rows[:, flown.COLUMNS.index(column)] = values
    return rows


def scaled(columns, factor):
    rows = circle()
    for column in columns:
        rows[:, flown.COLUMNS.index(column)] *= factor
    return rows


def without(rows, first, last):
    return np.delete(rows, slice(first, last), axis=0)


def holes(column, first, last):
    rows = circle()
    rows[first:last, flown.COLUMNS.index(column)] = np.nan
    return rows


def test_a_sound_log_passes(check):
    log = check(circle())
    assert len(log.time) == 100 * SECONDS
    assert log.filled == {}


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (without(circle(), 300, 350), r"t has a gap of 0\.510 s after 2\.990 s .* cut the log"),
        (circle()[[*range(500), 499, *range(500, 1200)]], r"t does not increase: 4\.99.* row 502"),
        (holes("y", 200, 260), r"y has no numbers for 0\.610 s from row 202 on"),
        (changed("q", np.nan), "q has no numbers: map another column"),
        (changed("w1", 1739.0), r"w1 does not change: it is 1739 in all 1200 rows"),
        (changed("x", 0.0), "x does not change"),
        (scaled(["t"], 1e3), r"t grows by 10 a row: seconds are needed; pass --map t=COLUMN\*ms"),
        (scaled(["t"], 1e6), r"--map t=COLUMN\*us"),
        (
            circle()[::4],
            r"t has 25\.0 rows a second: at least 40 .*RecordInterval of at most 0\.025 s",
        ),
        (circle()[:300], r"lasts 2\.99 s: at least 5 s"),
        (scaled(["qx", "qy", "qz", "qw"], 0.5), r"norm of 0\.5"),
        (scaled(["p", "q", "r"], 180 / np.pi), r"p is 57\.\d times .*--map p=p\*deg"),
        (scaled(["p"], -1), r"p has the opposite sign .*--map p=p\*-1"),
        (changed("p", np.sin(circle()[:, 0] ** 2)), r"p does not follow the attitude"),
        (scaled(["x", "y", "z"], 1e3), r"x moves at .* if these are millimetres, --map x=x\*mm"),
        (scaled(["z"], 1e3), r"z moves at"),
        (scaled(["w1", "w2", "w3", "w4"], 60 / 2 / np.pi), r"if these are 1/min: --map rpm1=w1"),
        (scaled(["w1", "w2", "w3", "w4"], 3.0), r"cf2x hovers at 1739\.2 rad/s: check that cf2x"),
        (scaled(["w1", "w2", "w3", "w4"], 0.0), "w1 does not change"),
    ],
)
def test_broken_logs_are_refused(check, rows, message):
    with pytest.raises(ValueError, match=message):
        check(rows)


def test_a_quaternion_with_its_scalar_first_lies_on_its_back(check):
    rows = circle()
    rows[:, 4:8] = np.roll(rows[:, 4:8], 1, axis=1)
    with pytest.raises(ValueError, match="tilted by 1[78].* the order x, y, z, w"):
        check(rows)


def test_units_of_other_columns(check):
    rows = circle()
    names = (*flown.COLUMNS, "ax", "ay", "az")
    force = np.tile([0.01, 0.0, 1.0], (len(rows), 1)) + 0.01 * np.sin(rows[:, :3] + 1)
    with pytest.raises(ValueError, match=r"ax, ay, az are 1.* hovering drone measures 9\.8"):
        check(np.hstack([rows, force]), names)
    assert "az" in check(np.hstack([rows, force]), names, ["ax=ax*g", "ay=ay*g", "az=az*g"])

    names = (*flown.COLUMNS, "vx", "vy", "vz")
    velocity = np.stack([-np.sin(rows[:, 0]), np.cos(rows[:, 0]), 0.1 * np.cos(rows[:, 0])], 1)
    assert "vx" in check(np.hstack([rows, velocity]), names)
    with pytest.raises(ValueError, match=r"vx is \S+ times the velocity of x .*world axes"):
        check(np.hstack([rows, velocity[:, ::-1]]), names)

    names = tuple(name.replace("w", "rpm") if name[0] == "w" else name for name in flown.COLUMNS)
    with pytest.raises(ValueError, match="if these are rad/s: --map w1=rpm1"):
        check(rows, names)
    names = tuple(name.replace("w", "pwm") if name[0] == "w" else name for name in flown.COLUMNS)
    with pytest.raises(ValueError, match="cf2x takes 20000 to 65535"):
        check(rows, names)


def test_degrees_for_angles(check):
    rows = circle()
    names = ("t", "x", "y", "z", "roll", "pitch", "yaw", "p", "q", "r", "w1", "w2", "w3", "w4")
    angle = 20 * np.sin(2 * rows[:, 0]) * 0.573
    little = 0.01 * np.sin(rows[:, 0])
    angles = np.stack([angle, little, 8 + little], axis=1)
    euler = np.hstack([rows[:, :4], angles, rows[:, 8:]])
    with pytest.raises(ValueError, match=r"roll goes to 11\.\d+: radians .*--map roll=roll\*deg"):
        check(euler, names)
    log = check(euler, names, ["roll=roll*deg", "pitch=pitch*deg", "yaw=yaw*deg"])
    np.testing.assert_allclose(log.columns["qx"], circle()[:, 4], atol=0.01)


def test_small_holes_and_spikes_are_filled_in_and_counted(check):
    rows = holes("y", 200, 205)
    rows[400, 3] = 9.0
    log = check(rows)
    assert log.filled == {"y": 5, "x": 1}
    np.testing.assert_allclose(log.columns["y"], circle()[:, 2], atol=1e-3)
    np.testing.assert_allclose(log.columns["z"], circle()[:, 3], atol=1e-3)


def test_missing_columns_are_named_with_the_nearest(check):
    names = list(flown.COLUMNS)
    names[0], names[12] = "time", "motor_2"
    with pytest.raises(ValueError, match=r"lacks the columns t, w2 \(t: perhaps 'time'; w2: perh"):
        check(circle(), names)
    with pytest.raises(ValueError, match=r"--map w2=motor2: there is no such column; did you mean"):
        check(circle(), names, ["w2=motor2", "t=time"])
    assert check(circle(), names, ["w2=motor_2", "t=time"]).kind == "w"


def test_files_that_are_no_logs(tmp_path):
    path = tmp_path / "log.csv"
    for text, message in (
        ("", "is empty"),
        ("0.0,1.0,2.0\n1,2,3\n", "has no header: its first line begins with 0.0"),
        ("t,x,x\n0,1,2\n", "column 'x' twice"),
        (",".join(flown.COLUMNS) + "\n1,2\n" + ",".join("1" * 15) + "\n", "other numbers of col"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=message):
            read_log(path, {}, 4)
    path.write_bytes(b"\xff\xfe\x00t")
    with pytest.raises(ValueError, match="neither text in UTF-8 nor a known log.*copy it again"):
        read_log(path, {}, 4)
    with pytest.raises(FileNotFoundError, match="no log file"):
        read_log(tmp_path / "none.csv", {}, 4)


def test_columns_in_another_case_are_read(check):
    names = [name.upper() for name in flown.COLUMNS]
    log = check(circle(), names)
    assert log.used["x"] == "X"
    np.testing.assert_array_equal(log.columns["qw"], check(circle()).columns["qw"])
    # A column of the very name comes first
    both = np.column_stack([circle(), np.arange(len(circle()))])
    assert check(both, [*flown.COLUMNS, "X"]).used["x"] == "x"


def test_a_drone_that_stands_does_not_fly(check):
    with pytest.raises(ValueError, match=r"no flight of 0\.5 s: .*z goes from 0\.0099"):
        prepare_log(check(changed("z", 0.01 + 1e-4 * np.sin(circle()[:, 0]))), DRONE, 0.5)


def test_maps():
    assert parse_map(["z=alt*mm-0.03", "q=gyro y*-deg", "x=px"]) == {
        "z": ColumnSource("alt", 1e-3, -0.03),
        "q": ColumnSource("gyro y", -np.pi / 180, 0.0),
        "x": ColumnSource("px"),
    }
    assert parse_map(["vbat=v*2+1e-1"]) == {"vbat": ColumnSource("v", 2.0, 0.1)}
    for text, message in (
        ("z", "NAME=COLUMN"),
        ("z=", "NAME=COLUMN"),
        ("pp=x", "no column is called 'pp'; did you mean 'p'"),
        ("z=a*feet", "the factor is 'feet': a number, or one of deg, g, rpm"),
    ):
        with pytest.raises(ValueError, match=message):
            parse_map([text])
    with pytest.raises(ValueError, match="z is given twice"):
        parse_map(["z=a", "z=b"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--fit", "inertia_w"], "--fit inertia_w: there is no such constant; did you mean"),
        (["--fit", "wake"], "--fit wake needs the columns other_x"),
        (["--fit", "battery"], "--fit battery needs the columns vbat and current"),
        (["--fit", "voltage"], "--fit voltage needs the columns pwm1"),
        (["--mass", "0"], "mass is 0: at least 0.001 is needed"),
        (["--window", "9"], "window is 9: at most 5"),
        (["log.csv"], "the log log.csv is given twice"),
    ],
)
def test_the_command_refuses(words, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    flown.write_example_log("log.csv", circle())
    with pytest.raises(SystemExit) as error:
        main(["identify", "log.csv", *words, "--airframe", "cf2x"])
    assert error.value.code == 2
    assert message in capsys.readouterr().err


HEADER = ",".join(flown.COLUMNS)
ROW = ",".join(["1"] * len(flown.COLUMNS))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEADER, "has no rows below its header"),
        (f"{HEADER}\n\n# nothing\n,,\n", "has no rows below its header"),
        (f"{HEADER.replace(',', ';')}\n1;2\n", "has ';' between its columns"),
        (f"{HEADER}\n{ROW}\n1{ROW},7\n", r"row 3 has 16, the header has 15"),
        (f"{HEADER}\n{ROW[:-2]}\n", r"row 2 has 14, the header has 15"),
        (f"{HEADER}\n{ROW[:-1]}abc\n", "w4 is 'abc' in row 2: a number is needed"),
        (f'{HEADER}\n{ROW[:-1]}"0,5"\n', "w4 is '0,5' in row 2: a number is needed"),
        (f"{HEADER}\n{ROW[:-1]}1_0\n", "w4 is '1_0' in row 2: a number is needed"),
        (f"{HEADER}\n{ROW[:-1]}\u0661\n", "w4 is '\u0661' in row 2: a number is needed"),
        (
            f'{HEADER}\n{ROW[:-1]}"1\n' + "2" * 200_000,
            "is not a CSV file: .*is a quotation mark missing",
        ),
        ("a" * 200_000, "is not a CSV"),
        (",".join(f"c{k}" for k in range(20_000)), "lacks the columns"),
    ],
)
def test_files_that_are_no_such_csv_are_refused(text, message, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=f"log.csv.* {message}"):
        read_log(path, {}, 4)


def test_quotes_comments_and_empty_cells_are_read(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(f'"t",{HEADER[2:]},\n"1",{ROW[2:]},,\n# said\n\n2,,{ROW[4:]},\n')
    log = read_log(
        path, {"z": ColumnSource("y", 1e-3), "x": ColumnSource("x"), "y": ColumnSource("y")}, 4
    )
    assert log.time.tolist() == [1, 2]
    np.testing.assert_equal(log.columns["x"], [1, np.nan])
    assert log.columns["z"].tolist() == [1e-3, 1e-3]
