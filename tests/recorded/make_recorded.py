"""Small images as other programs store them, for tests of `stemgen import`.

    pip install h5py==3.16.0 tifffile==2026.3.3 rosettasciio==0.15.0
    python tests/recorded/make_recorded.py

Each file holds one image of 5 x 3 pixels (x, y), 0.02 nm wide, with the value 10 y + x at (x, y): a reader that takes x for
y, or forgets the size of a pixel, is found out. Those called `..._xy` store it as [x, y], and name their axes.

rosettasciio writes the Berkeley EMD and the HyperSpy file, tifffile the TIFFs. Velox, Prismatic and NeXus files are laid out
here as those programs and the definition NXdata have them.
"""

import json
from pathlib import Path

import h5py
import numpy as np
import tifffile
from rsciio import emd, hspy

HERE = Path(__file__).resolve().parent
NM = 0.02
IMAGE = (10 * np.arange(3)[:, None] + np.arange(5)).astype(np.float32)


def signal(names: list[str]) -> dict:
    """A signal as HyperSpy hands it to its writers."""
    data = IMAGE if names == ["y", "x"] else IMAGE.T
    axes = [
        {"name": name, "size": size, "scale": NM, "offset": 0.0, "units": "nm", "navigate": False, "index_in_array": i}
        | {"_type": "UniformDataAxis"}
        for i, (name, size) in enumerate(zip(names, data.shape, strict=True))
    ]
    empty = {name: {} for name in ("original_metadata", "tmp_parameters", "learning_results", "models")}
    package = {"package": "hyperspy", "package_version": "2.3.0", "package_info": {}}
    metadata = {"General": {"title": "image"}, "Signal": {"signal_type": ""}}
    return {"data": data, "axes": axes, "metadata": metadata, "attributes": {"_lazy": False}} | empty | package


def scales(at: h5py.Group, places: dict[str, tuple[int, str]], step: float) -> None:
    """A list of places for each axis, with its unit."""
    for name, (size, unit) in places.items():
        at[name] = step * np.arange(size)
        at[name].attrs["units"] = unit


def nexus() -> None:
    with h5py.File(HERE / "nexus_xy.nxs", "w") as file:
        data = file.create_group("entry/data")
        data.attrs.update({"NX_class": "NXdata", "signal": "intensity", "axes": ["x", "y"]})
        data["intensity"] = IMAGE.T
        scales(data, {"x": (5, "nm"), "y": (3, "nm")}, NM)
    # as before 2014: names stand beside the image
    with h5py.File(HERE / "nexus_old_xy.nxs", "w") as file:
        data = file.create_group("entry/data")
        data.attrs["NX_class"] = "NXdata"
        data["counts"] = IMAGE.T
        data["counts"].attrs.update({"signal": 1, "axes": "x:y"})
        scales(data, {"x": (5, "angstrom"), "y": (3, "angstrom")}, 10 * NM)


def dimension_scales() -> None:
    with h5py.File(HERE / "labels_xy.h5", "w") as file:
        image = file.create_dataset("run/image", data=IMAGE.T)
        scales(file.create_group("axes"), {"along": (5, "um"), "down": (3, "um")}, 1e-3 * NM)
        for i, (label, name) in enumerate([("x", "along"), ("y", "down")]):
            image.dims[i].label = label
            file["axes"][name].make_scale(name)
            image.dims[i].attach_scale(file["axes"][name])
    # as netCDF-4 has it: names of scales alone
    with h5py.File(HERE / "scales_xy.h5", "w") as file:
        image = file.create_dataset("image", data=IMAGE.T)
        scales(file, {"x": (5, "m"), "y": (3, "m")}, 1e-9 * NM)
        for i, name in enumerate("xy"):
            file[name].make_scale("This is a netCDF dimension but not a netCDF variable.         5")
            image.dims[i].attach_scale(file[name])


def prismatic() -> None:
    """Prismatic 1.2 calls its Angstrom `[n_m]`."""
    with h5py.File(HERE / "prismatic_xy.h5", "w") as file:
        group = file.create_group("4DSTEM_simulation/data/realslices/annular_detector_depth0000")
        group["data"] = IMAGE.T
        for name, axis, size in [("dim1", "R_x", 5), ("dim2", "R_y", 3)]:
            group[name] = (10 * NM * np.arange(size)).astype(np.float32)
            group[name].attrs.update({"name": np.bytes_(axis), "units": np.bytes_("[n_m]")})


def velox() -> None:
    """Four images of one segmented detector, the last with its Fourier transform."""
    with h5py.File(HERE / "velox_segments.emd", "w") as file:
        text = h5py.string_dtype()
        for k, label in enumerate(["DF4-A", "DF4-B", "iDPC", "FFT"]):
            identifier = f"{k}0123456789abcdef0123456789abcde"
            group = file.create_group(f"Data/Image/{identifier}")
            frames = (IMAGE + 100 * k)[:, :, None]
            group["Data"] = frames.astype(np.complex64) if label == "FFT" else frames
            size = {"width": str(1e-9 * NM), "height": str(1e-9 * NM)}
            told = {"BinaryResult": {"Detector": "DF4", "PixelUnitX": "m", "PixelUnitY": "m", "PixelSize": size}}
            group["Metadata"] = np.frombuffer(json.dumps(told).encode(), np.uint8)[:, None]
            display = {"dataPath": f"/Data/Image/{identifier}", "display": {"label": label}}
            displays = file.require_group("Presentation/Displays/ImageDisplay")
            displays.create_dataset(f"d{k}", data=[json.dumps(display)], dtype=text)


def tiffs() -> None:
    grey = IMAGE.astype(np.uint16)
    pixels = {"PhysicalSizeX": NM, "PhysicalSizeXUnit": "nm", "PhysicalSizeY": NM, "PhysicalSizeYUnit": "nm"}
    tifffile.imwrite(HERE / "imagej.tif", IMAGE, imagej=True, resolution=(1 / NM, 1 / NM), metadata={"unit": "nm"})
    micrometres = {"unit": "\\u00B5m"}
    tifffile.imwrite(HERE / "imagej_um.tif", grey, imagej=True, resolution=(1e3 / NM,) * 2, metadata=micrometres)
    tifffile.imwrite(HERE / "ome.ome.tif", IMAGE, metadata={"axes": "YX", "UUID": f"urn:uuid:{'0' * 8}"} | pixels)
    tifffile.imwrite(HERE / "resolution.tif", IMAGE, resolution=(1e7 / NM,) * 2, resolutionunit="CENTIMETER")
    tifffile.imwrite(HERE / "printer.tif", grey, resolution=(300, 300), resolutionunit="INCH")
    tifffile.imwrite(HERE / "white_is_zero.tif", 65535 - grey, photometric="miniswhite")
    tifffile.imwrite(HERE / "white_is_zero_float.tif", IMAGE, photometric="miniswhite")


# It stores the axes of a signal in the opposite order.
emd.file_writer(str(HERE / "berkeley_xy.emd"), signal(["y", "x"]))
hspy.file_writer(str(HERE / "hyperspy_xy.hspy"), signal(["x", "y"]), compression=None)
nexus()
dimension_scales()
prismatic()
velox()
tiffs()
