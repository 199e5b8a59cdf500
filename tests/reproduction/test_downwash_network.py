"""The table of downwash networks, with small made-up networks in PyTorch's files."""

import zipfile

import numpy as np
import pytest

from bulletuav.reproduction import find_reproduction
from bulletuav.reproduction.downwash_networks import (
    LAYER_SHAPES,
    NETWORK_FOLDER,
    predict_downwash,
    read_downwash_network,
)
from bulletuav.reproduction.flight_series import LogError
from bulletuav.reproduction.table import Settings
from bulletuav.reproduction.tables.downwash_network import (
    DROPS_BELOW,
    FLOWN_NETWORK,
    OTHER_NETWORKS,
    QUADROTOR_ARM,
    QUADROTOR_MASS,
)

G = 9.80665


def linear_network(slope=0.0, constant=0.0):
    """A network whose vertical force is slope |x| + constant."""
    weights = [np.zeros(shape) for shape in LAYER_SHAPES]
    weights[0][0, 0], weights[0][1, 0] = 1.0, -1.0
    weights[2][0, :2] = 1.0
    weights[4][0, 0] = 1.0
    weights[6][2, 0] = slope
    weights[7][2] = constant
    return weights


def write_network(path, weights, compression=zipfile.ZIP_STORED):
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w", compression) as archive:
        archive.writestr("model/data.pkl", b"never read")
        for k, values in enumerate(weights):
            archive.writestr(f"model/data/{k}", values.astype("<f4").tobytes())


def test_a_network_is_read_and_computes_what_its_weights_say(tmp_path):
    rng = np.random.default_rng(0)
    weights = [rng.normal(size=shape).astype("<f4") for shape in LAYER_SHAPES]
    write_network(tmp_path / "net.pkl", weights)
    read = read_downwash_network(tmp_path / "net.pkl")
    for one, other in zip(read, weights, strict=True):
        np.testing.assert_array_equal(one, other)
    relative = rng.normal(size=(5, 6))
    expected = []
    for values in relative:
        for k in range(4):
            values = [
                sum(w * v for w, v in zip(line, values, strict=True)) + b
                for line, b in zip(weights[2 * k], weights[2 * k + 1], strict=True)
            ]
            values = values if k == 3 else [max(v, 0.0) for v in values]
        expected.append(values)
    np.testing.assert_allclose(predict_downwash(read, relative), expected, rtol=1e-5)
    linear = predict_downwash(linear_network(2.0, -3.0), np.eye(6)[:2] * [[-0.5], [1.0]])
    np.testing.assert_allclose(linear, [[0.0, 0.0, -2.0], [0.0, 0.0, -3.0]])


def test_broken_networks_end_in_one_clear_error(tmp_path):
    path = tmp_path / "net.pkl"
    path.write_bytes(b"no zip file")
    with pytest.raises(LogError, match="net.pkl: no file of PyTorch; fetch it again"):
        read_downwash_network(path)
    weights = linear_network()
    write_network(path, weights[:-1])
    with pytest.raises(LogError, match=r"net.pkl: array 7 is not of shape \(3,\); fetch"):
        read_downwash_network(path)
    write_network(path, [np.zeros(10**6), *weights[1:]], zipfile.ZIP_DEFLATED)
    with pytest.raises(LogError, match=r"array 0 is not of shape \(128, 6\)"):
        read_downwash_network(path)
    for compression in (zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA):
        write_network(path, weights, compression)
        content = bytearray(path.read_bytes())
        # The first array follows the entry data.pkl and its own header
        start = content.index(b"model/data/0") + 30
        content[start : start + 40] = bytes(40 * [0xA5])
        path.write_bytes(content)
        with pytest.raises(LogError, match="net.pkl: no file of PyTorch; fetch it again"):
            read_downwash_network(path)
    write_network(path, weights)
    content = bytearray(path.read_bytes())
    # Bit 0 of the flags in the directory: encrypted
    for at in (k for k in range(len(content)) if content[k : k + 4] == b"PK\x01\x02"):
        content[at + 8] |= 1
    path.write_bytes(content)
    with pytest.raises(LogError, match="net.pkl: no file of PyTorch; fetch it again"):
        read_downwash_network(path)
    weights[3][5] = np.nan
    write_network(path, weights)
    with pytest.raises(LogError, match="a weight is not finite"):
        read_downwash_network(path)


def test_the_table_of_made_up_networks(tmp_path):
    folder = tmp_path / NETWORK_FOLDER
    write_network(folder / FLOWN_NETWORK, linear_network(5.0, -4.0))
    for name, constant in zip(OTHER_NETWORKS, (-1.0, -2.0, -3.0), strict=True):
        write_network(folder / name, linear_network(0.0, constant))
    outcome = find_reproduction("downwash-network").compute(Settings(size=0.01, data=tmp_path))
    rows = {row.name: row for row in outcome.rows}
    assert len(rows) == 18
    named = "downward force {:g} m below, {:g} m aside (published: network)"
    axis = rows[named.format(0.7, 0.0)]
    assert axis.published == pytest.approx(4.0)
    # The formula of the law by hand
    width = np.hypot(QUADROTOR_ARM, 0.1 * 0.7)
    force = 0.32 * QUADROTOR_MASS * G * QUADROTOR_ARM / width
    assert axis.ours == pytest.approx(force, rel=1e-6)
    aside = rows[named.format(0.7, 0.2)]
    assert aside.ours == pytest.approx(force * np.exp(-0.5 * (0.2 / width) ** 2), rel=1e-6)
    # Four directions: |x| is 0.2 in two of them
    assert aside.published == pytest.approx(4.0 - 5.0 * 0.1)
    assert {row.verdict for row in rows.values()} == {"not comparable"}
    # Networks give 4 - 5 |x|, 1, 2 and 3 N: |x| is 0, 0.1 and 0.2 m on average
    ends = {0.0: (1.0, 4.0), 0.2: (1.0, 3.5), 0.4: (1.0, 3.0)}
    count = sum(
        ends[aside][0] <= rows[named.format(drop, aside)].ours <= ends[aside][1]
        for drop in DROPS_BELOW
        for aside in ends
    )
    assert 0 < count < 18
    notes = " ".join(outcome.notes)
    assert f"in {count} of 18 places" in notes
    assert "differ by 3.0 N on the axis" in notes
    write_network(folder / OTHER_NETWORKS[0], [])
    with pytest.raises(LogError, match="SN=0"):
        find_reproduction("downwash-network").compute(Settings(size=0.01, data=tmp_path))
