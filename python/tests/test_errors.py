"""Bad input of every kind gives the right exception, which says what to do."""

from __future__ import annotations

import os
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT, TINY

import stemworlds as sw
from stemworlds import _core, errors

SI = ROOT / "structures/si.cif"

BAD_VALUES: list[tuple[str, Callable[[Any], Any], str]] = [
    ("energy_kv", lambda si: sw.simulate(si, energy_kv=200e3), "did you mean 200"),
    ("energy_kv", lambda si: sw.simulate(si, energy_kv=-3), "between"),
    ("semiangle_mrad", lambda si: sw.simulate(si, semiangle_mrad=0.021), "did you mean 21"),
    ("detectors", lambda si: sw.simulate(si, detectors={"a": (0.068, 0.2)}), "did you mean"),
    ("detectors", lambda si: sw.simulate(si, detectors={"a": (200, 68)}), "outer angle"),
    ("detectors", lambda si: sw.simulate(si, detectors={}), "at least one"),
    ("aberrations", lambda si: sw.simulate(si, aberrations={"C99": 3}), "C12=30@0.3"),
    ("aberrations", lambda si: sw.simulate(si, aberrations={"C10": 3}, defocus_angstrom=2), "C10 is minus the defocus"),
    ("tilt_mrad", lambda si: sw.simulate(si, tilt_mrad=(30, 0)), "-20 to 20"),
    ("phonons", lambda si: sw.simulate(si, sigma=0.08), "number of phonon configurations"),
    ("phonons", lambda si: sw.simulate(si, sigma=0.08, phonons=0), "at least 1"),
    ("sigma", lambda si: sw.simulate(si, phonons=2), "standard deviation"),
    ("sigma", lambda si: sw.simulate(si, phonons=2, sigma={"O": 0.1}), "none for Si"),
    ("sigma", lambda si: sw.simulate(si, phonons=2, sigma=7.0), "from 0 to 1 A"),
    ("repeat", lambda si: sw.simulate(si, repeat=(0, 1, 1)), "whole number"),
    ("zone", lambda si: sw.simulate(SI, zone=(0, 0, 0)), "zone"),
    ("zone", lambda si: sw.simulate(SI, zone=(1.5, 0, 0)), "whole number"),
    ("engine", lambda si: sw.simulate(si, engine="gpu"), "multislice"),
    ("window_angstrom", lambda si: sw.simulate(si, engine="prism", window_angstrom=8), "window"),
    ("gpts", lambda si: sw.simulate(si, sampling_angstrom=0.1, gpts=(64, 64)), "give one"),
    ("sampling_angstrom", lambda si: sw.simulate(si, sampling_angstrom=0.1), "use a sampling of"),
    ("scan", lambda si: sw.simulate(si, scan=sw.Scan(start=(0.5, 0.5), end=(0.1, 1))), "right of and below"),
    ("scan", lambda si: sw.simulate(si, scan=sw.Scan(end=(5, 1))), "a longer scan shows it again"),
    ("scan", lambda si: sw.simulate(si, scan=sw.Scan(step_angstrom=-1)), "above 0"),
    ("dose", lambda si: sw.simulate(si, dose=-1), "above 0"),
    ("dose", lambda si: sw.simulate(si, dose=1e15), "more than can be counted"),
    ("zone", lambda si: sw.simulate(SI, zone=(1, 1, 1, 0)), "must add to 0"),
    ("max_strain_percent", lambda si: sw.simulate(SI, max_strain_percent=50, zone=(1, 1, 0)), "0 to 10 per cent"),
    ("scan", lambda si: sw.simulate_probes(si, [(1e6, 0)]), "more than one cell outside"),
    ("atoms", lambda si: sw.simulate(si + si[:1]), "together occupy more than one site"),
    ("atoms", lambda si: sw.simulate(sw.AtomArrays(si.numbers, si.positions, 0 * si.cell.array)), "cell"),
    ("threads", lambda si: sw.simulate(si, threads=0), "1 to 4096"),
    ("progress", lambda si: sw.simulate(si, progress="yes"), "a function"),
    ("seed", lambda si: sw.simulate(si, seed=-1), "whole number"),
    ("atoms", lambda si: sw.simulate(3), "ase.Atoms"),
    ("atoms", lambda si: sw.simulate(si[:0]), "no atoms"),
    ("recipe", lambda si: sw.Recipe("srtio"), "did you mean `srtio3`"),
    ("difficulty", lambda si: sw.Recipe("srtio3"), '"easy", "medium", "hard"'),
    ("difficulty", lambda si: sw.Recipe("srtio3", "simple"), '"easy"'),
    ("grid", lambda si: sw.Recipe("test", grid=(99, 1)), "use 1x1 to"),
    ("acquisition", lambda si: sw.Recipe("test", acquisition="good"), '"routine"'),
    ("profile", lambda si: sw.build("test", out="w.h5", profile="fast"), '"published"'),
    ("interpolation", lambda si: sw.build("test", out="w.h5", window_angstrom=7, interpolation=2), "choose one"),
    ("out", lambda si: sw.view("test", out="w.jpg"), ".png"),
    ("out", lambda si: sw.build("test", out="w.tif", cache=False, **TINY), "did you mean w.h5?"),
    ("detectors", lambda si: sw.simulate(si, detectors={"a/b": (68, 200)}), "letters, digits"),
    ("thicknesses_angstrom", lambda si: sw.plane_wave(si, thicknesses_angstrom=[2, 4]), "exit surface only"),
    ("engine", lambda si: sw.plane_wave(si, interpolation=2), "propagated by multislice"),
    ("dose", lambda si: sw.simulate(si, dose=1e12), "more than can be counted"),
    ("region_nm", lambda si: sw.specimen("test", (1, 1, 0, 2)), "within"),
    ("alpha", lambda si: sw.compare("a.h5", "b.h5", alpha=7), "a probability between 0.0001 and 0.5"),
]


@pytest.mark.parametrize(("keyword", "bad", "told"), BAD_VALUES)
def test_bad_values_name_their_argument(
    keyword: str, bad: Callable[[Any], Any], told: str, silicon: Any, world_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if keyword == "alpha":
        for name in ("a.h5", "b.h5"):
            shutil.copy(world_path, name)
    with pytest.raises(ValueError) as caught:
        bad(silicon)
    assert isinstance(caught.value, sw.InvalidValue) and isinstance(caught.value, sw.StemworldsError)
    assert told in str(caught.value)
    assert keyword in (caught.value.keyword or "") or keyword in str(caught.value)
    assert "--" not in str(caught.value)
    assert not list(tmp_path.glob("w.*")), "nothing was written"


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"vacancies.rate": 2}, "vacancies.rate = 2"),
        ({"vacancies.rat": 0.1}, "did you mean `rate`"),
        ({"vacancies.rate": "much"}, "vacancies.rate"),
        ({"nothing": 1}, "unknown key"),
        ({"phonons.sigma_angstrom": {"Xx": 0.1}}, "Xx"),
        ({"field.thickness_nm": float("nan")}, "thickness_nm"),
    ],
)
def test_bad_recipes_name_their_key(changes: dict[str, Any], told: str) -> None:
    with pytest.raises(sw.InvalidValue) as caught:
        sw.Recipe("test", set=changes)
    assert told in str(caught.value)


@pytest.mark.parametrize("value", ["much", None, [1], {"a": 1}])
def test_wrong_types_are_type_errors(value: Any, silicon: Any) -> None:
    with pytest.raises(TypeError) as caught:
        sw.simulate(silicon, energy_kv=value)
    assert isinstance(caught.value, errors.WrongType) and "energy_kv" in str(caught.value)
    with pytest.raises(TypeError, match="unexpected keyword argument 'energy'"):
        sw.simulate(silicon, energy=200)


def test_errors_of_callbacks_come_through(silicon: Any) -> None:
    def callback(*_: object) -> None:
        raise TypeError("argument 'mine'")

    with pytest.raises(TypeError, match="argument 'mine'"):
        sw.simulate(silicon, progress=callback)


def test_files(tmp_path: Path, world_path: Path, silicon: Any) -> None:
    with pytest.raises(FileNotFoundError) as missing:
        sw.World(tmp_path / "missing.h5")
    assert isinstance(missing.value, errors.FileMissing) and missing.value.filename == str(tmp_path / "missing.h5")
    with pytest.raises(FileNotFoundError):
        sw.simulate(tmp_path / "missing.cif")
    with pytest.raises(FileNotFoundError):
        sw.build("test", out="/proc/nothing/w.h5", cache=False, **TINY)
    text = tmp_path / "text.h5"
    text.write_text("no HDF5")
    damaged = tmp_path / "cut.h5"
    damaged.write_bytes(world_path.read_bytes()[:20000])
    (tmp_path / "bad.cif").write_text("no CIF")
    (tmp_path / "bad.toml").write_text("version = ")
    for bad in (
        lambda: sw.World(text),
        lambda: sw.World(damaged),
        lambda: sw.World(damaged, check=True),
        lambda: sw.simulate(tmp_path / "bad.cif"),
        lambda: sw.Recipe(tmp_path / "bad.toml"),
    ):
        with pytest.raises(sw.FormatError) as caught:
            bad()
        assert isinstance(caught.value, (OSError, ValueError)) and str(tmp_path) in str(caught.value)
    image = sw.simulate(silicon, scan=sw.Scan(points=(2, 2)))
    image.to_tiff(tmp_path / "a.tif")
    with pytest.raises(FileExistsError) as there:
        image.to_tiff(tmp_path / "a.tif")
    assert there.value.keyword == "overwrite"
    with pytest.raises(FileNotFoundError):
        image.to_hspy("/proc/nothing/a.hspy")
    assert sw.World(world_path, check=True).grid == (1, 2)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_folders_that_may_not_be_written(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(PermissionError):
        sw.build("test", out=tmp_path / "w.h5", cache=False, **TINY)


def test_tiles_and_regions_outside(world_path: Path) -> None:
    world = sw.World(world_path)
    for bad in (lambda: world.tile(5, 0), lambda: world.tile(-1, 0), lambda: world.image((50, 50, 60, 60))):
        with pytest.raises(sw.InvalidValue):
            bad()
    with pytest.raises(sw.InvalidValue, match="a world has its recipe"):
        sw.acquire(world, grid=(1, 1))


def test_every_setting_of_the_library_has_a_keyword_or_none() -> None:
    assert set(errors._KEYWORDS) == set(_core.settings())


def test_exceptions_can_be_pickled() -> None:
    with pytest.raises(sw.InvalidValue) as caught:
        sw.Recipe("nothing")
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value) and again.keyword == "recipe"
