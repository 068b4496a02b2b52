"""Lays out the atoms of a recipe's specimen."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _core
from ._running import Progress, call, running
from .atoms import AtomArrays
from .recipes import Recipe, RecipeLike

_PRISTINE, _VACANCY, _SUBSTITUTION = 0, 1, 2
_SYMBOLS = (
    "X H He Li Be B C N O F Ne Na Mg Al Si P S Cl Ar K Ca Sc Ti V Cr Mn Fe Co Ni Cu Zn Ga Ge As Se Br Kr Rb Sr Y Zr Nb Mo Tc Ru Rh Pd "
    "Ag Cd In Sn Sb Te I Xe Cs Ba La Ce Pr Nd Pm Sm Eu Gd Tb Dy Ho Er Tm Yb Lu Hf Ta W Re Os Ir Pt Au Hg Tl Pb Bi Po At Rn Fr Ra Ac Th "
    "Pa U Np Pu Am Cm Bk Cf Es Fm Md No Lr"
).split()


def specimen(
    recipe: RecipeLike,
    region_nm: tuple[float, float, float, float] | None = None,
    *,
    vacancies: bool = False,
    vacuum_angstrom: float = 2.0,
    threads: int | None = None,
    progress: Progress = False,
    **changes: Any,
) -> Any:
    """Lays out the atoms of a recipe's specimen. Returns ``ase.Atoms`` if ASE is installed, otherwise :class:`AtomArrays`.

    In addition to positions and numbers, each atom has ``column``, the index of its atomic column, ``defect`` (``"substitution_Ge"``, or
    ``"none"``) and ``atom_type`` (0 pristine, 1 vacancy, 2 substitution). Carbon on the faces (``[surface]`` of the recipe) comes last, in
    column -1. z counts from the entrance face of the beam.

    Args:
        recipe: name, path, TOML, dict or :class:`Recipe`.
        region_nm: region of the columns, left, upper, right and lower edge, from the centre of the first built pixel. Its columns are
            numbered from 0. Without a region, columns have their numbers in the truth of a world.
        vacancies: include vacant sites, as atoms with the number 0 (``X``).
        vacuum_angstrom: empty space at the edges of the cell, since the field is cut out of a larger specimen.
        **changes: ``difficulty``, ``set``, ``unset``, ``grid``, ``seed``, see :class:`Recipe`.
    """
    arrays = specimen_arrays(
        recipe,
        region_nm,
        vacancies=vacancies,
        vacuum_angstrom=vacuum_angstrom,
        threads=threads,
        progress=progress,
        **changes,
    )
    return arrays.to_ase() if importlib.util.find_spec("ase") else arrays


def specimen_arrays(
    recipe: RecipeLike,
    region_nm: tuple[float, float, float, float] | None = None,
    *,
    vacancies: bool = False,
    vacuum_angstrom: float = 2.0,
    threads: int | None = None,
    progress: Progress = False,
    **changes: Any,
) -> AtomArrays:
    """Lays out the atoms of a recipe's specimen as plain arrays, with the arguments of :func:`specimen`."""
    difficulty = changes.pop("difficulty", None)
    resolved = Recipe(recipe, difficulty, **changes)
    found = call(_core.specimen_sites, resolved.toml, region_nm, running(threads, progress))
    types, numbers = found["types"], found["numbers"]
    (x0, x1), (y0, y1) = found["x_nm"], found["y_nm"]
    corner = np.array([x0 - 0.05 * vacuum_angstrom, y0 - 0.05 * vacuum_angstrom, 0.0])
    edges = [10 * (x1 - x0), 10 * (y1 - y0), 10 * found["thickness_nm"]]
    defect = _defects(types, numbers)
    vacant = types == _VACANCY
    keep = np.ones_like(vacant) if vacancies else ~vacant
    return AtomArrays(
        numbers=np.where(vacant, 0, numbers)[keep],
        positions=10 * (found["positions_nm"].reshape(-1, 3) - corner)[keep],
        cell=np.diag(np.add(edges, vacuum_angstrom)),
        arrays={"column": found["columns"][keep], "defect": defect[keep], "atom_type": types[keep]},
    )


def _defects(types: npt.NDArray[np.int32], numbers: npt.NDArray[np.int32]) -> npt.NDArray[np.str_]:
    out = np.full(len(types), "none", "U16")
    for kind, word in ((_VACANCY, "vacancy"), (_SUBSTITUTION, "substitution")):
        for number in np.unique(numbers[types == kind]):
            out[(types == kind) & (numbers == number)] = f"{word}_{_SYMBOLS[number]}"
    return out
