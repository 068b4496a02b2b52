"""Reads a file of images as its schema says and checks what must hold."""
import json
import sys

import h5py
import numpy as np

with h5py.File(sys.argv[1]) as f:
    assert f.attrs["format"] == "stemgen images" and f.attrs["format_version"] == 1
    assert f.attrs["command_line"].startswith("stemgen simulate")
    assert f.attrs["structure_file"] == "si.cif"
    settings = json.loads(f.attrs["settings"])
    assert settings["optics"]["energy_ev"] == 200e3
    assert abs(f.attrs["wavelength_angstrom"] - 0.025079) < 1e-6
    assert "wall_time_s" not in f.attrs, "the same command gives the same bytes"
    cell = f["specimen/cell"][()]
    positions, numbers = f["specimen/positions"][()], f["specimen/numbers"][()]
    assert positions.shape == (len(numbers), 3) and set(numbers) == {14}
    assert np.allclose(cell, np.diag(np.diag(cell)))
    assert (positions < np.diag(cell) + 1e-9).all()
    for name, image in f["images"].items():
        data = image[()]
        assert data.dtype == np.float32 and data.ndim == 3
        assert list(image.attrs["axes"]) == ["thickness", "y", "x"]
        assert len(image.attrs["thicknesses_angstrom"]) == data.shape[0]
        assert image.attrs["sampling_angstrom"].shape == (2,)
        assert image.attrs["origin_angstrom"].shape == (2,)
        assert (data >= 0).all() and data.max() > 0
        if name == "lens":
            wave = f["exit_wave"]
            assert wave.dtype == np.complex64 and wave.shape[1:] == data.shape[1:]
            assert list(wave.attrs["axes"]) == ["configuration", "y", "x"]
            assert 0.9 < (np.abs(wave[()]) ** 2).mean() < 1.001
        else:
            assert image.attrs["units"] == "fraction of the incident beam"
            assert image.attrs["inner_mrad"] < image.attrs["outer_mrad"]
            assert data.max() < 1
        print(name, *data.shape)
