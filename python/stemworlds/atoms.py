"""Converts atoms between ASE, files and plain arrays."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from . import _core
from .errors import _invalid


@runtime_checkable
class AseAtoms(Protocol):
    """The methods of ``ase.Atoms`` that are used. ASE need not be installed."""

    def get_atomic_numbers(self) -> Any: ...
    def get_positions(self) -> Any: ...
    def get_cell(self) -> Any: ...


@dataclass(frozen=True, eq=False)
class AtomArrays:
    """Atoms in a cell, as plain arrays.

    Attributes:
        numbers: atomic numbers, ``[atom]``.
        positions: ``[atom, 3]`` in Angstrom; the beam runs along +z.
        cell: vectors as rows, ``[3, 3]``, in Angstrom.
        occupancies: fraction of its site that each atom occupies, ``[atom]``, above 0 and at most 1; atoms within 0.01 A share a site.
            All 1 by default.
        arrays: further arrays by name, one value for each atom. Specimens have ``column``, the index of the atomic column in the truth of a
            world, or -1; ``defect``, for example ``"substitution_Ge"`` or ``"none"``; ``atom_type``, 0 pristine, 1 vacancy, 2 substitution.
    """

    numbers: npt.NDArray[np.int32]
    positions: npt.NDArray[np.float64]
    cell: npt.NDArray[np.float64]
    arrays: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)
    occupancies: npt.NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return len(self.numbers)

    def to_ase(self) -> Any:
        """Returns the atoms as ``ase.Atoms``, with ``arrays``. ASE has to be installed."""
        from ase import Atoms

        atoms = Atoms(numbers=self.numbers, positions=self.positions, cell=self.cell, pbc=False)
        for name, values in self.arrays.items():
            atoms.set_array(name, np.asarray(values))
        return atoms


#: Atoms of ASE, plain arrays, or the path of a file: CIF, extended XYZ or POSCAR.
Atoms = AseAtoms | AtomArrays | str | os.PathLike[str]


def atoms_source(atoms: Atoms, displacements: npt.ArrayLike | None = None) -> str | _core.AtomArrays:
    """Returns atoms, with their mean square ``displacements``, in the extension's form: a path, or a dict of arrays."""
    if isinstance(atoms, (str, os.PathLike)):
        if displacements is not None:
            raise _invalid("displacements", "displacements are for atoms in memory; for a file, give sigma='from-file' or a length")
        return os.fspath(atoms)
    if isinstance(atoms, AtomArrays):
        return _arrays(atoms.numbers, atoms.positions, atoms.cell, atoms.occupancies, displacements)
    if isinstance(atoms, AseAtoms):
        return _of_ase(atoms, displacements)
    raise _invalid("atoms", f"atoms = {type(atoms).__name__}: expected ase.Atoms, AtomArrays or the path of a file")


def _of_ase(atoms: Any, displacements: npt.ArrayLike | None) -> _core.AtomArrays:
    """Converts atoms of ASE, with their partial occupancies and the origin of their cell."""
    numbers, positions = np.asarray(atoms.get_atomic_numbers()), np.asarray(atoms.get_positions(), dtype=np.float64)
    if hasattr(atoms, "get_celldisp"):
        positions = positions - np.asarray(atoms.get_celldisp(), dtype=np.float64).reshape(3)
    mixed = getattr(atoms, "info", {}).get("occupancy")
    if not mixed:
        return _arrays(numbers, positions, atoms.get_cell(), None, displacements)
    kinds = getattr(atoms, "arrays", {}).get("spacegroup_kinds")
    if kinds is None:
        raise _invalid(
            "atoms",
            "atoms.info['occupancy'] tells of mixed sites, and atoms.arrays has no 'spacegroup_kinds' that says which these are; "
            "give the path of the file, or AtomArrays with occupancies, or remove the entry",
        )
    from ase.data import atomic_numbers

    sites, drawn, shares = [], [], []
    for site, kind in enumerate(np.asarray(kinds).tolist()):
        # ASE 3.21 and later write the keys as text, earlier versions as numbers.
        of_site = mixed.get(str(kind), mixed.get(kind))
        if of_site is None:
            raise _invalid("atoms", f"atoms.info['occupancy'] has no entry {kind!r}, which atom {site} is of")
        for symbol, share in of_site.items():
            if symbol not in atomic_numbers:
                raise _invalid("atoms", f"atoms.info['occupancy'] has the unknown element {symbol!r}")
            if atomic_numbers[symbol] > 0 and share > 0:
                sites.append(site)
                drawn.append(atomic_numbers[symbol])
                shares.append(float(share))
    tensors = None if displacements is None else _tensors(displacements, len(numbers))[sites]
    return _arrays(np.asarray(drawn, dtype=np.int64), positions[sites], atoms.get_cell(), shares, tensors)


def _tensors(displacements: npt.ArrayLike, count: int) -> npt.NDArray[np.float64]:
    tensors = np.ascontiguousarray(displacements, dtype=np.float64)
    if tensors.shape != (count, 3, 3):
        raise _invalid("displacements", f"displacements of shape {tensors.shape}: expected ({count}, 3, 3), in square Angstrom")
    return tensors


def _arrays(numbers: Any, positions: Any, cell: Any, occupancies: Any = None, displacements: Any = None) -> _core.AtomArrays:
    found = np.asarray(numbers)
    if found.ndim != 1 or (found.size and (found.min() < 0 or not np.issubdtype(found.dtype, np.integer))):
        raise _invalid("atoms", "atomic numbers are a list of whole numbers")
    places = np.ascontiguousarray(positions, dtype=np.float64)
    vectors = np.asarray(cell, dtype=np.float64)
    if places.ndim != 2 or vectors.shape != (3, 3):
        raise _invalid("atoms", f"positions of shape {places.shape} and cell of shape {vectors.shape}: expected (atoms, 3), (3, 3)")
    return {
        "numbers": found.tolist(),
        "positions": places,
        "cell": vectors.tolist(),
        "occupancies": None if occupancies is None else [float(share) for share in occupancies],
        "displacements": None if displacements is None else _tensors(displacements, len(found)),
    }
