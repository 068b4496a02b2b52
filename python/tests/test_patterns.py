"""Diffraction patterns of scans: arrays and files, against the command line, and images made of them."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from conftest import ROOT, command

import stemworlds as sw

ATOMS = ROOT / "structures/srtio3.cif"
SCAN = sw.Scan((7.81, 7.81), (11.715, 11.715), unit="angstrom", points=(6, 5))
SMALL: Any = {"repeat": (4, 4, 2), "scan": SCAN}


@pytest.fixture(scope="module")
def cube() -> sw.DataCube:
    return sw.simulate_patterns(ATOMS, pixels=32, max_angle_mrad=50, **SMALL)


def test_arrays_and_files_are_those_of_the_command_line(cube: sw.DataCube, tmp_path: Path) -> None:
    assert cube.data.dtype == np.float32 and cube.data.shape == (5, 6, 32, 32) == cube.axes.shape
    command(
        *("patterns", ATOMS, "--repeat", "4,4,2", "--scan-start", "7.81,7.81", "--scan-end", "11.715,11.715"),
        *("--scan-points", "6,5", "--pixels", 32, "--max-angle", 50, "-o", "typed.emd"),
        cwd=tmp_path,
    )
    written = sw.simulate_patterns(ATOMS, pixels=32, max_angle_mrad=50, out=tmp_path / "w.emd", threads=1, **SMALL)
    for name in ("typed.emd", "w.emd"):
        with h5py.File(tmp_path / name) as file:
            assert np.array_equal(file["datacube_root/datacube/data"], cube.data)
    assert written.axes == cube.axes
    assert np.array_equal(written[2, 3], cube.data[2, 3]) and np.array_equal(written[-1, -1], cube.data[-1, -1])
    assert np.array_equal(written.data, cube.data) and np.array_equal(written.vacuum, cube.vacuum)
    with pytest.raises(sw.StemworldsError, match="exists"):
        sw.simulate_patterns(ATOMS, pixels=32, out=tmp_path / "w.emd", **SMALL)
    with pytest.raises(IndexError):
        written[5, 0]


def test_images_are_sums_over_pixels(cube: sw.DataCube, tmp_path: Path) -> None:
    everything = np.ones((32, 32))
    assert np.allclose(cube.virtual_image(mask=everything).array, cube.data.sum(axis=(2, 3)), rtol=1e-6)
    ring = cube.virtual_image(10, 21, name="ABF")
    assert (ring.name, ring.units) == ("ABF", "fraction of the incident beam")
    assert ring.sampling_nm == pytest.approx((0.0781, 0.065083), rel=1e-4)
    halves = [cube.virtual_image(10, 21, sector_degrees=(a, a + 180)).array for a in (0, 180)]
    assert np.allclose(halves[0] + halves[1], ring.array, rtol=1e-4)
    y, x = cube.centre_of_mass()
    k = (np.arange(32) - 16) * 50 / 16
    by_hand = (cube.data * k).sum(axis=(2, 3)) / cube.data.sum(axis=(2, 3))
    assert np.allclose(x.array, by_hand, atol=1e-3) and np.abs(y.array).max() > 0.5
    assert cube.mean_pattern().sum() == pytest.approx(cube.data.sum() / 30, rel=1e-6)
    # The same by the command line.
    sw.simulate_patterns(ATOMS, pixels=32, max_angle_mrad=50, out=tmp_path / "a.emd", **SMALL)
    command("integrate", "a.emd", "--annulus", "ABF=10-21", "--com", "--icom", cwd=tmp_path)
    with h5py.File(tmp_path / "a_images.h5") as file:
        images = {name: file["images"][name][0] for name in file["images"]}
    assert np.allclose(images["ABF"], ring.array, rtol=1e-5)
    assert np.allclose(images["com_y"], y.array, atol=1e-4)
    assert np.allclose(images["icom"], cube.integrated_centre_of_mass().array, atol=1e-5)


def test_rings_make_any_annulus(tmp_path: Path) -> None:
    full: Any = {**SMALL, "engine": "multislice"}
    rings = sw.simulate_patterns(ATOMS, radial_mrad=1, max_angle_mrad=200, **full)
    assert rings.axes.ring_mrad == 1 and rings.data.shape == (5, 6, 1, 200)
    assert rings.axes.angles_mrad[:2] == pytest.approx([0.5, 1.5])
    images = sw.simulate(ATOMS, detectors={"HAADF": (68, 200)}, probe_step="scan", **full)
    haadf = rings.virtual_image(68, 200)
    assert np.allclose(haadf.array, images["HAADF"].array, rtol=1e-5)
    written = sw.simulate_patterns(ATOMS, radial_mrad=1, max_angle_mrad=200, out=tmp_path / "r.emd", **full)
    assert written.axes == rings.axes and np.array_equal(written.data, rings.data)
    assert np.array_equal(written[1, 2], rings.data[1, 2]) and "200 rings of 1 mrad" in repr(written)
    for refused in (rings.centre_of_mass, rings.to_hyperspy, rings.to_py4dstem, rings.integrated_centre_of_mass):
        with pytest.raises(sw.InvalidValue, match="radial_mrad"):
            refused()
    with pytest.raises(sw.InvalidValue, match="68-200 mrad consists of whole rings"):
        rings.virtual_image(68.5, 199.7)
    with pytest.raises(sw.InvalidValue, match="need patterns of pixels"):
        rings.virtual_image(10, 20, sector_degrees=(0, 90))


def test_source_and_detector_spread_patterns(cube: sw.DataCube) -> None:
    options: Any = {"pixels": 32, "max_angle_mrad": 50, **SMALL}
    table = [(0, 1), (0.25, 0.7), (0.5, 0.3)]
    spread = sw.simulate_patterns(ATOMS, mtf=np.array(table), **options)
    assert np.allclose(spread.data.sum(axis=(2, 3)), cube.data.sum(axis=(2, 3)), rtol=1e-5)
    assert spread.data.max() < 0.97 * cube.data.max()
    blurred = sw.simulate_patterns(ATOMS, source_size_angstrom=1.5, **options)
    assert blurred.data.shape == cube.data.shape
    sharp, soft = (c.virtual_image(0, 10).array.std() for c in (cube, blurred))
    assert soft < 0.8 * sharp
    same = sw.simulate_patterns(ATOMS, mtf=0, **options)
    assert np.allclose(same.data, cube.data, atol=1e-7)


def test_a_cube_of_a_file_is_sent_to_other_processes(cube: sw.DataCube, tmp_path: Path) -> None:
    written = sw.simulate_patterns(ATOMS, pixels=32, max_angle_mrad=50, out=tmp_path / "w.emd", **SMALL)
    assert written[0, 0].shape == (32, 32)
    again = pickle.loads(pickle.dumps(written))
    assert np.array_equal(again[0, 0], cube.data[0, 0])


def test_electrons_are_counted_in_a_series() -> None:
    series = sw.simulate_pattern_series(
        ATOMS, pixels=16, max_angle_mrad=40, dose=1e4, thicknesses_angstrom=[3.9, 7.8], defocus_angstrom=[0, 40], **SMALL
    )
    assert [(round(c.axes.thickness_angstrom, 1), c.axes.defocus_angstrom) for c in series] == [
        *((3.9, 0.0), (7.8, 0.0)),
        *((3.9, 40.0), (7.8, 40.0)),
    ]
    expected = 1e4 * 3.905 / 6 * 3.905 / 5
    for one in series:
        assert one.data.dtype == np.uint32 and one.axes.electrons_per_pattern == pytest.approx(expected)
        # Five standard deviations of what 30 patterns count.
        assert abs(one.data.sum() / (30 * expected) - 0.99) < 0.01 + 5 / (30 * expected) ** 0.5
        assert one.virtual_image(0, 21).units == "electrons"
    assert not np.array_equal(series[0].data, series[1].data)
    whole = sw.simulate_patterns(ATOMS, pixels=16, max_angle_mrad=40, dose=1e4, **SMALL)
    assert whole.data.shape == (5, 6, 16, 16)


def test_mistakes_are_refused(cube: sw.DataCube, tmp_path: Path) -> None:
    def refused(match: str, **options: Any) -> None:
        with pytest.raises(sw.InvalidValue, match=match):
            sw.simulate_patterns(ATOMS, **{**SMALL, **options})

    refused("2 to 4096", pixels=1)
    refused("one of the two", pixels=32, radial_mrad=1)
    refused("multiple is 99 mrad", radial_mrad=3)
    refused("rings have no pixels", radial_mrad=1, mtf=1)
    refused("0 to 50 pixels", mtf=-1)
    refused("rows of", mtf=[0.1, 0.5])
    refused("rows of", mtf="sharp")
    refused("frequency 0", mtf=[(0.1, 1), (0.5, 0.5)])
    refused("Gaussian", source_size_angstrom=0.8, source_lorentz=0.3)
    refused("virtual_image", detectors={"HAADF": (68, 200)})
    refused("series", thicknesses_angstrom=[3.9, 7.8])
    refused("PRISM", engine="prism")
    refused("emd", out=tmp_path / "x.h5")
    with pytest.raises(sw.InvalidValue, match=r"reach to 50\.0 mrad"):
        cube.virtual_image(68, 200)
    with pytest.raises(sw.InvalidValue, match="mask"):
        cube.virtual_image(mask=np.ones((8, 8)))
    with pytest.raises(sw.InvalidValue, match="ring, or a mask"):
        cube.virtual_image()
    (tmp_path / "no.emd").write_bytes(b"nothing")
    with pytest.raises(sw.StemworldsError, match=r"no\.emd"):
        sw.DataCube.open(tmp_path / "no.emd")


def test_a_page_shows_arrays_and_files_alike(cube: sw.DataCube, tmp_path: Path) -> None:
    written = sw.simulate_patterns(ATOMS, pixels=32, max_angle_mrad=50, out=tmp_path / "w.emd", **SMALL)
    pages = []
    for folder, shown in (("a", cube), ("b", written)):
        (tmp_path / folder).mkdir()
        path = tmp_path / folder / "w.html"
        assert shown.page(path) == str(path)
        pages.append(path.read_text(encoding="utf-8"))
        with pytest.raises(sw.StemworldsError, match="exists"):
            shown.page(path)
        shown.page(path, overwrite=True)
    # Codes of all intensities, by rows of the scan, are the blobs of the page.
    assert pages[0] == pages[1] and pages[0].count('<script type="text/plain" id="b') == 5
    with pytest.raises(sw.InvalidValue, match=r"\.html"):
        cube.page(tmp_path / "w.png")
    rings = sw.simulate_patterns(ATOMS, radial_mrad=5, max_angle_mrad=100, **SMALL)
    with pytest.raises(sw.InvalidValue, match="page"):
        rings.page(tmp_path / "r.html")


def test_hyperspy_gets_calibrated_patterns(cube: sw.DataCube) -> None:
    pytest.importorskip("hyperspy")
    signal = cube.to_hyperspy()
    assert signal.data.shape == cube.data.shape
    kx = signal.axes_manager.signal_axes[0]
    assert kx.index2value(16) == pytest.approx(0) and kx.scale == pytest.approx(cube.axes.pixel_k)
    assert signal.metadata.Acquisition_instrument.TEM.beam_energy == 200
