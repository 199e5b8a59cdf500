"""Files of cities."""

import json

import pytest


@pytest.fixture
def geojson(tmp_path):
    def write(*features):
        path = tmp_path / "town.geojson"
        path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
        return path

    return write


@pytest.fixture
def obj(tmp_path):
    def write(text):
        path = tmp_path / "town.obj"
        path.write_text(text)
        return path

    return write
