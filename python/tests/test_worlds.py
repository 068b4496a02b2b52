"""Worlds: built, read, and beside h5py."""

from __future__ import annotations

import multiprocessing
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from conftest import LONGEST_S, ROOT, TINY, command

import stemworlds as sw


def datasets(path: Path) -> dict[str, bytes]:
    """Bytes of all datasets but what tells of the run."""
    found: dict[str, bytes] = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.update({name: item[()].tobytes()}) if isinstance(item, h5py.Dataset) else None)
    return found


def test_bytes_are_those_of_the_command_line(tmp_path: Path, world_path: Path) -> None:
    changes = [f"--set={key}={value}" for key, value in TINY["set"].items()]
    command(
        *("build", "test", "--grid", "1x2", "--seed", TINY["seed"], *changes),
        *("--keep-clean", "--audit", 0, "--no-cache", "--quiet", "-o", "cli.h5"),
        cwd=tmp_path,
    )
    ours, theirs = datasets(world_path), datasets(tmp_path / "cli.h5")
    assert len(ours) > 15 and ours.keys() == theirs.keys()
    assert [name for name in ours if ours[name] != theirs[name]] == []


def test_a_world_reads_as_h5py_reads_it(world_path: Path) -> None:
    with sw.World(world_path) as world, h5py.File(world_path) as file:
        assert world.grid == (1, 2) and world.shape == (128, 252)
        assert world.tile(0, 1).array.tobytes() == file["tiles/0_1"][:].tobytes()
        assert world.tile(0, 1, clean=True).array.tobytes() == file["clean/0_1"][:].tobytes()
        whole = world.image()
        assert whole.array[:, 124:].tobytes() == world.tile(0, 1).array.tobytes()
        assert world.tile(0, 1).origin_nm == pytest.approx((0, 124 * world.pixel_nm))
        truth = file["ground_truth"]
        sites = world.sites
        np.testing.assert_array_equal(np.stack([sites["x_nm"], sites["y_nm"]], 1), truth["atom_positions"][:])
        for ours, theirs in (("type", "atom_types"), ("defect", "defect_mask"), ("number", "atomic_numbers"), ("column", "atom_columns")):
            np.testing.assert_array_equal(sites[ours], truth[theirs][:])
        np.testing.assert_array_equal(world.defect_names, truth["defect_types"][:])
        columns = world.columns
        np.testing.assert_array_equal(columns["vacancies"], truth["columns/vacancies"][:])
        np.testing.assert_array_equal(columns["composition"].astype("S"), truth["columns/composition"][:])
        assert (sites["type"] == 1).sum() == columns["vacancies"].sum() > 0
        assert world.phase_map is None and len(world.particles) == 0
        assert world.metadata.noise is True and world.metadata.seed == TINY["seed"]
        assert world.recipe == sw.Recipe("test", **TINY)


def test_regions_and_tables(world_path: Path) -> None:
    world = sw.World(world_path)
    region = (1.0, 0.5, 3.0, 2.0)
    image = world.image(region)
    first = tuple(round(v / world.pixel_nm) for v in image.origin_nm)
    rows, columns = image.array.shape
    np.testing.assert_array_equal(image.array, world.image().array[first[0] : first[0] + rows, first[1] : first[1] + columns])
    table = world.truth_table(region)
    assert 0 < len(table) < len(world.columns)
    np.testing.assert_allclose(table["x_px"], (table["x_nm"] - image.origin_nm[1]) / world.pixel_nm, atol=1e-3)
    inside = (table["x_px"] >= -0.5) & (table["x_px"] <= columns - 0.5) & (table["y_px"] >= -0.5) & (table["y_px"] <= rows - 0.5)
    assert inside.all()
    np.testing.assert_array_equal(table["class"], 1 + (table["vacancies"] > 0))
    # Bright columns are where the truth says.
    clean = world.image(clean=True).array
    heavy = world.truth_table().array
    heavy = heavy[np.char.find(heavy["composition"], "Sr") >= 0]
    inner = (heavy["x_px"] > 1) & (heavy["x_px"] < 250) & (heavy["y_px"] > 1) & (heavy["y_px"] < 126)
    at = clean[np.rint(heavy["y_px"][inner]).astype(int), np.rint(heavy["x_px"][inner]).astype(int)]
    assert np.median(at) > 3 * np.median(clean)


def test_phases_and_boundaries(tmp_path: Path) -> None:
    small = {"field.thickness_nm": 0.4, "phonons.configurations": 1, "field.fov_nm": [5.16, 5.16], "field.grid": [2, 2]}
    recipe = sw.Recipe("batio3", "easy", set={**small, "domains.sharpness_sigma_px": 8.0})
    world = sw.build(recipe, out=tmp_path / "phases.h5", audit=0)
    phases = world.phase_map
    assert phases is not None and phases.shape == world.shape
    assert world.metadata.phases == ("cubic", "tetragonal") and set(np.unique(phases)) == {0, 1}
    assert any(text.startswith("phase boundary") for text, _ in world.boundaries)
    table = world.truth_table()
    assert set(np.unique(table["phase"])) == {0, 1}


def test_the_same_file_is_open_in_h5py_in_either_order(world_path: Path) -> None:
    programs = (
        "import h5py, stemworlds as sw; f = h5py.File({p!r}); w = sw.World({p!r})",
        "import stemworlds as sw; w = sw.World({p!r}); w.tile(0, 0); import h5py; f = h5py.File({p!r})",
    )
    check = "; assert (f['tiles/0_1'][:] == w.tile(0, 1).array).all(); f.close(); assert w.columns.size; print('ok')"
    for program in programs:
        text = (program + check).format(p=str(world_path))
        done = subprocess.run([sys.executable, "-c", text], text=True, capture_output=True, timeout=LONGEST_S)
        assert done.stdout == "ok\n", done.stderr


def tile_sum(path: Path) -> float:
    return float(sw.World(path).tile(0, 0).array.sum())


def simulated_sum(world: sw.World) -> float:
    """In a child: a world that came with the fork, or by pickle, and a computation in threads."""
    image = sw.acquire("test", region_nm=(1.0, 1.0, 1.3, 1.3), threads=2, **TINY)
    return float(world.tile(0, 1).array.sum()) + float(image.ideal.array.sum())


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_workers_work(world_path: Path, method: str) -> None:
    world = sw.World(world_path)
    expected = [tile_sum(world_path), simulated_sum(world)]  # also starts threads before the fork
    with multiprocessing.get_context(method).Pool(1) as pool:
        found = [pool.apply_async(tile_sum, (world_path,)), pool.apply_async(simulated_sum, (world,))]
        assert [result.get(timeout=LONGEST_S) for result in found] == expected
    assert pickle.loads(pickle.dumps(world)).grid == world.grid


def test_a_finished_build_is_not_replaced(world_path: Path) -> None:
    before = world_path.read_bytes()
    with pytest.raises(FileExistsError):
        sw.build("test", out=world_path, cache=False, audit=0, **TINY)
    assert world_path.read_bytes() == before


def test_a_plan_tells_what_a_build_takes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    plan = sw.plan("test", cache=False, audit=0, **TINY)
    assert plan.grid == (1, 2) and plan.shape == (128, 252) and plan.configurations == 2
    assert plan.memory_bytes > 0 and plan.disk_bytes > 0
    assert list(tmp_path.iterdir()) == [], "nothing was written"


def test_pictures_and_pages(world_path: Path, tmp_path: Path) -> None:
    world = sw.World(world_path)
    sw.view(world, out=tmp_path / "w.png", overlays=["defects"], region_nm=(0, 0, 2, 2), size=256)
    sw.view(world_path, out=tmp_path / "w.html")
    sw.view("test", out=tmp_path / "specimen.png", **TINY)
    for name in ("w.png", "specimen.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    assert "<html" in (tmp_path / "w.html").read_text()[:200].lower()
    assert "data:image/png" in world._repr_html_() and "<figure>" in world.tile(0, 0)._repr_html_()
    with pytest.raises(FileExistsError):
        sw.view(world, out=tmp_path / "w.png")


@pytest.mark.long
def test_detectors_have_names(tmp_path: Path, world_path: Path) -> None:
    angles = {"HAADF": (50.0, 90.0), "ABF": (11.0, 21.0)}
    tables = [{"name": name, "inner_mrad": low, "outer_mrad": high} for name, (low, high) in angles.items()]
    path = tmp_path / "two.h5"
    options: dict[str, Any] = {"set": {"field.thickness_nm": 0.4, "boundaries.count": 0, "detector": tables}, "grid": (1, 1), "seed": 5}
    with sw.build("test", out=path, keep_clean=True, audit=0, **options) as world:
        assert list(world.detectors.items()) == list(angles.items())
        with h5py.File(path) as file:
            abf, main = file["detectors/ABF"], file["tiles/0_0"][()]
            assert np.array_equal(world.tile(0, 0).array, main)
            assert np.array_equal(world.tile(0, 0, detector="HAADF").array, main)
            assert np.array_equal(world.tile(0, 0, detector="ABF").array, abf["tiles/0_0"][()])
            assert np.array_equal(world.tile(0, 0, detector="ABF", clean=True).array, abf["clean/0_0"][()])
            scale, offset = (abf["tiles"].attrs[name] for name in ("scale", "offset"))
            image = world.image(detector="ABF")
            assert np.array_equal(image.array, abf["tiles/0_0"][()])
            assert np.allclose(world.fractions(image, detector="ABF"), image.array * scale + offset)
            assert np.array_equal(world.overview(detector="ABF").array, abf["overview"][()])
        with pytest.raises(sw.StemworldsError, match="no detector `BF`; it has HAADF, ABF"):
            world.tile(0, 0, detector="BF")
    one = sw.World(world_path)
    assert one.detectors == {}
    with pytest.raises(sw.StemworldsError, match="one detector without a name"):
        one.image(detector="ABF")


def test_damaged_files_are_read_elsewhere_first(tmp_path: Path, world_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checked: list[str] = []
    whole = sw.checking.check_file

    def check(path: str) -> None:
        checked.append(path)
        whole(path)

    monkeypatch.setattr(sw.checking, "check_file", check)
    path = str(world_path)
    assert sw.verify(path).sound and sw.compare(path, path).verdict == "same"
    assert checked == [path] * 3
    sw.audit(path, regions=1, size_nm=0.5, configurations=1)
    sw.audit(sw.World(path), regions=1, size_nm=0.5, configurations=1)
    assert checked == [path] * 4
    assert sw.verify(path, check=False).sound and len(checked) == 4
    cut = tmp_path / "cut.h5"
    cut.write_bytes(world_path.read_bytes()[: world_path.stat().st_size // 2])
    assert list(sw.verify(cut).faults) == ["schema"]
    for use in (sw.audit, lambda other: sw.compare(path, other)):
        with pytest.raises(sw.FormatError, match="cut.h5"):
            use(cut)


def test_audits_and_comparisons(world_path: Path, tmp_path: Path) -> None:
    audit = sw.audit(world_path, regions=1, size_nm=0.5, configurations=1)
    assert audit.regions == 1 and 0 < audit.all_rms_percent < 5
    same = sw.compare(world_path, world_path, out=tmp_path / "compare.html")
    assert same.verdict == "same" and same.summary and same.different == ()
    assert (tmp_path / "compare.html").stat().st_size > 1000


def test_a_world_is_verified(world_path: Path, tmp_path: Path) -> None:
    found = sw.verify(world_path)
    assert found.sound and found.faults == {} and set(found.details) >= {"tiles", "sites", "columns", "counts"}
    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes(world_path.read_bytes())
    with h5py.File(damaged, "r+") as file:
        file["ground_truth/atom_types"][3] = 7
    assert list(sw.verify(damaged).faults) == ["sites"]
    with pytest.raises(FileNotFoundError):
        sw.verify(tmp_path / "nothing.h5")


def test_validation_runs_cases(tmp_path: Path) -> None:
    names = sw.validation_cases()
    assert len(names) > 5
    quick = next(name for name in names if name.startswith("kirkland"))
    found = sw.validate([quick], out=tmp_path / "v.html")
    assert found.passed and found.failed == () and len(found.details["cases"]) == 1
    with pytest.raises(sw.InvalidValue, match="known cases"):
        sw.validate(["nothing"])


def test_recordings(world_path: Path, tmp_path: Path) -> None:
    place = {"region_nm": (1.2, 1.2, 2.4, 2.2), "dose": 1e4}
    made = sw.acquire(world_path, profile="routine", frames=2, keep_frames=True, out=tmp_path / "r.h5", **place)
    assert made.array.shape == (2, *made.ideal.array.shape) and len(made.columns) > 0
    assert made.dose == pytest.approx(1e4)
    with h5py.File(tmp_path / "r.h5") as file:
        np.testing.assert_array_equal(file["recording"][:], made.array)
    ideal = sw.acquire(world_path, **place)
    still = sw.acquire(world_path, acquisition={"drift_nm_per_s": (0.5, 0.0)}, **place)
    assert np.abs(still.drift[-1, 1:]).max() > 0.005 > np.abs(ideal.drift).max(axis=0)[1]
    assert not np.array_equal(ideal.array, still.array)


def test_the_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEMGEN_CACHE", str(tmp_path / "cache"))
    assert sw.cache.path() == str(tmp_path / "cache") and sw.cache.list() == ()
    with pytest.raises(sw.InvalidValue, match="holds nothing"):
        sw.cache.clear("srtio3")
    assert sw.cache.clear() == ()


def test_parts_make_the_same_world(tmp_path: Path) -> None:
    mosaic: dict[str, Any] = {
        "set": {"field.thickness_nm": 0.4, "phonons.configurations": 1},
        "grid": (1, 1),
        "engine": "window",
        "audit": 0,
        "subtile_nm": 1.0,
        "subtile_overlap_nm": 0.1,
    }
    sw.build("test", out=tmp_path / "whole.h5", **mosaic).close()
    for shard in ((1, 2), (0, 2)):
        part = sw.build_part("test", out=tmp_path / "parts.h5", shard=shard, **mosaic)
        assert part.shard == shard and part.library_lacks == 0
        assert part.subtiles > 1 and part.subtiles_resumed == 0
    with sw.build("test", out=tmp_path / "parts.h5", **mosaic) as world:
        assert world.summary["subtiles_resumed"] == world.summary["subtiles"]
    assert datasets(tmp_path / "parts.h5") == datasets(tmp_path / "whole.h5")
    with pytest.raises(sw.InvalidValue, match="0/2 to 1/2"):
        sw.build_part("test", out=tmp_path / "more.h5", shard=(2, 2), **mosaic)
    with pytest.raises(sw.errors.FileThere, match="parts.h5"):
        sw.build_part("test", out=tmp_path / "parts.h5", shard=(0, 2), **mosaic)


def test_a_library_travels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEMGEN_CACHE", str(tmp_path / "cache"))
    mosaic: dict[str, Any] = {"set": {"field.thickness_nm": 0.4, "phonons.configurations": 1, "boundaries.count": 0}, "engine": "mosaic", "window_angstrom": 5.0}
    sw.build("test", out=tmp_path / "w.h5", grid=(1, 1), audit=0, **mosaic).close()
    (held,) = sw.cache.list()
    file = tmp_path / "test.stemlib"
    assert sw.cache.export_library(file) == {"test": held}
    with pytest.raises(sw.errors.FileThere, match="test.stemlib"):
        sw.cache.export_library(file)
    monkeypatch.setenv("STEMGEN_CACHE", str(tmp_path / "elsewhere"))
    assert sw.cache.list() == ()
    assert sw.cache.import_library(file) == {"test": held}
    assert sw.cache.list() == (held,)
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(sw.FormatError, match="copy it again"):
        sw.cache.import_library(file)


def test_a_cache_is_filled_in_parts_and_verified(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEMGEN_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("STEMGEN_LIBRARY", "")
    thin = {"field.thickness_nm": 0.4, "optics.convergence_mrad": 10, "phonons.configurations": 1, "boundaries.count": 0}
    recipe = sw.Recipe("srtio3", "easy", set=thin)
    first = sw.cache.fill(recipe, shard=(1, 16))
    assert 0 < first.simulated < first.images == first.simulated + first.lacking
    assert sw.cache.fill(recipe, shard=(1, 16)) == sw.cache.Filling(first.images, 0, first.lacking)
    second = sw.cache.fill(recipe, shard=(2, 16))
    assert second.lacking == first.lacking - second.simulated < first.lacking
    (held,) = sw.cache.list()
    found = sw.cache.verify("srtio3")
    assert found.sound and found.images == held.images == first.simulated + second.simulated and found.supplied == 0
    file = next(path for path in (tmp_path / "cache").rglob("*") if path.is_file() and path.stat().st_size > 1000)
    file.write_bytes(file.read_bytes()[:-1])
    found = sw.cache.verify()
    assert not found.sound and list(found.damaged) == [str(file)]
    with pytest.raises(sw.InvalidValue, match="holds srtio3"):
        sw.cache.verify("gan")
    with pytest.raises(sw.InvalidValue, match="recompute takes the name"):
        sw.cache.verify(recompute=1)
    with pytest.raises(sw.StemworldsError, match=r"sw\.cache\.fill makes them"):
        sw.cache.verify("srtio3", recompute=1, difficulty="easy")
    with pytest.raises(sw.InvalidValue, match="0/2 to 1/2"):
        sw.cache.fill(recipe, shard=(2, 2))
    # Films share nothing.
    assert sw.cache.fill("pt", "easy") == sw.cache.Filling(0, 0, 0)


def test_centre_of_mass_of_a_world(tmp_path: Path) -> None:
    haadf = {"name": "HAADF", "inner_mrad": 50.0, "outer_mrad": 90.0}
    com = {"name": "COM", "inner_mrad": 0.0, "outer_mrad": 25.0, "centre_of_mass": True}
    field = {"fov_nm": [1.0, 1.0], "grid": [1, 1], "tile_px": 12, "overlap_px": 0, "thickness_nm": 0.8}
    recipe = sw.Recipe(ROOT / "tests/cli/tiny.toml", set={"detector": [haadf, com], "field": field})
    with sw.build(recipe, out=tmp_path / "com.h5", audit=0, keep_clean=True, engine="window", window_angstrom=5.0) as world:
        assert world.metadata.centres_of_mass == {"COM_x": "x", "COM_y": "y"}
        image = world.image(clean=True, detector="COM_y")
        assert image.units == "mrad" and image.array.min() < 0 < image.array.max()
        angles = world.fractions(world.image(detector="COM_y"), detector="COM_y")
        assert 0 < np.abs(angles - image.array).mean() < 1


def test_layers_dislocations_and_particles_of_a_stack(tmp_path: Path) -> None:
    haadf = {"name": "HAADF", "inner_mrad": 68.0, "outer_mrad": 200.0}
    halves = {"name": "HALF", "inner_mrad": 50.0, "outer_mrad": 150.0, "sectors": 2}
    changes = {"field.thickness_nm": 0.39, "phonons.configurations": 1, "detector": [haadf, halves]}
    recipe = sw.Recipe(ROOT / "examples/stacks/srtio3_dislocation.toml", set=changes)
    with sw.build(recipe, grid=(1, 1), out=tmp_path / "d.h5", audit=0, keep_clean=True) as world:
        assert list(world.layers["phase"]) == ["srtio3"] and world.layers["turn_deg"][0] == 0
        assert len(world.dislocations) == 1
        assert world.metadata.sectors == {"HALF_0": (0, 180), "HALF_1": (180, 360)}
        assert list(world.detectors) == ["HAADF", "HALF_0", "HALF_1"]
        both = sum(world.tile(0, 0, clean=True, detector=f"HALF_{n}").array for n in (0, 1))
        assert both.mean() > world.tile(0, 0, clean=True).array.mean()
        np.testing.assert_allclose(world.dislocations["burgers_nm"][0], (0.3905, 0, 0), atol=1e-6)
        assert abs(world.dislocations["y_nm"][0] - 2.5) < 0.2
    recipe = sw.Recipe(
        ROOT / "examples/particles/au_on_mgo.toml",
        set={"phonons.configurations": 1, "stack.particles": [
            {"crystal": str(ROOT / "examples/particles/au.cif"), "diameter_nm": [1.2, 1.2], "positions_nm": [[1.2, 1.2]], "shape": "sphere"}
        ], "stack.begin_nm": 1.6, "field.thickness_nm": 2.0},
    )
    with sw.build(recipe, grid=(1, 1), out=tmp_path / "p.h5", audit=0) as world:
        assert list(world.particles["morphology"]) == ["sphere"]
        np.testing.assert_allclose(world.particles["diameter_nm"], 1.2, rtol=0.05)
        assert (world.layers["phase"][0], world.layers["begin_nm"][0]) == ("mgo", np.float32(1.6))
        assert set(np.unique(world.phase_map)) == {0, 1}
