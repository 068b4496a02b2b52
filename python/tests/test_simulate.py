"""Images of atoms, against the command line and against each other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from conftest import ROOT, command

import stemworlds as sw
from stemworlds import simulation

SCAN = sw.Scan(end=(0.25, 0.5), points=(5, 7))


def test_sectors_of_a_detector() -> None:
    silicon = ROOT / "structures/si.cif"
    scan = sw.Scan(end=(0.5, 0.5), points=(3, 3))
    images = sw.simulate(silicon, zone=(1, 1, 0), repeat=(3, 2, 2), scan=scan, detectors={"ABF": (10, 21), "DPC": (10, 21, 4, 45)})
    assert list(images) == ["ABF", "DPC_0", "DPC_1", "DPC_2", "DPC_3"]
    assert images["DPC_3"].metadata["sector_degrees"] == (315, 405)
    total = sum(images[f"DPC_{n}"].array for n in range(4))
    np.testing.assert_allclose(total, images["ABF"].array, rtol=2e-3)
    for bad in ((10, 21, 1), (10, 21, 2.5), (10,), (10, 21, 4, 45, 3)):
        with pytest.raises(sw.InvalidValue, match="detectors"):
            sw.simulate(silicon, detectors={"DPC": bad})  # type: ignore[dict-item]


def test_centre_of_mass_of_a_detector() -> None:
    silicon = ROOT / "structures/si.cif"
    scan = sw.Scan(end=(0.5, 0.5), points=(4, 3))
    options: Any = {"zone": (1, 1, 0), "repeat": (3, 2, 2), "detectors": {"BF": (0, 21), "COM": (0, 60, "com")}, "engine": "multislice"}
    images = sw.simulate(silicon, scan=scan, dose=1e5, **options)
    assert list(images) == ["BF", "COM_x", "COM_y"]
    x, y = images["COM_x"], images["COM_y"]
    assert (x.units, images["BF"].units) == ("mrad", "fraction of the incident beam")
    assert x.array.min() < 0 < x.array.max() and np.abs(x.array).max() < 20
    # Both show the same electrons; their angles scatter independently.
    assert x.counts is not None and y.counts is not None and np.array_equal(x.counts, y.counts)
    assert x.counted_mrad is not None and np.array_equal(x.noisy.array, x.counted_mrad)
    assert 0 < np.abs(x.noisy.array - x.array).max() < 80 / np.sqrt(x.counts.min())
    places = sw.simulate_probes(silicon, [(0.0, 0.0)], **options)
    assert list(places) == ["BF", "COM_x", "COM_y"]
    np.testing.assert_allclose(places["COM_x"][0], x.array[0, 0], atol=1e-3)
    with pytest.raises(sw.InvalidValue, match="detectors"):
        sw.simulate(silicon, detectors={"COM": (0, 60, "center")})  # type: ignore[dict-item]


def test_bytes_are_those_of_the_command_line(tmp_path: Path) -> None:
    silicon = ROOT / "structures/si.cif"
    end = "3.840297,2.715500"  # two cells of [110] are 7.68 x 5.43 A wide
    command(
        *("simulate", silicon, "--zone", "1,1,0", "--repeat", "3,2,3", "--phonons", 2, "--sigma", 0.08),
        *("--detector", "HAADF=68-200", "--detector", "ABF=10-21", "--thicknesses", "5,11", "--dose", 1e4),
        *("--defocus", "0:40:40", "--scan-end", end, "--scan-points", "5,7", "--seed", 3, "-o", "si.h5"),
        cwd=tmp_path,
    )
    x, y = (float(v) for v in end.split(","))
    images = sw.simulate(
        silicon,
        zone=(1, 1, 0),
        repeat=(3, 2, 3),
        phonons=2,
        sigma={"Si": 0.08},
        detectors={"HAADF": (68, 200), "ABF": (10, 21)},
        thicknesses_angstrom=(5, 11),
        dose=1e4,
        defocus_angstrom=[0, 40],
        scan=sw.Scan(end=(x, y), unit="angstrom", points=(5, 7)),
        seed=3,
    )
    assert list(images) == ["HAADF_defocus_0A", "ABF_defocus_0A", "HAADF_defocus_40A", "ABF_defocus_40A"]
    with h5py.File(tmp_path / "si.h5") as file:
        for name, image in images.items():
            stored = file[f"images/{name}"]
            assert image.array.shape == (2, 7, 5) and image.array.dtype == np.float32
            assert stored[:].tobytes() == image.array.tobytes()
            assert file[f"counts/{name}"][:].tobytes() == image.counts.tobytes()
            assert file[f"images/{name}_noisy"][:].tobytes() == image.noisy.array.tobytes()
            np.testing.assert_allclose(stored.attrs["sampling_angstrom"], np.multiply(10, image.sampling_nm))
            np.testing.assert_allclose(stored.attrs["thicknesses_angstrom"], image.thicknesses_angstrom)
        assert file.attrs["command_line"].startswith("stemgen simulate ")


def test_any_number_of_threads_gives_the_same_bytes(silicon: Any) -> None:
    one, two = (sw.simulate(silicon, scan=SCAN, phonons=3, sigma=0.08, threads=n).array for n in (1, 2))
    assert one.tobytes() == two.tobytes()


def test_atoms_come_as_ase_arrays_and_files(silicon: Any, tmp_path: Path) -> None:
    silicon.write(tmp_path / "si.extxyz")
    arrays = sw.AtomArrays(silicon.numbers, silicon.positions, silicon.cell.array)
    images = [sw.simulate(atoms, scan=SCAN).array for atoms in (silicon, arrays, tmp_path / "si.extxyz")]
    assert images[0].tobytes() == images[1].tobytes()
    np.testing.assert_allclose(images[0], images[2], atol=1e-6)  # the file has eight digits


def test_scans_in_cells_nm_and_angstrom_are_one(silicon: Any) -> None:
    width = silicon.cell[0, 0]
    scans = [
        sw.Scan(start=(0.1, 0.2), end=(0.4, 0.5), points=(4, 3)),
        sw.Scan(start=(0.01 * width, 0.02 * width), end=(0.04 * width, 0.05 * width), unit="nm", points=(4, 3)),
        sw.Scan(start=(0.1 * width, 0.2 * width), end=(0.4 * width, 0.5 * width), unit="angstrom", points=(4, 3)),
    ]
    images = [sw.simulate(silicon, scan=scan) for scan in scans]
    for image in images:
        np.testing.assert_allclose(image.array, images[0].array, rtol=1e-4)
        np.testing.assert_allclose(image.origin_nm, (0.02 * width, 0.01 * width))
        np.testing.assert_allclose(image.sampling_nm, (0.01 * width, 0.0075 * width))
    step = sw.simulate(silicon, scan=sw.Scan(end=(0.25, 0.25), step_angstrom=1.0))
    assert step.array.shape == (5, 5)  # 4.07 A in steps of at most 1 A


def test_a_plan_tells_what_a_simulation_takes(silicon: Any) -> None:
    plan = sw.plan_simulation(silicon, scan=SCAN, phonons=4, sigma=0.08)
    assert (plan.atoms, plan.scan_shape, plan.configurations) == (len(silicon), (7, 5), 4)
    assert plan.band_limit_mrad > 200 and plan.memory_bytes > 0
    assert 0 < plan.time_range_s[0] <= plan.time_range_s[1]
    assert plan.details["algorithm"] == {"name": "multislice"}


def test_an_accuracy_is_told(silicon: Any) -> None:
    image = sw.simulate(silicon, scan=SCAN, accuracy_percent=1.0).only
    assert image.metadata["accuracy"][0]["asked_percent"] == 1.0


@pytest.mark.parametrize("engine", ["multislice", "window"])
def test_single_probes_are_those_of_a_scan(silicon: Any, engine: Any) -> None:
    options: Any = {
        "detectors": {"HAADF": (68, 200), "BF": (0, 20)},
        "phonons": 2,
        "sigma": 0.08,
        "defocus_angstrom": [0, 30],
        "thicknesses_angstrom": (5, 10),
        "engine": engine,
        "probe_step": "scan",
    }
    # Probes so far apart that each has a window of its own.
    images = sw.simulate(silicon, scan=sw.Scan((0.1, 0.2), (0.5, 0.6), points=(3, 2)), **options)
    x, y = np.meshgrid([0.1, 0.1 + 0.4 / 3, 0.1 + 0.8 / 3], [0.2, 0.4])
    values = sw.simulate_probes(silicon, np.column_stack([x.ravel(), y.ravel()]), unit="cell", **options)
    assert list(values) == list(images) and len(values) == 4 and values.thicknesses_angstrom == images["BF_defocus_0A"].thicknesses_angstrom
    for name, image in images.items():
        np.testing.assert_allclose(values[name], image.array.reshape(2, 6), rtol=2e-5)
    box = values.metadata["box_angstrom"]
    np.testing.assert_allclose(values.positions_angstrom[0], [0.1 * box[0], 0.2 * box[1]])
    nm = sw.simulate_probes(silicon, values.positions_angstrom / 10, unit="nm", **options)
    np.testing.assert_allclose(nm["HAADF_defocus_30A"], values["HAADF_defocus_30A"], rtol=2e-5)


@pytest.mark.parametrize(
    ("positions", "more", "says"),
    [
        ([1.0, 2.0], {}, "expected \\(N, 2\\)"),
        ([], {}, "one probe or more"),
        ([(1.0, float("nan"))], {}, "no finite numbers"),
        ([(1.0, 1.0)], {"dose": 1e3}, "needs a raster"),
        ([(1.0, 1.0)], {"engine": "prism"}, "single probes"),
        ([(1.0, 1.0)], {"unit": "pm"}, "choose one of"),
    ],
)
def test_impossible_probes_are_refused(silicon: Any, positions: Any, more: Any, says: str) -> None:
    with pytest.raises(sw.InvalidValue, match=says):
        sw.simulate_probes(silicon, positions, **more)


def test_diffraction_adds_up_to_the_detectors(silicon: Any) -> None:
    detectors = {"bright": (0, 10), "dark": (100, 200)}
    at = (2.0, 3.0)
    pattern = sw.diffraction(silicon, at, detectors=detectors, phonons=2, sigma=0.08)
    spot = sw.Scan(start=at, end=(at[0] + 0.1, at[1] + 0.1), unit="angstrom", points=(1, 1))
    images = sw.simulate(silicon, scan=spot, detectors=detectors, phonons=2, sigma=0.08)
    assert 0.99 < pattern.array.sum() < 1.0001
    for name, angles in detectors.items():
        # pixels on the edges count in part on detectors
        assert pattern.annulus(*angles) == pytest.approx(float(images[name].array[0, 0]), rel=0.1)
    row, column = np.unravel_index(pattern.array.argmax(), pattern.array.shape)
    assert np.hypot(row - pattern.centre[0], column - pattern.centre[1]) * pattern.sampling_mrad[0] < 22


def test_exit_waves_are_waves_of_the_patterns(silicon: Any) -> None:
    options: Any = {"detectors": {"all": (0, 100)}, "phonons": 2, "sigma": 0.08, "engine": "multislice"}
    places = [(2.0, 3.0), (0.5, 0.0)]
    waves = sw.exit_waves(silicon, places, defocus_angstrom=(0.0, 60.0), **options)
    assert waves.array.dtype == np.complex64 and waves.array.shape[:4] == (2, 2, 2, 1)
    assert waves.defocus_angstrom == (0.0, 60.0) and waves.positions_angstrom.tolist() == [[2.0, 3.0], [0.5, 0.0]]
    intensity = np.abs(np.fft.fft2(waves.array, norm="ortho")) ** 2
    assert np.abs(intensity.sum(axis=(-1, -2)) - 1).max() < 0.005
    for place, expected in zip(range(2), places, strict=True):
        pattern = sw.diffraction(silicon, expected, **options).array
        ours = np.fft.fftshift(intensity[0, :, place, 0].mean(axis=0))
        assert np.abs(ours - pattern).max() < 1e-5 * pattern.max()
    # The intensity of the wave lies at the probe, in the same box.
    height, width = waves.array.shape[-2:]
    y, x = np.unravel_index((np.abs(waves.array[0, :, 0, 0]) ** 2).mean(axis=0).argmax(), (height, width))
    assert np.hypot(x * 10 * waves.sampling_nm[1] - 2.0, y * 10 * waves.sampling_nm[0] - 3.0) < 1.5


def test_waves_without_atoms_are_probes() -> None:
    nothing = sw.AtomArrays(np.array([6], np.int32), np.array([[15.0, 15.0, 2.0]]), np.diag([20.0, 20.0, 4.0]))
    options: Any = {"engine": "multislice", "detectors": {"all": (0, 60)}}
    thick = sw.exit_waves(nothing, [(4.0, 5.0)], thicknesses_angstrom=(2.0, 4.0), **options)
    # A probe moves with its place, and free space of 4 A is a defocus of -4 A at the exit.
    moved = sw.exit_waves(nothing, [(4.0 + 200 * thick.sampling_nm[1], 5.0)], **options)
    turned = np.roll(thick.array[..., -1, :, :], 20, axis=-1)
    most = np.abs(turned).max()
    assert np.abs(moved.array[..., -1, :, :] - turned).max() < 0.05 * most
    refocused = sw.exit_waves(nothing, [(4.0, 5.0)], defocus_angstrom=thick.thicknesses_angstrom[-1], **options)
    spot = np.abs(refocused.array[0, 0, 0, 0])
    y, x = np.unravel_index(spot.argmax(), spot.shape)
    assert spot[y, x] > np.abs(thick.array[0, 0, 0, -1]).max()
    # In focus at the exit, the phase at the middle is flat.
    near = refocused.array[0, 0, 0, 0, y - 2 : y + 3, x - 2 : x + 3]
    assert np.ptp(np.angle(near / near[2, 2])) < 0.05


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"engine": "window"}, "full grid"),
        ({"focal_spread_angstrom": 20.0}, "one focus"),
        ({"dose": 1e3}, "single probes"),
    ],
)
def test_impossible_exit_waves_are_refused(silicon: Any, more: Any, says: str) -> None:
    with pytest.raises(sw.InvalidValue, match=says):
        sw.exit_waves(silicon, [(1.0, 1.0)], **more)


def test_plane_waves(silicon: Any) -> None:
    wave = sw.plane_wave(silicon, phonons=2, sigma=0.08, semiangle_mrad=12, defocus_angstrom=[0, 200])
    assert wave.exit_waves.shape[0] == 2 and wave.exit_waves.dtype == np.complex64
    assert [image.metadata["defocus_angstrom"] for image in wave.images] == [0.0, 200.0]
    power = (np.abs(wave.exit_waves) ** 2).mean()
    assert power == pytest.approx(1.0, abs=0.01)
    assert wave.images[0].array.std() != pytest.approx(wave.images[1].array.std())


def test_only_what_is_given_is_passed_on(silicon: Any) -> None:
    request, arrays = simulation._request("si.cif", {})
    assert arrays is None and request == {"structure": "si.cif", "specimen": {}, "microscope": {}, "numerics": {}}
    given: Any = {"energy_kv": 300, "gpts": None, "aberrations": {"C12": (30, 0.3)}, "dose": 5.0}
    request, arrays = simulation._request(silicon, given)
    coefficient = {"order": 1, "symmetry": 2, "magnitude_angstrom": 30.0, "azimuth_rad": 0.3}
    assert arrays is not None and request["microscope"] == {"energy_kev": 300, "aberrations": [coefficient]}
    assert request["numerics"] == {} and request["electrons_per_angstrom2"] == 5.0


def test_narrow_cells_are_told_as_on_the_command_line() -> None:
    warnings = sw.plan_simulation(ROOT / "structures/si.cif").warnings
    [told] = [text for text in warnings if "is narrow" in text]
    assert "repeat it 3,3,1 times" in told and "--" not in told


def test_sources_blur(silicon: Any) -> None:
    scan = sw.Scan(end=(1 / 3, 1 / 3), points=(16, 16))
    options: Any = {"scan": scan, "sampling_angstrom": 0.2, "detectors": {"ADF": (30, 45)}}
    sharp, blurred = (sw.simulate(silicon, source_size_angstrom=size, **options).array for size in (None, 1.0))
    assert blurred.max() < 0.9 * sharp.max()
    assert blurred.mean() == pytest.approx(sharp.mean(), rel=1e-3)


def test_mixed_sites_of_ase_are_those_of_the_file(tmp_path: Path) -> None:
    from ase import io

    path = tmp_path / "half.cif"
    path.write_text(
        "data_x\n_cell_length_a 5\n_cell_length_b 5\n_cell_length_c 5\n_cell_angle_alpha 90\n_cell_angle_beta 90\n"
        "_cell_angle_gamma 90\n_symmetry_space_group_name_H-M 'P 1'\nloop_\n_atom_site_label\n_atom_site_type_symbol\n"
        "_atom_site_fract_x\n_atom_site_fract_y\n_atom_site_fract_z\n_atom_site_occupancy\nA1 Si 0 0 0 0.5\nA2 Al 0 0 0 0.5\n"
    )
    by_path = sw.plan_simulation(path, repeat=(4, 4, 4)).details["composition"]
    by_ase = sw.plan_simulation(io.read(path), repeat=(4, 4, 4)).details["composition"]
    assert set(by_path) == set(by_ase) == {"Al", "Si"}
    assert by_path == by_ase


def test_the_cell_of_ase_may_begin_elsewhere(silicon: Any) -> None:
    moved = silicon.copy()
    moved.set_celldisp([-2.0, -2.0, -1.0])
    moved.positions += [-2.0, -2.0, -1.0]
    options: Any = {"scan": SCAN, "sampling_angstrom": 0.1, "detectors": {"ADF": (40, 80)}}
    assert np.allclose(sw.simulate(moved, **options).array, sw.simulate(silicon, **options).array, atol=1e-7)


def test_strain_is_told(silicon: Any, caplog: pytest.LogCaptureFixture) -> None:
    sheared = silicon.copy()
    cell = sheared.cell.array.copy()
    cell[1, 0] = 0.05
    sheared.set_cell(cell, scale_atoms=True)
    images = sw.simulate(sheared, scan=SCAN, sampling_angstrom=0.1, detectors={"ADF": (40, 80)}, max_strain_percent=1)
    assert "strained by 0.15" in caplog.text
    assert images.metadata["strain_percent"] == pytest.approx(0.153, abs=0.01)


def test_displacements_come_from_a_table(silicon: Any) -> None:
    options: dict[str, Any] = {"scan": SCAN, "phonons": 2}
    # B of silicon at 280 K in the table of Peng et al.
    given = sw.simulate(silicon, sigma=float(np.sqrt(0.4630 / (8 * np.pi**2))), **options)
    assert np.array_equal(sw.simulate(silicon, sigma="table", temperature_k=280, **options).array, given.array)
    with pytest.raises(sw.InvalidValue, match="200 to 400 K") as told:
        sw.simulate(silicon, sigma="table", temperature_k=1e3, **options)
    assert told.value.keyword == "temperature_k"


def test_displacements_of_each_atom_are_tensors(silicon: Any, caplog: pytest.LogCaptureFixture) -> None:
    options: dict[str, Any] = {"scan": SCAN, "phonons": 1, "engine": "multislice", "sampling_angstrom": 0.1, "detectors": {"ADF": (40, 80)}}
    isotropic = np.broadcast_to(0.08**2 * np.eye(3), (len(silicon), 3, 3))
    same = sw.simulate(silicon, displacements=isotropic, **options).array
    assert np.array_equal(same, sw.simulate(silicon, sigma=0.08, **options).array)
    along_x, along_y = (np.broadcast_to(np.diag(u), isotropic.shape) for u in ([0.02, 0, 0], [0, 0.02, 0]))
    one, two = (sw.simulate(silicon, displacements=u, **options).array for u in (along_x, along_y))
    assert np.abs(one - two).max() > 0.01 * one.max()
    assert "anisotropic displacements that come with the atoms are used for all 144 atoms" in caplog.text
    wrong: list[tuple[Any, str]] = [
        (isotropic[1:], "expected \\(144, 3, 3\\)"),
        (-isotropic, "atoms\\[0\\].*expected none below 0"),
        (2e3 * isotropic, "expected at most 1"),
    ]
    for array, expected in wrong:
        with pytest.raises(sw.InvalidValue, match=expected) as told:
            sw.simulate(silicon, displacements=array, **options)
        assert told.value.keyword == "displacements"
    with pytest.raises(sw.InvalidValue, match="exclude each other"):
        sw.simulate(silicon, displacements=isotropic, sigma=0.08, **options)
    with pytest.raises(sw.InvalidValue, match="atoms in memory"):
        sw.simulate(ROOT / "structures/si.cif", displacements=isotropic, **options)
