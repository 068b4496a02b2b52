"""Worlds of recorded images."""

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
    """Makes a world of a recorded image: DM3, DM4, Velox EMD, HyperSpy, other HDF5, TIFF, NumPy, zarr.

    Axes that the file calls x and y decide how the image lies; it is transposed where the file holds it as ``[x, y]``. ``summary`` of the
    world says what was found (``notes``: what was done to it), as ``stemgen import --json`` does.

    Args:
        path: the file.
        out: the world.
        dataset: which image of a file that holds several: its name, or the path of a data set.
        index: which frame of an image that has several, from 0.
        pixel_nm: edge of a pixel, in place of the file's.
        spacing_nm: a distance of planes of the crystal, by which the pixel is measured in the Fourier transform; it shows within 15 % of
            where the file, or ``pixel_nm``, has it.
        contrast: percentiles of the recorded values that become 0 and 1.
        check: first reads the file through in a process of its own, as :class:`World` does.

    Raises:
        FormatError: for a file that is damaged, or holds no such image.
        InvalidValue: where the size of a pixel is not known, several images are there and none is chosen, or the image is
            smaller than a tile.
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
