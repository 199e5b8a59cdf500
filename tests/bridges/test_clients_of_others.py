"""Clients that others wrote fly our drones, unmodified; run by hand (`-m slow -n 0`).

Each is installed into an environment of its own, apart from the package. Servers share ports, so
one test runs at a time.
"""

import contextlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
EXAMPLES = {
    "autonomy/autonomous_sequence": "Setting position (0.0, 0.0, 0.0, 0)",
    "autonomy/autonomous_sequence_high_level": "The sequence is 7.3 seconds long",
    "autonomy/motion_commander_demo": "Doing other work",
    "logging/basiclog": "Disconnected from udp://",
    "logging/basiclog_sync": "stabilizer.yaw",
    "parameters/basicparam": "Disconnected from udp://",
    "parameters/persistent_params": "The new state is:",
    "step-by-step/sbs_connect_log_param": "stabilizer.estimator set at number: 1",
    "step-by-step/sbs_motion_commander": "Deck is attached!",
}
"""Programs that come with cflib, with something that they print when all went well"""


def environment(place, *packages):
    """Make a virtual environment with packages; returns its folder."""
    subprocess.run([sys.executable, "-m", "venv", place], check=True)
    pip = [place / "bin" / "pip", "install", "-q", *packages]
    subprocess.run(pip, check=True, env=alone())
    return place


@pytest.fixture(scope="module")
def cflib(tmp_path_factory):
    return environment(tmp_path_factory.mktemp("cflib") / "venv", "cflib==0.1.34")


@pytest.fixture(scope="module")
def airsim_clients(tmp_path_factory):
    """Clients by name. That of AirSim itself needs to be installed what it does not ask for."""
    needs = ("numpy", "msgpack-rpc-python", "wheel", "setuptools<81", "opencv-python-headless")
    old = environment(tmp_path_factory.mktemp("airsim") / "venv", *needs, "gymnasium")
    pip = [old / "bin" / "pip", "install", "-q", "--no-build-isolation", "airsim==1.8.1"]
    subprocess.run(pip, check=True, env=alone())
    new = environment(tmp_path_factory.mktemp("cosys") / "venv", "cosysairsim==3.5.0", "gymnasium")
    return {"airsim": old, "cosysairsim": new}


@contextlib.contextmanager
def airsim_server(*words):
    """Runs a server of AirSim's calls; returns its port."""
    command = [sys.executable, "-m", "bulletuav", "serve", "airsim", "--port", "0", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=quiet()) as server:
        line = ""
        while " at " not in line:
            line = server.stdout.readline()
            assert server.poll() is None
        try:
            yield line.strip().rsplit(":", 1)[1]
        finally:
            server.terminate()


@pytest.mark.slow
def test_clients_of_airsim_fly_and_repeat_their_flight_to_the_last_bit(airsim_clients, tmp_path):
    """Each twice, with a new server each time: the four hashes are the same."""
    hashes = set()
    for name, place in [*airsim_clients.items()] * 2:
        with airsim_server("--drones", "2", "--lidar") as port:
            program = [place / "bin" / "python", HERE / "airsim_client.py", name, port]
            told = subprocess.run(
                program, capture_output=True, text=True, timeout=200, cwd=tmp_path, env=alone()
            )
        assert told.returncode == 0, told.stdout + told.stderr
        hashes.add(told.stdout.split()[-1])
    assert len(hashes) == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["airsim", "cosysairsim"])
def test_environments_of_airsims_clients_fly(name, airsim_clients, tmp_path):
    page = HERE.parents[1] / "docs" / "howto" / "bridges" / "airsim.md"
    python = airsim_clients[name] / "bin" / "python"
    with airsim_server("--drones", "3", "--paused") as port:
        program = [python, HERE / "airsim_gym_client.py", name, port, page]
        subprocess.run(program, check=True, timeout=400, cwd=tmp_path, env=alone())


@pytest.fixture
def drones():
    """Runs the command that serves ten virtual Crazyflies, at the ports where cflib looks."""
    command = [sys.executable, "-m", "bulletuav", "serve", "crazyflie"]
    command += ["--drones", "10"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=quiet()) as server:
        while "drones at" not in server.stdout.readline():
            assert server.poll() is None
        yield [f"udp://127.0.0.1:{19850 + k}" for k in range(10)]
        server.terminate()


def quiet():
    return {**os.environ, "OMP_NUM_THREADS": "1"}


def alone(**more):
    """Variables for a client, which is not to find what this process finds."""
    return {name: value for name, value in quiet().items() if name != "PYTHONPATH"} | more


@pytest.mark.slow
def test_a_swarm_of_ten_flies_by_cflib(cflib, drones, tmp_path):
    program = [cflib / "bin" / "python", HERE / "cflib_client.py", *drones]
    subprocess.run(program, check=True, cwd=tmp_path, timeout=120, env=alone())


@pytest.mark.slow
@pytest.mark.parametrize("example", EXAMPLES)
def test_examples_of_cflib_run(example, cflib, drones, tmp_path):
    (place,) = cflib.glob("lib/python*/site-packages/examples")
    program = [cflib / "bin" / "python", place / f"{example}.py"]
    told = subprocess.run(
        program,
        cwd=tmp_path,
        env=alone(CFLIB_URI=drones[0]),
        timeout=200,
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
    )
    assert told.returncode == 0, told.stderr
    assert EXAMPLES[example] in told.stdout


@pytest.fixture
def mavsdk(tmp_path):
    """Flies vehicles by a version of MAVSDK; returns what it printed."""

    def mavsdk(version, program, drones, *words):
        place = environment(tmp_path / "venv", f"mavsdk=={version}")
        command = [sys.executable, "-m", "bulletuav", "serve", "mavlink", "--drones", str(drones)]
        command += words
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=quiet()) as server:
            while "vehicles at" not in server.stdout.readline():
                assert server.poll() is None
            ports = [str(14540 + k) for k in range(drones)]
            told = subprocess.run(
                [place / "bin" / "python", "-W", "ignore", HERE / program, *ports],
                capture_output=True,
                text=True,
                timeout=200,
                cwd=tmp_path,
                env=alone(),
            )
            server.terminate()
        assert told.returncode == 0, told.stdout + told.stderr
        return told.stdout

    return mavsdk


@pytest.mark.slow
def test_mavsdk_of_the_third_version_flies_two_vehicles(mavsdk):
    assert mavsdk("3.17.4", "mavsdk_grpc_client.py", 2).endswith("all flew\n")


@pytest.mark.slow
@pytest.mark.parametrize("airframe", ["trainer", "quadplane"])
def test_mavsdk_flies_on_wings(airframe, mavsdk):
    words = ("--airframe", airframe, "--speed", "8")
    assert mavsdk("3.17.4", "mavsdk_wings_client.py", 1, *words).endswith("flew\n")


@pytest.mark.slow
def test_mavsdk_of_the_fourth_version_flies(mavsdk):
    assert "returned, landed, disarmed" in mavsdk("4.1.0", "mavsdk_client.py", 1)
