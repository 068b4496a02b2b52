"""Reads a run with a defocus series, a source and a dose as NeXus readers, HyperSpy and ImageJ would."""
import sys

import h5py
import numpy as np

with h5py.File(sys.argv[1]) as f:
    names = ["ADF_defocus_0A", "ADF_defocus_50A"]
    assert sorted(f["images"]) == sorted(names + [n + "_noisy" for n in names]), list(f["images"])
    assert f.attrs["source_fwhm_angstrom"] == 0.8
    # NeXus: follow `default` from the root to a signal with its axes
    entry = f[f.attrs["default"]]
    assert entry.attrs["NX_class"] == "NXentry" and f.attrs["NX_class"] == "NXroot"
    assert entry.attrs["default"] == names[0]
    for name, group in entry.items():
        assert group.attrs["NX_class"] == "NXdata" and group.attrs["signal"] == "data"
        # Berkeley's EMD, as ncempy reads it
        assert group.attrs["emd_group_type"] == 1 and f.attrs["version_minor"] == 2
        for n, axis in enumerate(group.attrs["axes"]):
            dim = group[f"dim{n + 1}"]
            assert len(dim) == group["data"].shape[n] and dim.attrs["units"] == "angstrom"
            assert dim.attrs["name"] == axis and (dim[:] == group[axis][:]).all()
        data = group[group.attrs["signal"]]
        axes = list(group.attrs["axes"])
        assert axes == ["thickness", "y", "x"]
        for n, axis in enumerate(axes):
            assert group.attrs[axis + "_indices"] == n
            assert group[axis].shape == (data.shape[n],) and group[axis].attrs["units"] == "angstrom"
        y, x = data.attrs["sampling_angstrom"]
        assert np.allclose(np.diff(group["x"]), x) and np.allclose(np.diff(group["y"]), y)
        assert data.attrs["interpretation"] == "image"
        assert group["y"][0] == data.attrs["origin_angstrom"][0]
    for name in names:
        sharp, noisy, counts = f["images"][name], f["images"][name + "_noisy"], f["counts"][name]
        assert counts.dtype == np.uint32 and counts.attrs["seed"] == 7
        per_pixel = counts.attrs["electrons_per_pixel"]
        assert np.isclose(per_pixel, 1e6 * np.prod(counts.attrs["sampling_angstrom"]))
        assert np.allclose(counts[()] / per_pixel, noisy[()])
        off = (counts[()] - sharp[()] * per_pixel) / np.sqrt(sharp[()] * per_pixel)
        assert 0.6 < off.std() < 1.4 and abs(off.mean()) < 5 / np.sqrt(off.size), (off.std(), off.mean())
        assert f["images"][name].attrs["defocus_angstrom"] == float(name.split("_")[2][:-1])
        assert f["entry"][name]["data"] == f["images"][name]
    assert not np.allclose(f["images"][names[0]], f["images"][names[1]])
    assert not np.array_equal(f["counts"][names[0]], f["counts"][names[1]])
    images = {name: f["images"][name][()] for name in f["images"]}

with h5py.File(sys.argv[1].replace(".h5", ".hspy")) as f:
    assert f.attrs["file_format"] == "HyperSpy"
    assert sorted(f["Experiments"]) == sorted(images)
    for name, group in f["Experiments"].items():
        assert np.array_equal(group["data"], images[name][0])
        sizes = [group[f"axis-{n}"].attrs["size"] for n in range(2)]
        assert tuple(sizes) == group["data"].shape
        assert [group[f"axis-{n}"].attrs["name"] for n in range(2)] == ["y", "x"]
        assert not group["axis-0"].attrs["navigate"]
print(len(images), "images")
