"""Checks files of the same counted patterns, as other programs read them: python3 check_pattern_files.py NAME

NAME.emd, NAME.hspy, NAME.toml with its arrays (raw CSR), and NAME.raw with NAME.json and NAME.xml (EMPAD)."""

import json
import sys
import tomllib
import xml.etree.ElementTree as tree
from pathlib import Path

import h5py
import numpy as np

name = Path(sys.argv[1])
with h5py.File(name.with_suffix(".emd")) as file:
    exact = file["datacube_root/datacube/data"][()]
    k = file["datacube_root/datacube/dim3"][()]
    attributes = dict(file.attrs)

with h5py.File(name.with_suffix(".hspy")) as file:
    assert file.attrs["file_format"] == "HyperSpy"
    (signal,) = file["Experiments"].values()
    assert np.array_equal(signal["data"], exact)
    axes = [dict(signal[f"axis-{n}"].attrs) for n in range(4)]
    assert [a["name"] for a in axes] == ["y", "x", "ky", "kx"] and [bool(a["navigate"]) for a in axes] == [True, True, False, False]
    assert [a["size"] for a in axes] == list(exact.shape)
    assert np.isclose(axes[3]["offset"], k[0]) and np.isclose(axes[3]["scale"], k[1] - k[0])
    assert np.isclose(axes[1]["offset"], attributes["origin_angstrom"][0])
    assert signal["metadata/Acquisition_instrument/TEM"].attrs["beam_energy"] == 200
    assert "si.cif" in signal["original_metadata/stemgen"].attrs["request"]

sparse = tomllib.loads(name.with_suffix(".toml").read_text())
assert sparse["params"] == {"filetype": "raw_csr", "nav_shape": list(exact.shape[:2]), "sig_shape": list(exact.shape[2:])}
files = sparse["raw_csr"]
indptr, indices, values = (
    np.fromfile(name.parent / files[f"{part}_file"], files[f"{part}_dtype"]) for part in ("indptr", "indices", "data")
)
frames = np.zeros((exact.shape[0] * exact.shape[1], exact.shape[2] * exact.shape[3]), np.int64)
assert len(indptr) == len(frames) + 1 and indptr[-1] == len(indices) == len(values) and (values > 0).all()
for n, frame in enumerate(frames):
    part = slice(indptr[n], indptr[n + 1])
    assert (np.diff(indices[part]) > 0).all()
    frame[indices[part]] = values[part]
assert np.array_equal(frames.reshape(exact.shape), exact)
assert sparse["stemgen"]["energy_kev"] == 200 and "si.cif" in sparse["stemgen"]["request"]

raw = np.fromfile(name.with_suffix(".raw"), "<f4").reshape(*exact.shape[:2], 130, 128)
assert np.array_equal(raw[..., 127::-1, :], exact) and not raw[..., 128:, :].any()
about = json.loads(name.with_suffix(".json").read_text())
assert about["raw_filename"] == name.name + ".raw" and about["file_type"] == "empad_metadata"
assert about["scan_shape"] == [exact.shape[1], exact.shape[0]] and about["voltage"] == 2e5 and about["adu"] == 1
assert np.isclose(about["diff_step"], attributes["pixel_mrad"]) and np.isclose(about["scan_step"][0], 1e-10 * attributes["step_angstrom"][0])
root = tree.parse(name.with_suffix(".xml")).getroot()
assert root.find("raw_file").attrib["filename"] == name.name + ".raw"
# HyperSpy reads these two, and no element with white space in it.
assert [int(root.find(key).text) for key in ("pix_x", "pix_y")] == [exact.shape[1], exact.shape[0]]
assert root.text is None and all(part.tail is None for part in root)
acquired = root.find("scan_parameters[@mode='acquire']")
assert int(acquired.find("scan_resolution_x").text) == exact.shape[1] and int(acquired.find("scan_resolution_y").text) == exact.shape[0]
print(*exact.shape, exact.sum())
