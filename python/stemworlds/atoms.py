"""Atoms as they come and go: ASE, files, plain arrays."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from .errors import _invalid


@runtime_checkable
class AseAtoms(Protocol):
    """What is taken of ``ase.Atoms``; ASE itself need not be installed."""

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
        arrays: more that is known of each atom. Specimens have ``column``, the index of the atomic column in the truth of a world, or -1;
            ``defect``, such as ``"substitution_Ge"`` or ``"none"``; ``atom_type``, 0 pristine, 1 vacancy, 2 substitution.
    """

    numbers: npt.NDArray[np.int32]
    positions: npt.NDArray[np.float64]
    cell: npt.NDArray[np.float64]
    arrays: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.numbers)

    def to_ase(self) -> Any:
        """The atoms as ``ase.Atoms``, with ``arrays``; ASE has to be installed."""
        from ase import Atoms

        atoms = Atoms(numbers=self.numbers, positions=self.positions, cell=self.cell, pbc=False)
        for name, values in self.arrays.items():
            atoms.set_array(name, np.asarray(values))
        return atoms


#: Atoms of ASE, plain arrays, or the path of a file: CIF, extended XYZ or POSCAR.
Atoms = AseAtoms | AtomArrays | str | os.PathLike[str]


def atoms_source(atoms: Atoms) -> str | dict[str, Any]:
    """As the extension takes it: a path, or a dict of arrays."""
    if isinstance(atoms, (str, os.PathLike)):
        return os.fspath(atoms)
    if isinstance(atoms, AtomArrays):
        return _arrays(atoms.numbers, atoms.positions, atoms.cell)
    if isinstance(atoms, AseAtoms):
        return _arrays(atoms.get_atomic_numbers(), atoms.get_positions(), atoms.get_cell())
    raise _invalid("atoms", f"atoms = {type(atoms).__name__}: expected ase.Atoms, AtomArrays or the path of a file")


def _arrays(numbers: Any, positions: Any, cell: Any) -> dict[str, Any]:
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
        "occupancies": None,
    }
