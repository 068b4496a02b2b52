"""Says what a file of rings holds, as other programs read it: python3 check_rings.py FILE.emd"""

import sys

import h5py
import numpy as np

with h5py.File(sys.argv[1]) as file:
    data = file["datacube_root/radial/data"]
    assert file["entry/diffraction/data"].shape == data.shape
    assert list(file["entry/diffraction"].attrs["axes"]) == ["y", "x", "angle"]
    assert file["datacube_root/radial"].attrs["python_class"] == "Array"
    width = file.attrs["ring_mrad"]
    assert np.allclose(file["datacube_root/radial/dim2"], (np.arange(data.shape[2]) + 0.5) * width)
    assert np.isclose(file.attrs["max_angle_mrad"], data.shape[2] * width)
    assert file["vacuum/data"].shape == (1, data.shape[2]) and 0.9 < file["vacuum/data"][()].sum() <= 1.0001
    values = data[()]
    assert (values >= 0).all() and (values.sum(axis=2) > 0).all()
    print(data.dtype, *data.shape)
