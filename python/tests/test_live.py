"""Live worlds in Python."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import DYING

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
