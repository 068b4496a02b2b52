"""The library that comes along, here as a package of data."""

from __future__ import annotations

from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import gymnasium as gym
import pytest

import stemworlds as sw
import stemworlds.bench


data = find_spec("stemworlds_library")
pytestmark = pytest.mark.skipif(data is None, reason="stemworlds-library is not installed")


def test_the_package_of_data_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    held = {holding.material: holding.images for holding in sw.cache.library()}
    assert set(held) == {"batio3", "gan", "graphene", "mos2", "sige", "srtio3", "wse2"}
    assert min(held.values()) > 100
    folder = sw.cache.library_path()
    assert data is not None and data.submodule_search_locations is not None
    assert folder == data.submodule_search_locations[0]
    assert {path.name for path in Path(folder).glob("*.stemlib")} == {f"{material}.stemlib" for material in held}
    # The extra `library` asks for this version of the numerics.
    asked = [line for line in Path("python/pyproject.toml").read_text().splitlines() if line.startswith("library = ")]
    assert asked == [f'library = ["stemworlds-library=={version("stemworlds-library").split(".")[0]}.*"]']
    monkeypatch.setenv("STEMGEN_LIBRARY", "")
    assert sw.cache.library() == () and sw.cache.library_path() is None


def test_worlds_are_made_from_it(tmp_path: Path) -> None:
    before = sw.cache.list()
    world = sw.build("srtio3", difficulty="hard", grid=(2, 2), out=tmp_path / "w.h5")
    assert world.summary is not None
    images, simulated = world.summary["library"]
    assert images > 50 and simulated == 0 and world.summary["engine"] == "mosaic"
    with gym.make("stemworlds/DefectCensus-v0", recipe="sige", difficulty="medium", live=True) as env:
        for seed in range(3):
            env.reset(seed=seed)
            env.action_space.seed(seed)
            env.step(env.action_space.sample())
    assert sw.cache.list() == before
