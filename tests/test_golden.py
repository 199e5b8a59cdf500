import golden
import numpy as np
import pytest

import bulletuav


@pytest.mark.parametrize("task", bulletuav.list_tasks())
def test_the_default_environment_flies_as_it_always_did(task):
    """A change here is a change of the environment's default behaviour.

    Raise its version, then write the file anew.
    """
    flown = golden.fly(task)
    kept = golden.read(golden.FOLDER / f"{task}.npz.xz")
    assert kept.keys() == flown.keys()
    for name, values in kept.items():
        # Observations are float32. Rounding in the file takes its part of the tolerance.
        tolerance = 1e-6 if values.dtype == np.float32 else 1e-9 - golden.ROUNDING
        np.testing.assert_allclose(
            flown[name], values, rtol=tolerance, atol=tolerance, err_msg=name, strict=True
        )
    assert flown["alive"].all()  # the whole trajectory was flown


def test_files_keep_all_bits_of_float32_and_most_of_doubles(tmp_path):
    rng = np.random.default_rng(0)
    size = 10.0 ** rng.uniform(-30, 30, (50, 3, 2)) * rng.choice([-1, 0, 1], (50, 3, 2))
    doubles = np.concatenate([size, np.cumsum(rng.normal(size=(50, 3, 2)), axis=0), -0.0 * size])
    extremes = np.array([[np.inf, -np.inf, 1.0], [-0.0, 3e38, 1e-45]], np.float32)
    flown = {"doubles": doubles, "singles": doubles.astype(np.float32), "extremes": extremes}
    golden.write(tmp_path / "one.npz.xz", flown | {"alive": np.array([True, False])})
    kept = golden.read(tmp_path / "one.npz.xz")
    for name in ("singles", "extremes", "alive"):
        assert kept[name].dtype == (flown | {"alive": kept["alive"]})[name].dtype
    assert np.array_equal(kept["singles"].view(np.int32), flown["singles"].view(np.int32))
    assert np.array_equal(kept["extremes"].view(np.int32), extremes.view(np.int32))
    assert kept["alive"].tolist() == [True, False]
    error = np.abs(kept["doubles"] - doubles)
    assert (error <= golden.ROUNDING * np.abs(doubles)).all()
    assert error.any()
