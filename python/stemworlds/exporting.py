"""Samples as files that others train on."""

from __future__ import annotations

import csv
import io
import json
import os
import tarfile
import zipfile
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from . import _core
from .errors import _invalid
from .streaming import Sample, Stream

#: Pixels of the polygon that stands for a particle's outline.
_CORNERS = 32


def export(
    samples: Stream | Iterable[Sample],
    out: str | os.PathLike[str],
    *,
    count: int | None = None,
    overwrite: bool = False,
) -> str:
    """Writes samples to a file; its ending says which.

    ============ ================================================================================================
    ``.npz``     stacks ``images``, ``clean``, ``heat_maps`` (N, H, W) float32, ``masks``, ``phase_masks`` (N, H, W); as AtomAI's
                 ``Segmentor.fit(images, masks)`` takes them
    ``.h5``      the same as HDF5; h5py has to be installed
    ``.csv``     columns: sample, x and y in pixels, class, number, occupancy, sites, vacancies, substitutions
    ``.parquet`` the same; pyarrow has to be installed
    ``.json``    COCO: outlines of particles, one category for each shape
    ``.tar``     WebDataset: for each sample ``image.npy``, ``heat_map.npy``, ``mask.npy``, ``columns.json``
    ============ ================================================================================================

    Args:
        samples: a :class:`Stream`, or samples.
        count: number of samples, needed for a stream, which is endless.

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
    if os.path.exists(path) and not overwrite:
        _core.write_file(path, b"", False)
    _core.write_file(path, _WRITERS[ending](chosen), overwrite)
    return path


def _stacks(samples: list[Sample]) -> dict[str, Any]:
    return {
        "images": np.stack([sample.image for sample in samples]),
        "clean": np.stack([sample.clean for sample in samples]),
        "heat_maps": np.stack([sample.targets.heat_map for sample in samples]),
        "masks": np.stack([sample.targets.class_mask for sample in samples]),
        "phase_masks": np.stack([sample.targets.phase_mask for sample in samples]),
        "dose": np.array([sample.dose for sample in samples]),
        "pixel_nm": np.array([sample.pixel_nm for sample in samples]),
        "index": np.array([sample.index for sample in samples]),
    }


def _npz(samples: list[Sample]) -> bytes:
    # Not by numpy.savez, which stores the time: the same samples make the same bytes.
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
            stacks.create_dataset(name, data=stack, compression="gzip" if stack.ndim == 3 else None)
    return file.getvalue()


def _table(samples: list[Sample]) -> tuple[list[str], list[tuple[Any, ...]]]:
    names = ["sample", *(samples[0].targets.columns.dtype.names or ())]
    rows = [(sample.index, *row) for sample in samples for row in sample.targets.columns.tolist()]
    return names, rows


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


def _coco(samples: list[Sample]) -> bytes:
    shapes = sorted({str(name) for sample in samples for name in sample.targets.particles["morphology"]})
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for sample in samples:
        height, width = sample.image.shape
        images.append({"id": sample.index, "file_name": f"{sample.index:08d}.tif", "height": height, "width": width})
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
    categories = [{"id": 1 + n, "name": name, "supercategory": "particle"} for n, name in enumerate(shapes)]
    return json.dumps({"images": images, "annotations": annotations, "categories": categories}).encode()


def _outline(particle: Any, width: int, height: int) -> Any:
    """Corners (x, y) of the outline within the image; COCO counts from the corner of the first pixel."""
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
            names = targets.columns.dtype.names or ()
            about["columns"] = [dict(zip(names, row, strict=True)) for row in targets.columns.tolist()]
            arrays = {"image.npy": sample.image, "heat_map.npy": targets.heat_map, "mask.npy": targets.class_mask}
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
