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
    assert entry.attrs["default"] == "ADF"
    assert sorted(entry) == ["ADF", "ADF_counts", "ADF_noisy"], list(entry)
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
        assert axes == ["defocus", "y", "x"] and list(group["defocus"]) == [0, 50]
        for n, axis in enumerate(axes):
            assert group.attrs[axis + "_indices"] == n
            assert group[axis].shape == (data.shape[n],) and group[axis].attrs["units"] == "angstrom"
        y, x = data.attrs["sampling_angstrom"]
        assert np.allclose(np.diff(group["x"]), x) and np.allclose(np.diff(group["y"]), y)
        assert data.attrs["interpretation"] == group.attrs["interpretation"] == "image"
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
    for kind in ["", "_noisy"]:
        stack = f[f"entry/ADF{kind}/data"]
        assert stack.is_virtual and stack.shape == (2, *f["images"][names[0]].shape[1:])
        for n, name in enumerate(names):
            assert np.array_equal(stack[n], f["images"][name + kind][0])
    for n, name in enumerate(names):
        assert np.array_equal(f["entry/ADF_counts/data"][n], f["counts"][name][0])
    assert not np.allclose(f["images"][names[0]], f["images"][names[1]])
    assert not np.array_equal(f["counts"][names[0]], f["counts"][names[1]])
    images = {name: f["images"][name][()] for name in f["images"]}

with h5py.File(sys.argv[1].replace(".h5", ".hspy")) as f:
    assert f.attrs["file_format"] == "HyperSpy"
    assert sorted(f["Experiments"]) == ["ADF", "ADF_noisy"]
    for name, group in f["Experiments"].items():
        kind = name.removeprefix("ADF")
        for n, one in enumerate(names):
            assert np.array_equal(group["data"][n], images[one + kind][0])
        sizes = [group[f"axis-{n}"].attrs["size"] for n in range(3)]
        assert tuple(sizes) == group["data"].shape
        assert [group[f"axis-{n}"].attrs["name"] for n in range(3)] == ["defocus", "y", "x"]
        assert [bool(group[f"axis-{n}"].attrs["navigate"]) for n in range(3)] == [True, False, False]
        assert (group["axis-0"].attrs["offset"], group["axis-0"].attrs["scale"]) == (0, 50)
        metadata = group["metadata"]
        tem = metadata["Acquisition_instrument/TEM"]
        assert tem.attrs["beam_energy"] == 200 and tem.attrs["convergence_angle"] == 21
        assert tem.attrs["acquisition_mode"] == "STEM" and tem["Stage"].attrs["tilt_alpha"] == 0
        assert (tem["Detector"].attrs["inner_angle_mrad"], tem["Detector"].attrs["outer_angle_mrad"]) == (40, 80)
        assert tem.attrs.get("dose_electrons_per_angstrom2") == (1e6 if kind else None)
        assert "stemgen simulate" in metadata["General"].attrs["notes"]
        own = group["original_metadata/stemgen"].attrs
        assert own["command_line"].startswith("stemgen simulate") and "request" in own
print(len(images), "images")
