"""Images in other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import stemworlds as sw


@pytest.fixture(scope="module")
def images(silicon: Any) -> sw.Images:
    scan = sw.Scan(start=(0.1, 0.2), end=(0.3, 0.5), points=(5, 7))
    return sw.simulate(silicon, scan=scan, detectors={"HAADF": (68, 200), "BF": (0, 20)}, thicknesses_angstrom=(4, 9))


def test_results_are_mappings_and_images(images: sw.Images, silicon: Any) -> None:
    assert list(images) == ["HAADF", "BF"] and len(images) == 2
    with pytest.raises(sw.InvalidValue, match="choose one"):
        images.array
    with pytest.raises(KeyError, match="'HAADF'"):
        images["ADF"]
    one = sw.simulate(silicon, scan=sw.Scan(points=(3, 2)))
    assert one.array.shape == (2, 3) and np.asarray(one).dtype == np.float32
    assert np.asarray(one.only, dtype=np.float64).dtype == np.float64
    np.testing.assert_allclose(one.sampling_nm, (silicon.cell[1, 1] / 20, silicon.cell[0, 0] / 30))
    assert images["HAADF"].at(0).array.shape == (7, 5) and images["HAADF"].at(1).thicknesses_angstrom[0] > 4


def test_notebooks_show_images(images: sw.Images) -> None:
    assert images["HAADF"]._repr_png_().startswith(b"\x89PNG")
    assert images._repr_html_().count("<figure>") == 2


def test_hspy_files_have_the_layout(images: sw.Images, tmp_path: Path) -> None:
    images.to_hspy(tmp_path / "all.hspy")
    with h5py.File(tmp_path / "all.hspy") as file:
        assert set(file["Experiments"]) == {"HAADF", "BF"}
        np.testing.assert_array_equal(file["Experiments/BF/data"][:], images["BF"].array)
        axis = file["Experiments/BF/axis-2"].attrs
        np.testing.assert_allclose(axis["scale"], 10 * images["BF"].sampling_nm[1])
        np.testing.assert_allclose(axis["offset"], 10 * images["BF"].origin_nm[1])


def test_a_defocus_series_is_one_stack(silicon: Any, tmp_path: Path) -> None:
    scan = sw.Scan(points=(3, 2))
    series = sw.simulate(silicon, scan=scan, detectors={"BF": (0, 20)}, defocus_angstrom=(0, 30), dose=1e5, energy_kv=80)
    series.to_hspy(tmp_path / "all.hspy")
    with h5py.File(tmp_path / "all.hspy") as file:
        assert list(file["Experiments"]) == ["BF"]
        signal = file["Experiments/BF"]
        np.testing.assert_array_equal(signal["data"][:], [image.array for image in series.values()])
        assert signal["axis-0"].attrs["name"] == "defocus" and signal["axis-0"].attrs["scale"] == 30
        instrument = signal["metadata/Acquisition_instrument/TEM"]
        assert instrument.attrs["beam_energy"] == 80 and instrument.attrs["convergence_angle"] == 21
        assert instrument["Detector"].attrs["name"] == "BF"
    series["BF_defocus_30A"].noisy.to_hspy(tmp_path / "noisy.hspy")
    with h5py.File(tmp_path / "noisy.hspy") as file:
        instrument = file["Experiments/BF_defocus_30A_noisy/metadata/Acquisition_instrument/TEM"]
        assert instrument.attrs["dose_electrons_per_angstrom2"] == pytest.approx(1e5)
        assert instrument.attrs["defocus_angstrom"] == 30
    series.to_tiff(tmp_path / "all.tif")
    assert b"axes=defocus,y,x\ndefocus_angstrom=0,30\n" in (tmp_path / "all.tif").read_bytes()
    with pytest.raises(sw.InvalidValue, match="one series"):
        sw.simulate(silicon, scan=scan, detectors={"A": (0, 20), "B": (40, 80)}).to_tiff(tmp_path / "no.tif")
    image = series["BF_defocus_0A"]
    assert image._png(grey_bar=True) != image._png()


def test_hyperspy_opens_our_files(images: sw.Images, tmp_path: Path) -> None:
    hs = pytest.importorskip("hyperspy.api")
    image = images["HAADF"].at(1)
    image.to_hspy(tmp_path / "one.hspy")
    signal = hs.load(tmp_path / "one.hspy")
    np.testing.assert_array_equal(signal.data, image.array)
    assert signal.axes_manager["x"].scale == pytest.approx(10 * image.sampling_nm[1])
    assert signal.axes_manager["y"].offset == pytest.approx(10 * image.origin_nm[0])
    made = image.to_hyperspy()
    assert made.axes_manager["x"].scale == pytest.approx(image.sampling_nm[1]) and made.axes_manager["x"].units == "nm"
    assert made.axes_manager["y"].offset == pytest.approx(image.origin_nm[0])
    np.testing.assert_array_equal(made.data, image.array)


def test_tiff(images: sw.Images, tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    images["HAADF"].to_tiff(tmp_path / "a.tif")
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a.tif"), images["HAADF"].array)
    with pytest.raises(sw.InvalidValue):
        images["HAADF"].to_tiff(tmp_path / "b.tif", bits=12)


def test_plots(images: sw.Images, world_path: Path) -> None:
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    ax = images["HAADF"].plot()
    assert ax.get_images()[0].get_extent() == pytest.approx(images["HAADF"].extent_nm)
    # y upwards: row 0, which has the smallest y, is at the bottom
    turned = images["HAADF"].plot(origin="lower")
    left, right, bottom, top = turned.get_images()[0].get_extent()
    assert (left, right, top, bottom) == pytest.approx(images["HAADF"].extent_nm)
    assert turned.get_ylim()[0] < turned.get_ylim()[1] and ax.get_ylim()[0] > ax.get_ylim()[1]
    ax = sw.World(world_path).plot((1, 1, 2, 2), overlay="columns")
    assert len(ax.lines[0].get_xdata()) > 3


def test_tables(world_path: Path, tmp_path: Path) -> None:
    table = sw.World(world_path).truth_table()
    table.to_csv(tmp_path / "t.csv")
    lines = (tmp_path / "t.csv").read_text().splitlines()
    assert lines[0].split(",") == list(table.names) and len(lines) == 1 + len(table)
    assert "<table>" in table._repr_html_()


def test_a_table_is_no_program_of_a_spreadsheet(tmp_path: Path) -> None:
    array = np.array([(-1.5, "=1+1"), (2.0, "Sr"), (0.0, "@x"), (0.0, "-O"), (0.0, "+O")], dtype=[("x_nm", "f4"), ("composition", "U32")])
    sw.Table(array).to_csv(tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_text() == "x_nm,composition\n-1.5,'=1+1\n2.0,Sr\n0.0,'@x\n0.0,'-O\n0.0,'+O\n"
