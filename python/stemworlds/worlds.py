"""Reads world files: the image of a specimen, and the truth about it."""

from __future__ import annotations

import base64
import csv
import html
import io
import json
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from . import _core
from ._forking import reading
from ._text import table_cell
from .errors import _invalid
from .images import Image
from .recipes import Recipe

StructuredArray = npt.NDArray[np.void]

#: Fields of :attr:`World.columns`.
COLUMN_DTYPE = np.dtype(
    [("x_nm", "f4"), ("y_nm", "f4"), ("sites", "i4"), ("vacancies", "i4"), ("substitutions", "i4"), ("composition", "U32")]
)
#: Fields of :attr:`World.sites`.
SITE_DTYPE = np.dtype(
    [("x_nm", "f4"), ("y_nm", "f4"), ("z_nm", "f4"), ("type", "i4"), ("defect", "?"), ("number", "i4"), ("column", "i4")]
)
#: Fields of :attr:`World.particles`.
PARTICLE_DTYPE = np.dtype(
    [("x_nm", "f4"), ("y_nm", "f4"), ("z_nm", "f4"), ("diameter_nm", "f4"), ("morphology", "U16"), ("orientation", "f4", (4,))]
)
#: Fields of :attr:`World.layers`: where a layer begins and ends along the stack, strain along x, y and z, and its turn about the beam.
LAYER_DTYPE = np.dtype(
    [("phase", "U32"), ("begin_nm", "f4"), ("end_nm", "f4"), ("strain", "f4", (3,)), ("turn_deg", "f4")]
)
#: Fields of :attr:`World.dislocations`: place of the line, and Burgers vector along x, y and z.
DISLOCATION_DTYPE = np.dtype([("x_nm", "f4"), ("y_nm", "f4"), ("burgers_nm", "f4", (3,))])
#: Names of the classes of columns. ``class`` in truth tables is an index into them; 0 is the background of masks.
COLUMN_CLASSES = ("background", "pristine", "vacancies", "substitutions", "vacancies and substitutions")


class Table:
    """A table of named columns with equal length."""

    def __init__(self, array: StructuredArray) -> None:
        #: The table as a structured array.
        self.array = array

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(self.array.dtype.names or ())

    def __len__(self) -> int:
        return len(self.array)

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        return self.array[name]

    def to_pandas(self) -> Any:
        """Returns the table as a ``pandas.DataFrame``. pandas has to be installed."""
        import pandas

        return pandas.DataFrame({name: self.array[name] for name in self.names})

    def to_csv(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Writes the table as CSV. Texts that a spreadsheet would read as a formula, for example with a leading =, get a leading
        apostrophe."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.names)
        writer.writerows(map(table_cell, row) for row in self.array.tolist())
        _core.write_file(os.fspath(path), text.getvalue().encode(), overwrite)

    def __repr__(self) -> str:
        return f"<Table of {len(self)} rows: {', '.join(self.names)}>"

    def _repr_html_(self) -> str:
        head = "".join(f"<th>{html.escape(name)}</th>" for name in self.names)
        rows = ("".join(f"<td>{html.escape(f'{value}')}</td>" for value in row) for row in self.array[:10].tolist())
        body = "".join(f"<tr>{row}</tr>" for row in rows)
        return f"<table><tr>{head}</tr>{body}</table><p>{len(self)} rows</p>"


@dataclass(frozen=True)
class WorldMetadata:
    """Metadata of a world. Values that are missing in files of other programs are ``None``.

    Attributes:
        pixel_nm: edge of a pixel in nm.
        tile_size_px, overlap_px: edge and overlap of tiles.
        grid: rows and columns of tiles.
        shape: height and width in pixels.
        fov_nm: height and width in nm.
        scaling: scale and offset, fraction of the beam = value * scale + offset.
        phases: names of the phases by their codes.
        detectors: inner and outer angle in mrad of each detector, the main one first; empty for a world with one unnamed detector.
        centres_of_mass: axis, ``"x"`` or ``"y"``, of the detectors that are images of a centre of mass, in mrad.
        sectors: azimuths in degrees, from +x towards +y, between which the detectors lie that are sectors of an annulus.
    """

    pixel_nm: float
    tile_size_px: int
    overlap_px: int
    grid: tuple[int, int]
    shape: tuple[int, int]
    fov_nm: tuple[float, float]
    scaling: tuple[float, float] | None
    recipe: str | None
    version: str | None
    source: str | None
    engine: str | None
    engine_parameters: str | None
    material: str | None
    thickness_nm: float | None
    dose_electrons_per_angstrom2: float | None
    noise: bool | None
    seed: int | None
    wall_time_s: float | None
    has_clean: bool
    phases: tuple[str, ...]
    site_count: int
    detectors: Mapping[str, tuple[float, float]]
    centres_of_mass: Mapping[str, str]
    sectors: Mapping[str, tuple[float, float]]


class World:
    """A world file, open for reading.

    Places are ``(x, y)`` in nm from the centre of pixel (0, 0); images are ``[y, x]``. The file may be open in h5py at the same time.
    ``with World(path) as world`` closes it at the end.

    Args:
        path: the file.
        check: read the whole file first in a separate process, since a damaged file may crash or hang the HDF5 library.

    Raises:
        FileMissing, FileForbidden: if the file does not exist, or may not be read.
        FormatError: for a file that is no world, or is damaged.
    """

    def __init__(self, path: str | os.PathLike[str], *, check: bool = False) -> None:
        self.path: str = os.fspath(path)
        #: Facts about the build, if :func:`build` has just built the world.
        self.summary: Mapping[str, Any] | None = None
        if check:
            _core.check_file(self.path, [sys.executable, "-m", "stemworlds"])
        self._reader = reading(_core.WorldReader)(self.path)
        facts = json.loads(reading(self._reader.metadata)())
        for name in ("grid", "shape", "fov_nm", "scaling", "phases"):
            facts[name] = None if facts[name] is None else tuple(facts[name])
        axes = {one["name"]: one.get("centre_of_mass") for one in facts["detectors"]}
        facts["centres_of_mass"] = {name: axis for name, axis in axes.items() if axis is not None}
        parts = {one["name"]: one.get("sector_degrees") for one in facts["detectors"]}
        facts["sectors"] = {name: tuple(azimuths) for name, azimuths in parts.items() if azimuths is not None}
        facts["detectors"] = {one["name"]: (one["inner_mrad"], one["outer_mrad"]) for one in facts["detectors"]}
        self.metadata: WorldMetadata = WorldMetadata(**facts)

    def close(self) -> None:
        """Closes the file. The next read opens it again."""
        reading(self._reader.close)()

    def __enter__(self) -> World:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __reduce__(self) -> tuple[type[World], tuple[str]]:
        return World, (self.path,)

    def __repr__(self) -> str:
        rows, columns = self.grid
        return f"<World {self.path}: {rows} x {columns} tiles, {self.metadata.site_count} sites>"

    @property
    def pixel_nm(self) -> float:
        """Edge of a pixel in nm."""
        return self.metadata.pixel_nm

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of tiles."""
        return self.metadata.grid

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the image in pixels."""
        return self.metadata.shape

    @property
    def fov_nm(self) -> tuple[float, float]:
        """Height and width of the image in nm."""
        return self.metadata.fov_nm

    @property
    def recipe(self) -> Recipe:
        """The recipe of the world.

        Raises:
            InvalidValue: if the file contains no recipe.
        """
        if self.metadata.recipe is None:
            raise _invalid("path", f"{self.path}: holds no recipe; it was not built by stemgen")
        return Recipe(self.metadata.recipe)

    @property
    def detectors(self) -> Mapping[str, tuple[float, float]]:
        """Inner and outer angle in mrad of each detector, the main one first; empty for a world with one unnamed detector."""
        return self.metadata.detectors

    def tile(self, row: int, column: int, *, clean: bool = False, detector: str | None = None) -> Image:
        """Returns a tile: normalised as in the file (0 to 1), or without noise in fractions of the beam.

        Args:
            row, column: row and column of the tile, from 0.
            clean: return the noise-free tile.
            detector: name of one of :attr:`detectors`; the main one by default.
        """
        stride = self.metadata.tile_size_px - self.metadata.overlap_px
        if row < 0 or column < 0:
            raise _invalid("grid", f"tile {row}, {column}: tiles are counted from 0")
        return self._image(f"tile {row}, {column}", reading(self._reader.tile)(row, column, clean, detector), (row * stride, column * stride), clean, detector)

    def image(
        self, region_nm: tuple[float, float, float, float] | None = None, *, clean: bool = False, detector: str | None = None
    ) -> Image:
        """Returns the image of a region, left, upper, right and lower edge in nm; by default the whole image.

        Args:
            region_nm: the region. The image contains all pixels that it touches.
            clean: return the image without noise, in fractions of the beam, for a world built with ``keep_clean=True``; otherwise the image
                is normalised as in the file, 0 to 1.
            detector: name of one of :attr:`detectors`; the main one by default.
        """
        rows, columns = self._pixels(region_nm)
        array = reading(self._reader.image)(rows, columns, clean, detector)
        return self._image("world", array, (rows[0], columns[0]), clean, detector)

    def fractions(self, image: Image, *, detector: str | None = None) -> npt.NDArray[np.float32]:
        """Converts a normalised image of a detector to fractions of the beam, or of a centre of mass to mrad."""
        scaling = reading(self._reader.scaling)(detector)
        if scaling is None:
            raise _invalid("path", f"{self.path}: tells no scaling")
        scale, offset = scaling
        return (image.array * scale + offset).astype(np.float32)

    def overview(self, *, detector: str | None = None) -> Image:
        """Returns the whole image, reduced by a factor of 8 along each axis."""
        array = reading(self._reader.overview)(detector)
        pixel = 8 * self.pixel_nm
        shift = 3.5 * self.pixel_nm
        return Image("overview", array, (pixel, pixel), (shift, shift), units="normalised, 0 to 1")

    @property
    def columns(self) -> StructuredArray:
        """All atomic columns, a structured array of :data:`COLUMN_DTYPE`."""
        found = reading(self._reader.columns)()
        out = np.zeros(len(found["positions_nm"]), COLUMN_DTYPE)
        out["x_nm"], out["y_nm"] = found["positions_nm"].reshape(-1, 2).T
        out["sites"], out["vacancies"], out["substitutions"] = found["counts"].reshape(-1, 3).T
        out["composition"] = np.frombuffer(found["compositions"], "S32").astype("U32")
        return out

    @property
    def sites(self) -> StructuredArray:
        """All lattice sites, with vacant ones, a structured array of :data:`SITE_DTYPE`.

        ``type`` is 0 pristine, 1 vacancy, 2 substitution. ``number`` is the atomic number of the atom, for a vacancy of the missing atom.
        ``column`` is an index into :attr:`columns`. Values that are missing in a file of another program are -1 or NaN.
        """
        found = reading(self._reader.sites)()
        out = np.zeros(len(found["types"]), SITE_DTYPE)
        out["x_nm"], out["y_nm"] = found["positions_nm"].reshape(-1, 2).T
        out["type"], out["defect"] = found["types"], found["defects"]
        for name, list_name, missing in (("z_nm", "z_nm", np.nan), ("number", "numbers", -1), ("column", "columns", -1)):
            out[name] = found[list_name] if len(found[list_name]) else missing
        return out

    @property
    def defect_names(self) -> npt.NDArray[np.bytes_]:
        """Name of the defect at each site, for example ``b"vacancy_O"``; empty for a site without a defect."""
        return np.frombuffer(reading(self._reader.sites)()["names"], "S16")

    @property
    def particles(self) -> StructuredArray:
        """Particles that overlap the image, a structured array of :data:`PARTICLE_DTYPE`; empty in most worlds."""
        found = reading(self._reader.particles)()
        out = np.zeros(len(found["diameters_nm"]), PARTICLE_DTYPE)
        out["x_nm"], out["y_nm"], out["z_nm"] = found["centres_nm"].reshape(-1, 3).T
        out["diameter_nm"], out["morphology"] = found["diameters_nm"], found["morphologies"]
        out["orientation"] = found["orientations"].reshape(-1, 4)
        return out

    @property
    def boundaries(self) -> list[tuple[str, npt.NDArray[np.float32]]]:
        """Boundaries of grains and phases, and planar faults: what each separates or its kind, as text, and its corners ``[point, (x, y)]`` in nm."""
        return reading(self._reader.boundaries)()

    @property
    def layers(self) -> StructuredArray:
        """Layers of a stack, a structured array of :data:`LAYER_DTYPE`; empty in other worlds."""
        rows = reading(self._reader.layers)()
        listed = [(phase, begin, end, strain, turn) for phase, (begin, end), strain, turn in rows]
        return np.array(listed, LAYER_DTYPE)

    @property
    def dislocations(self) -> StructuredArray:
        """Dislocations along the beam, a structured array of :data:`DISLOCATION_DTYPE`; empty in most worlds."""
        rows = reading(self._reader.dislocations)()
        return np.array([(x, y, burgers) for (x, y), burgers in rows], DISLOCATION_DTYPE)

    @property
    def phase_map(self) -> npt.NDArray[np.int32] | None:
        """Phase of each pixel, ``[y, x]``, an index into ``metadata.phases``; ``None`` in a world of one phase."""
        height, width = self.shape
        return reading(self._reader.phase_map)((0, height), (0, width))

    def truth_table(self, region_nm: tuple[float, float, float, float] | None = None) -> Table:
        """Returns the atomic columns as a table: places in nm and pixels, atoms and defects, and class (:data:`COLUMN_CLASSES`).

        Args:
            region_nm: the region of the columns. ``x_px`` and ``y_px`` then count from the first pixel of :meth:`image` of this region.
        """
        columns = self.columns
        (first_row, last_row), (first_column, last_column) = self._pixels(region_nm)
        x, y = columns["x_nm"] / self.pixel_nm - first_column, columns["y_nm"] / self.pixel_nm - first_row
        if region_nm is not None:
            inside = (x > -0.5) & (x < last_column - first_column - 0.5) & (y > -0.5) & (y < last_row - first_row - 0.5)
            columns, x, y = columns[inside], x[inside], y[inside]
        more = [("x_px", "f4"), ("y_px", "f4"), ("class", "i4"), ("phase", "i4")]
        out = np.zeros(len(columns), COLUMN_DTYPE.descr + more)
        for name in COLUMN_DTYPE.names or ():
            out[name] = columns[name]
        out["x_px"], out["y_px"] = x, y
        out["class"] = 1 + (columns["vacancies"] > 0) + 2 * (columns["substitutions"] > 0)
        phases = reading(self._reader.phase_map)((first_row, last_row), (first_column, last_column))
        if phases is not None:
            rows, places = (np.rint(v).astype(int) for v in (y, x))
            out["phase"] = phases[rows.clip(0, phases.shape[0] - 1), places.clip(0, phases.shape[1] - 1)]
        return Table(out)

    def plot(
        self,
        region_nm: tuple[float, float, float, float] | None = None,
        *,
        clean: bool = False,
        overlay: Literal["defects", "columns"] | None = None,
        ax: Any = None,
        **options: Any,
    ) -> Any:
        """Draws a region with matplotlib, optionally with columns or defects. Returns the axes."""
        image = self.image(region_nm, clean=clean)
        ax = image.plot(ax, **options)
        if overlay is not None:
            table = self.truth_table(region_nm)
            shown = table.array[table["class"] > 1] if overlay == "defects" else table.array
            ax.plot(shown["x_nm"], shown["y_nm"], "o", fillstyle="none", color="C1", label=overlay)
        return ax

    def _repr_html_(self) -> str:
        picture = base64.b64encode(reading(self._reader.png)()).decode()
        return f'<figure><img src="data:image/png;base64,{picture}"><figcaption>{html.escape(repr(self))}</figcaption></figure>'

    def _image(self, name: str, array: npt.NDArray[np.float32], first: tuple[int, int], clean: bool, detector: str | None) -> Image:
        pixel = self.pixel_nm
        own = "mrad" if detector in self.metadata.centres_of_mass else "fraction of the incident beam"
        units = own if clean else "normalised, 0 to 1"
        return Image(name, array, (pixel, pixel), (first[0] * pixel, first[1] * pixel), units=units)

    def _pixels(self, region_nm: tuple[float, float, float, float] | None) -> tuple[tuple[int, int], tuple[int, int]]:
        height, width = self.shape
        if region_nm is None:
            return (0, height), (0, width)
        try:
            x0, y0, x1, y1 = (float(v) for v in region_nm)
        except (TypeError, ValueError):
            raise _invalid("region_nm", f"{region_nm!r}: expected left, upper, right and lower edge in nm") from None
        if not (x0 < x1 and y0 < y1 and np.isfinite([x0, y0, x1, y1]).all()):
            raise _invalid("region_nm", f"{x0}, {y0}, {x1}, {y1}: the right and lower edge lie right of and below the others")

        def pixels(low: float, high: float, size: int) -> tuple[int, int]:
            first = int(np.clip(np.floor(low / self.pixel_nm + 0.5), 0, size))
            return first, int(np.clip(np.ceil(high / self.pixel_nm + 0.5), 0, size))

        rows, columns = pixels(y0, y1, height), pixels(x0, x1, width)
        if rows[0] >= rows[1] or columns[0] >= columns[1]:
            high, wide = self.fov_nm
            raise _invalid("region_nm", f"{x0}, {y0}, {x1}, {y1} lies outside the world, 0, 0 to {wide:.2f}, {high:.2f} nm")
        return rows, columns
