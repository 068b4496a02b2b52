"""Makes worlds from recorded images."""

from __future__ import annotations

import json
import os

from . import _core
from ._running import Progress, call, running
from .checking import check_file
from .worlds import World

Path = str | os.PathLike[str]


def import_image(
    path: Path,
    *,
    out: Path,
    dataset: str | None = None,
    index: int | None = None,
    pixel_nm: float | None = None,
    spacing_nm: float | None = None,
    contrast: tuple[float, float] = (0.1, 99.9),
    overwrite: bool = False,
    check: bool = True,
    threads: int | None = None,
    progress: Progress = False,
) -> World:
    """Makes a world from a recorded image: DM3, DM4, Velox EMD, HyperSpy, other HDF5, TIFF, NumPy, zarr.

    If the file names its axes x and y, they determine the orientation; an image ``[x, y]`` is transposed. ``summary`` of the world contains
    the properties of the image, and in ``notes`` its changes, as ``stemgen import --json`` prints them.

    Args:
        path: the file.
        out: the world.
        dataset: the image to read from a file with several: its name, or the path of a data set.
        index: number of the frame, from 0, of an image with several frames.
        pixel_nm: edge of a pixel, instead of the file's value.
        spacing_nm: spacing of planes of the crystal, from which the pixel size is measured in the Fourier transform. The result has to be
            within 15 % of the pixel size of the file, or of ``pixel_nm``.
        contrast: percentiles of the recorded values that become 0 and 1.
        check: read the file first in a separate process, see :class:`World`.

    Raises:
        FormatError: for a file that is damaged, or contains no image.
        InvalidValue: if the pixel size is unknown, if the file contains several images and none is chosen, or if the image is smaller than
            a tile.
    """
    if check:
        check_file(os.fspath(path))
    options: _core.ImportOptions = {
        "path": os.fspath(path),
        "out": os.fspath(out),
        "overwrite": overwrite,
        "dataset": dataset,
        "index": index,
        "pixel_nm": pixel_nm,
        "spacing_nm": spacing_nm,
        "contrast": contrast,
    }
    facts = call(_core.import_image, options, running(threads, progress))
    world = World(out)
    world.summary = json.loads(facts)
    return world
