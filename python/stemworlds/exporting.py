"""Writes samples to files for the training of networks."""

from __future__ import annotations

import csv
import io
import json
import os
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from . import _core
from .errors import _invalid
from .streaming import Sample, Stream

#: Number of corners of the polygon for a particle's outline.
_CORNERS = 32


def export(
    samples: Stream | Iterable[Sample],
    out: str | os.PathLike[str],
    *,
    count: int | None = None,
    overwrite: bool = False,
) -> str:
    """Writes samples to a file, in the format of its ending.

    ============ ================================================================================================
    ``.npz``     stacks ``images``, ``clean``, ``heat_maps``, ``class_masks``, ``phase_masks`` (N, H, W); ``dose``, ``pixel_nm``,
                 ``angle_deg``, ``centre_nm`` (x, y), ``index`` and ``source`` of each sample; ``recipes`` (TOML, by source); ``columns``.
                 ``stemgen tiles`` writes this format too
    ``.h5``      the arrays of ``.npz`` in HDF5; h5py has to be installed
    ``.csv``     ``columns``: sample (its index), x_px, y_px, class, number, occupancy, sites, vacancies, substitutions
    ``.parquet`` the table of ``.csv`` in Parquet; pyarrow has to be installed
    ``.json``    COCO: outlines of particles, one category for each shape, and the images as PNG in the folder ``NAME_images``
    ``.tar``     WebDataset: for each sample ``image.npy``, ``heat_map.npy``, ``class_mask.npy``, ``columns.json``
    ============ ================================================================================================

    Places are (x, y) in pixels from the centre of the first pixel. y runs down, along the rows of the images.

    Args:
        samples: a :class:`Stream`, or samples.
        count: number of samples. A stream needs it, since it is endless.

    Returns:
        The path of the file.
    """
    path = os.fspath(out)
    ending = os.path.splitext(path)[1].lower()
    if ending not in _WRITERS:
        raise _invalid("out", f"{path}: expected a name that ends in one of {', '.join(_WRITERS)}")
    if isinstance(samples, Stream):
        if count is None or count < 1:
            raise _invalid("count", f"count = {count}: a stream is endless; say how many samples")
        chosen: list[Sample] = list(samples.iterate(count=count))
    else:
        chosen = list(samples)[:count]
    if not chosen:
        raise _invalid("samples", "there are no samples to write")
    folder = f"{os.path.splitext(path)[0]}_images"
    taken = [name for name in (path, folder if ending == ".json" else path) if os.path.exists(name)]
    if taken and not overwrite:
        _core.write_file(taken[0], b"", False)
    if ending == ".json":
        data = _coco(chosen, os.path.basename(folder))
        _write_pictures(folder, chosen)
    else:
        data = _WRITERS[ending](chosen)
    _core.write_file(path, data, overwrite)
    return path


def _write_pictures(folder: str, samples: list[Sample]) -> None:
    os.makedirs(folder, exist_ok=True)
    for sample in samples:
        _core.write_file(os.path.join(folder, _picture(sample)), _png(sample.image), True)


def _picture(sample: Sample) -> str:
    return f"{sample.index:08d}.png"


def _grey(image: Any) -> tuple[float, float]:
    """Returns the values of black and white: the percentiles 0.1 and 99.9."""
    low, high = np.percentile(image, (0.1, 99.9))
    return float(low), float(high)


def _png(image: Any) -> bytes:
    """Returns the image as a PNG with 8 bits of grey, without resampling."""
    low, high = _grey(image)
    grey = np.clip((image - low) / (high - low or 1) * 255, 0, 255).round().astype(np.uint8)
    height, width = grey.shape
    # In PNG each row begins with the number of its filter; 0 is no filter.
    rows = np.concatenate([np.zeros((height, 1), np.uint8), grey], axis=1).tobytes()

    def part(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + part(b"IHDR", head) + part(b"IDAT", zlib.compress(rows, 6)) + part(b"IEND", b"")


def _stacks(samples: list[Sample]) -> dict[str, Any]:
    return {
        "images": np.stack([sample.image for sample in samples]),
        "clean": np.stack([sample.clean for sample in samples]),
        "heat_maps": np.stack([sample.targets.heat_map for sample in samples]),
        "class_masks": np.stack([sample.targets.class_mask for sample in samples]),
        "phase_masks": np.stack([sample.targets.phase_mask for sample in samples]),
        "dose": np.array([sample.dose for sample in samples]),
        "pixel_nm": np.array([sample.pixel_nm for sample in samples]),
        "angle_deg": np.array([sample.angle_deg for sample in samples]),
        "centre_nm": np.array([sample.centre_nm for sample in samples]),
        "index": np.array([sample.index for sample in samples]),
        "source": np.array([sample.source for sample in samples]),
        "recipes": _recipes(samples),
        "columns": _columns(samples),
    }


def _recipes(samples: list[Sample]) -> Any:
    """Returns the recipes by :attr:`Sample.source`; an empty text for recipes without a sample."""
    recipes = [""] * (1 + max(sample.source for sample in samples))
    for sample in samples:
        recipes[sample.source] = sample.recipe
    return np.array(recipes)


def _columns(samples: list[Sample]) -> Any:
    """Concatenates the columns of all samples, with the index of their sample."""
    fields = [("sample", "<i4"), *samples[0].targets.columns.dtype.descr]
    columns = np.zeros(sum(len(sample.targets.columns) for sample in samples), fields)
    first = 0
    for sample in samples:
        own = columns[first : first + len(sample.targets.columns)]
        own["sample"] = sample.index
        for name in sample.targets.columns.dtype.names or ():
            own[name] = sample.targets.columns[name]
        first += len(own)
    return columns


def _npz(samples: list[Sample]) -> bytes:
    # numpy.savez would store the time, while equal samples have to give equal bytes.
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, stack in _stacks(samples).items():
            member = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            archive.writestr(member, _npy(stack), compress_type=zipfile.ZIP_DEFLATED)
    return file.getvalue()


def _hdf5(samples: list[Sample]) -> bytes:
    import h5py

    file = io.BytesIO()
    with h5py.File(file, "w") as stacks:
        for name, stack in _stacks(samples).items():
            if name == "recipes":
                stack = stack.astype(object)
            stacks.create_dataset(name, data=stack, compression="gzip" if stack.ndim == 3 else None)
    return file.getvalue()


def _table(samples: list[Sample]) -> tuple[list[str], list[tuple[Any, ...]]]:
    columns = _columns(samples)
    return list(columns.dtype.names), columns.tolist()


def _csv(samples: list[Sample]) -> bytes:
    names, rows = _table(samples)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows(rows)
    return text.getvalue().encode()


def _parquet(samples: list[Sample]) -> bytes:
    import pyarrow
    import pyarrow.parquet

    names, rows = _table(samples)
    lists = zip(*rows, strict=True) if rows else [()] * len(names)
    file = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.table(dict(zip(names, map(list, lists), strict=True))), file)
    return file.getvalue()


def _coco(samples: list[Sample], folder: str = "") -> bytes:
    shapes = sorted({str(name) for sample in samples for name in sample.targets.particles["morphology"]})
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for sample in samples:
        height, width = sample.image.shape
        image: dict[str, Any] = {"id": sample.index, "file_name": f"{folder}/{_picture(sample)}", "height": height, "width": width}
        about = {"dose": sample.dose, "pixel_nm": sample.pixel_nm, "angle_deg": sample.angle_deg, "centre_nm": list(sample.centre_nm)}
        images.append({**image, **about, "source": sample.source, "grey_from_to": list(_grey(sample.image))})
        for particle in sample.targets.particles:
            outline = _outline(particle, width, height)
            if outline is None:
                continue
            low, high = outline.min(axis=0), outline.max(axis=0)
            x, y = outline.T
            area = 0.5 * abs(float(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))))
            annotations.append(
                {
                    "id": len(annotations) + 1,
                    "image_id": sample.index,
                    "category_id": 1 + shapes.index(str(particle["morphology"])),
                    "segmentation": [np.round(outline, 3).ravel().tolist()],
                    "bbox": [*np.round(low, 3).tolist(), *np.round(high - low, 3).tolist()],
                    "area": round(area, 3),
                    "iscrowd": 0,
                }
            )
    if not annotations:
        raise _invalid(
            "samples", "no sample shows a particle, and COCO holds outlines of particles; columns go to .csv, .parquet, .npz, .h5 or .tar"
        )
    categories = [{"id": 1 + n, "name": name, "supercategory": "particle"} for n, name in enumerate(shapes)]
    info = {"recipes": _recipes(samples).tolist()}
    return json.dumps({"info": info, "images": images, "annotations": annotations, "categories": categories}).encode()


def _outline(particle: Any, width: int, height: int) -> Any:
    """Returns the corners (x, y) of the outline, clipped to the image. COCO counts from the corner of the first pixel."""
    turn = np.linspace(0, 2 * np.pi, _CORNERS, endpoint=False)
    x = particle["x_px"] + 0.5 + particle["radius_px"] * np.cos(turn)
    y = particle["y_px"] + 0.5 + particle["radius_px"] * np.sin(turn)
    outline = np.stack([x.clip(0, width), y.clip(0, height)], axis=1)
    return outline if np.ptp(outline, axis=0).min() > 1e-3 else None


def _webdataset(samples: list[Sample]) -> bytes:
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        for sample in samples:
            targets = sample.targets
            about: dict[str, Any] = {"index": sample.index, "dose": sample.dose, "pixel_nm": sample.pixel_nm, "angle_deg": sample.angle_deg}
            about |= {"centre_nm": list(sample.centre_nm), "source": sample.source, "recipe": sample.recipe}
            names = targets.columns.dtype.names or ()
            about["columns"] = [dict(zip(names, row, strict=True)) for row in targets.columns.tolist()]
            arrays = {"image.npy": sample.image, "heat_map.npy": targets.heat_map, "class_mask.npy": targets.class_mask}
            members = {name: _npy(array) for name, array in arrays.items()}
            members["columns.json"] = json.dumps(about).encode()
            for name, data in members.items():
                member = tarfile.TarInfo(f"{sample.index:08d}.{name}")
                member.size = len(data)
                tar.addfile(member, io.BytesIO(data))
    return file.getvalue()


def _npy(array: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, array, allow_pickle=False)
    return file.getvalue()


_WRITERS: dict[str, Callable[[list[Sample]], bytes]] = {
    ".npz": _npz,
    ".h5": _hdf5,
    ".csv": _csv,
    ".parquet": _parquet,
    ".json": _coco,
    ".tar": _webdataset,
}
