"""Live worlds in Python."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from conftest import DYING, ROOT

import stemworlds as sw

PLACE = (1.2, 1.2, 2.4, 2.2)


def world(library: str, seed: int = 3, threads: int = 2) -> sw.LiveWorld:
    return sw.LiveWorld("test", grid=(1, 1), set=DYING, seed=seed, most_dose=5e5, cache=library, threads=threads)


def test_recordings_take_atoms_away(library: str) -> None:
    live = world(library)
    before = live.look(PLACE)
    assert before.image.array.dtype == np.float32 and len(before.columns) > 10
    assert before.image.origin_nm[1] == pytest.approx(PLACE[0], abs=0.05)
    recording = live.acquire(region_nm=PLACE, dose=4e5, profile="routine")
    assert recording.array.ndim == 2 and recording.dose == pytest.approx(4e5)
    assert live.dose(PLACE) == pytest.approx(4e5, rel=0.1)
    [told] = live.history
    assert told["lost"]["O"] > 0 and told["number"] == 0
    after = live.look(PLACE)
    assert after.columns["vacancies"].sum() > before.columns["vacancies"].sum()
    assert (after.columns["x_nm"] == before.columns["x_nm"]).all()
    assert not np.array_equal(after.image.array, before.image.array)
    vacant = after.sites["type"] == 1
    assert set(after.sites["number"][vacant]) == {8} and vacant.sum() == after.columns["vacancies"].sum()
    # The image is of whole pixels about the place.
    left, upper, right, lower = PLACE
    x, y = after.columns["x_nm"], after.columns["y_nm"]
    inside = after.columns[(left <= x) & (x <= right) & (upper <= y) & (y <= lower)]
    assert np.array_equal(live.columns(PLACE), inside) and 10 < len(inside) < len(after.columns)
    assert len(live.sites(PLACE)) == inside["sites"].sum()


def test_patterns_of_a_place_show_the_specimen_and_cost_its_dose(library: str) -> None:
    found = []
    for threads in (1, 2):
        live = world(library, threads=threads)
        place = (1.3, 1.2, 1.7, 1.5)
        before = live.look(place)
        cube = live.acquire_patterns(region_nm=place, pixel_nm=0.05, dose=2e5, pixels=64, max_angle_mrad=200.0)
        assert cube.axes.shape == (6, 8, 64, 64) and cube.data.dtype == np.uint32
        assert cube.axes.origin_angstrom == pytest.approx((12.25, 13.25)) and cube.axes.energy_kv == 200.0
        assert cube.axes.electrons_per_pattern == pytest.approx(2e5 * 0.25)
        [done] = live.history
        assert done["shape"] == [6, 8] and done["lost"]["O"] > 0 and live.dose((1.35, 1.25, 1.65, 1.45)) == pytest.approx(2e5, rel=0.05)
        found.append(cube.data)
    assert found[0].tobytes() == found[1].tobytes()
    # The annulus of the world's detector has the brightness of the world's image; other displacements of the atoms make the difference.
    ring = cube.virtual_image(50.0, 90.0).array.mean() / cube.axes.electrons_per_pattern
    (y0, x0), step = before.image.origin_nm, before.image.sampling_nm[0]
    y, x = ((np.arange(n) + 0.5) * 0.05 + first for n, first in ((6, 1.2), (8, 1.3)))
    rows, columns = ((places - first) / step for places, first in ((y, y0), (x, x0)))
    known = before.image.array[np.ix_(rows.round().astype(int), columns.round().astype(int))].mean()
    assert ring == pytest.approx(known, rel=0.1)


def test_patterns_that_a_world_cannot_have_are_refused(library: str) -> None:
    live = world(library)
    with pytest.raises(sw.InvalidValue, match="made for up to 500000"):
        live.acquire_patterns(at_nm=(1.9, 1.9), zoom=2, dose=6e5)
    with pytest.raises(sw.InvalidValue, match="probes inside the field"):
        live.acquire_patterns(region_nm=(-0.5, 1.0, 0.5, 1.2), pixel_nm=0.05, dose=1e3)
    with pytest.raises(sw.InvalidValue, match="leave one of the two out"):
        live.acquire_patterns(at_nm=(1.9, 1.9), pixels=32, radial_mrad=1.0)
    assert live.history == ()


def test_snapshots_and_threads_give_the_same_bytes(library: str) -> None:
    one, two = world(library, threads=1), world(library, threads=2)
    for live in (one, two):
        live.acquire(at_nm=(1.9, 1.9), zoom=2, dose=1e5)
    moment = one.snapshot()
    assert moment == two.snapshot()
    results = [live.acquire(at_nm=(2.0, 1.8), zoom=2, dose=1e5, profile="poor").array for live in (one, two)]
    again = world(library)
    again.restore(moment)
    results.append(again.acquire(at_nm=(2.0, 1.8), zoom=2, dose=1e5, profile="poor").array)
    assert results[0].tobytes() == results[1].tobytes() == results[2].tobytes()


def test_what_is_wrong_is_said(library: str) -> None:
    live = world(library)
    with pytest.raises(sw.InvalidValue, match="made for up to 500000"):
        live.acquire(at_nm=(1.9, 1.9), zoom=2, dose=6e5)
    assert live.history == ()
    with pytest.raises(sw.InvalidValue, match="the field goes from 0, 0"):
        live.look((90, 90, 91, 91))
    for turned in [(4, 1, 4, 4), (4, 4, 1, 1), (float("nan"), 1, 4, 4)]:
        for what in (live.look, live.dose, live.columns):
            with pytest.raises(sw.InvalidValue, match="left < right"):
                what(turned)
    with pytest.raises(sw.InvalidValue, match="no snapshot"):
        live.restore("{}")
    with pytest.raises(sw.InvalidValue, match="another recipe or seed"):
        live.restore(world(library, seed=4).snapshot())
    with pytest.raises(sw.InvalidValue, match="leave the field"):
        live.acquire(at_nm=(99, 1), dose=1)


def test_detectors_record_the_same_electrons(tmp_path: Path) -> None:
    tables = [
        {"name": "HAADF", "inner_mrad": 50.0, "outer_mrad": 90.0},
        {"name": "ADF", "inner_mrad": 45.0, "outer_mrad": 70.0, "acquisition": {"gain_counts": 3.0}},
    ]
    tiny = sw.Recipe(ROOT / "tests/cli/tiny.toml", set={"detector": tables, "damage.radiolysis_barn.O": 60})
    place: dict[str, Any] = {"region_nm": (0.5, 0.5, 0.9, 0.9), "dose": 4e5}
    both = sw.acquire(tiny, **place, out=tmp_path / "both.h5", cache=False)
    assert list(both.detectors) == ["HAADF", "ADF"] and both.detectors["HAADF"] is both
    adf = both.others["ADF"]
    assert adf.image.name == "ADF" and adf.image.units == "counts" and adf.position_in_image is both.position_in_image
    assert (adf.array % 3 == 0).all() and not (both.array % 3 == 0).all()
    with h5py.File(tmp_path / "both.h5") as file:
        assert np.array_equal(file["recording"][()], both.array) and np.array_equal(file["detectors/ADF/recording"][()], adf.array)
    alone = sw.acquire(tiny, **place, detectors=["HAADF"], cache=False)
    assert alone.others == {} and np.array_equal(alone.array, both.array)
    with pytest.raises(sw.InvalidValue, match="the recipe has HAADF, ADF"):
        sw.acquire(tiny, detectors=["BF"])


def test_a_live_world_has_the_chosen_detectors(library: str) -> None:
    # Images of several detectors need another library; that of the main one is shared with the other tests.
    tables = [{"name": "HAADF", "inner_mrad": 50.0, "outer_mrad": 90.0}, {"name": "ADF", "inner_mrad": 45.0, "outer_mrad": 70.0}]
    live = sw.LiveWorld("test", grid=(1, 1), set={**DYING, "detector": tables}, seed=3, most_dose=5e5, cache=library, detectors=["HAADF"])
    before = live.look(PLACE)
    assert list(before.images) == ["HAADF"] and np.array_equal(before.image.array, before.images["HAADF"].array)
    assert list(live.acquire(region_nm=PLACE, dose=1e4).detectors) == ["HAADF"]
