"""Says what a file of patterns holds, as other programs read it: python3 check_patterns.py FILE.emd"""

import sys

import h5py
import numpy as np

with h5py.File(sys.argv[1]) as file:
    data = file["datacube_root/datacube/data"]
    assert file["entry/diffraction/data"].shape == data.shape
    assert list(file["entry/diffraction"].attrs["axes"]) == ["y", "x", "ky", "kx"]
    assert file.attrs["emd_group_type"] == "file" and file["datacube_root"].attrs["emd_group_type"] == "root"
    assert file["datacube_root/datacube"].attrs["python_class"] == "DataCube"
    calibration = file["datacube_root/metadatabundle/calibration"]
    k = file["datacube_root/datacube/dim3"][()]
    assert k[data.shape[3] // 2] == 0 and np.allclose(np.diff(k), calibration["Q_pixel_size"][()])
    assert np.isclose(file["datacube_root/datacube/dim1"][1] - file["datacube_root/datacube/dim1"][0], file.attrs["step_angstrom"][0])
    assert file.attrs["c10_angstrom"] == -file.attrs["defocus_angstrom"]
    assert file["vacuum/data"].shape == data.shape[2:] and 0.9 < file["vacuum/data"][()].sum() <= 1.0001
    assert data.compression is None and data.chunks[0] == 1
    values = data[()]
    assert (values >= 0).all()
    print(data.dtype, *data.shape, f"{values.sum(axis=(2, 3)).mean():.3f}", f"{file.attrs['thickness_angstrom']:.2f}")
