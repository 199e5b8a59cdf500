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
    with np.load(golden.FOLDER / f"{task}.npz") as kept:
        assert set(kept.files) == set(flown)
        for name in kept.files:
            tolerance = (
                1e-9 if flown[name].dtype == np.float64 else 1e-6
            )  # observations are float32
            np.testing.assert_allclose(
                flown[name], kept[name], rtol=tolerance, atol=tolerance, err_msg=name
            )
    assert flown["alive"].all()  # the whole trajectory was flown
