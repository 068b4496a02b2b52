"""Prints structure factors of a CIF with anisotropic displacements, divided by the form factor of its one element, as gemmi computes them.

    pip install gemmi
    python tests/structures/anisotropic_by_gemmi.py tests/structures/good/trigonal_u.cif

The numbers stand in tests/physics/anisotropic.rs.
"""

import sys

import gemmi

INDICES = [(1, 0, 0), (0, 2, 1), (3, -1, 2), (-2, 5, 1), (4, 1, -6), (1, 1, 9)]


def main(path: str) -> None:
    block = gemmi.cif.read(path).sole_block()
    structure = gemmi.make_small_structure_from_block(block)
    structure.change_occupancies_to_crystallographic()
    calculator = gemmi.StructureFactorCalculatorX(structure.cell)
    for hkl in INDICES:
        factor = structure.sites[0].element.it92.calculate_sf(1 / (4 * structure.cell.calculate_d(hkl) ** 2))
        value = calculator.calculate_sf_from_small_structure(structure, hkl) / factor
        print(f"({list(hkl)}, [{value.real:.7f}, {value.imag:.7f}]),")


main(sys.argv[1])
