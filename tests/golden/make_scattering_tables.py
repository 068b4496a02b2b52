"""Writes src/potential/data/{lobato,kirkland,peng}.csv and tests/golden/scattering_factors.csv.

Usage: pip install abtem==1.0.11 && python tests/golden/make_scattering_tables.py

The tables are published numbers; abTEM happens to carry them in a form that can be read by a program.
"""

import json
from pathlib import Path

import abtem
import numpy as np
from abtem.parametrizations import validate_parametrization
from ase.data import atomic_numbers

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(abtem.__path__[0]) / "parametrizations" / "data"
BOHR = 0.529177210903

COMMON = """\
# {title}
#
# formula:  {formula}
# units:    f_e in A; q = 1/d = 2 sin(theta_Bragg)/lambda = (scattering angle)/lambda in 1/A
#           {units}
# This is the first Born scattering factor for the rest mass of the electron. The projected potential of an
# atom has the two-dimensional Fourier transform (exp(-2 pi i q.r) convention)
# V(q) = h^2/(2 pi m0 e) f_e(q) = 2 pi a0 e/(4 pi eps0) f_e(q) = 47.87765 V A^2 x f_e(q), in V A^3.
# valid:    {valid}
# paper:    {paper}
# source:   abTEM {version}, parametrizations/data/{file}; numbers as they stand there, unscaled
"""

TABLES = {
    "lobato": dict(
        file="lobato.json",
        title="Electron scattering factors of neutral atoms, Lobato & Van Dyck",
        formula="f_e(q) = sum_{i=1..5} a_i (2 + b_i q^2) / (1 + b_i q^2)^2",
        units="a_i in A, b_i in A^2",
        valid="0 <= q <= 12 1/A; beyond that it tends to Z/(2 pi^2 a0 q^2), the bare nucleus",
        paper="I. Lobato & D. Van Dyck, Acta Cryst. A70 (2014) 636-649",
        columns=[f"{p}{i}" for p in "ab" for i in range(1, 6)],
    ),
    "kirkland": dict(
        file="kirkland.json",
        title="Electron scattering factors of neutral atoms, Kirkland",
        formula="f_e(q) = sum_{i=1..3} a_i / (q^2 + b_i) + sum_{i=1..3} c_i exp(-d_i q^2)",
        units="a_i in 1/A, b_i in 1/A^2, c_i in A, d_i in A^2",
        valid="0 <= q <= 12 1/A",
        paper="E. J. Kirkland, Advanced Computing in Electron Microscopy, 2nd ed. (2010), appendix C",
        columns=[f"{p}{i}" for p in "abcd" for i in range(1, 4)],
    ),
    "peng": dict(
        file="peng_high.json",
        title="Electron scattering factors of neutral atoms, Peng, Ren, Dudarev & Whelan",
        formula="f_e(q) = sum_{i=1..5} a_i exp(-b_i s^2),  s = q/2 = sin(theta_Bragg)/lambda",
        units="a_i in A, b_i in A^2 (as published, for s; divide by 4 for q)",
        valid="fitted to 0 <= s <= 6 1/A, that is q <= 12 1/A (the table for large s; also International Tables C, table 4.3.2.3),\n"
        "#           but Gaussians fall too fast: against Lobato within 11 % up to q = 4 1/A, at q = 8 (200 mrad at 200 kV)\n"
        "#           from 13 % too high to 96 % too low (Sc; also Cu, Li, Gd, Ra, Pa). Not for high-angle detectors.",
        paper="L.-M. Peng, G. Ren, S. L. Dudarev & M. J. Whelan, Acta Cryst. A52 (1996) 257-276",
        columns=[f"{p}{i}" for p in "ab" for i in range(1, 6)],
    ),
}

ELEMENTS = "H C O Al Si Ti Fe Cu Sr Ag Pt Au U".split()
Q = [0.0, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0]

# a_i (A), b_i (A^2), as they are in wide use (SHELX, RHEED programs)
DOYLE_TURNER = {
    "O": ((0.4548, 0.9173, 0.4719, 0.1384), (23.7803, 7.6220, 2.1440, 0.2959)),
    "Al": ((2.2756, 2.4280, 0.8578, 0.3166), (72.3220, 19.7729, 3.0799, 0.4076)),
    "Si": ((2.1293, 2.5333, 0.8349, 0.3216), (57.7748, 16.4756, 2.8796, 0.3860)),
    "Ca": ((4.4696, 2.9708, 1.9696, 0.4818), (99.5228, 22.6958, 4.1954, 0.4165)),
    "Fe": ((2.5440, 2.3434, 1.7588, 0.5062), (64.4244, 14.8806, 2.8539, 0.3502)),
}


def lobato(symbol, q):
    return validate_parametrization("lobato").scattering_factor(symbol)(np.asarray(q) ** 2)


def formula(name, row, q):
    """The formula in the header of the table, written out; checked against abTEM's own evaluation."""
    q2 = np.asarray(q, float) ** 2
    p = [np.array(r)[:, None] for r in row]
    if name == "lobato":
        return (p[0] * (2 + p[1] * q2) / (1 + p[1] * q2) ** 2).sum(0)
    if name == "kirkland":
        return (p[0] / (q2 + p[1]) + p[2] * np.exp(-p[3] * q2)).sum(0)
    return (p[0] * np.exp(-p[1] * q2 / 4)).sum(0)


def tables():
    for name, t in TABLES.items():
        data = json.loads((DATA / t["file"]).read_text())
        out = ROOT / "src/potential/data" / f"{name}.csv"
        out.parent.mkdir(parents=True, exist_ok=True)
        with out.open("w") as f:
            f.write(COMMON.format(version=abtem.__version__, **t))
            f.write("Z,symbol," + ",".join(t["columns"]) + "\n")
            for symbol, rows in sorted(data.items(), key=lambda kv: atomic_numbers[kv[0]]):
                numbers = [x for r in rows for x in r]
                assert len(numbers) == len(t["columns"]), symbol
                f.write(f"{atomic_numbers[symbol]},{symbol}," + ",".join(f"{x:.15g}" for x in numbers) + "\n")
        z = sorted(atomic_numbers[s] for s in data)
        assert z == list(range(1, len(z) + 1))
        print(out.name, "Z = 1 ..", z[-1])
        if name == "lobato":  # the Mott-Bethe tail
            worst = max(abs(sum(np.array(r[0]) / r[1]) * 2 * np.pi**2 * BOHR / atomic_numbers[s] - 1) for s, r in data.items())
            print("  worst relative deviation from the Mott-Bethe tail:", worst)


def values():
    """f_e(q) evaluated by abTEM's own functions."""
    abtem.config.set({"precision": "float64"})
    lines = [
        "# Electron scattering factors f_e(q) of neutral atoms.",
        "# f_e in A, q = 1/d in 1/A (q = 2 s, s = sin(theta_Bragg)/lambda).",
        f"# source abtem: abTEM {abtem.__version__}, Parametrization.scattering_factor(symbol)(q^2), float64. That function takes the square of",
        "#   q and returns A: no factor is needed. (abTEM's projected_scattering_factor is the same divided by its constant kappa,",
        "#   1/kappa = 2 pi a0 e/(4 pi eps0) = 47.87765 V A^2, hence in V A^3.)",
    ]
    rows = []
    for name, t in TABLES.items():
        p = validate_parametrization(name)
        data = json.loads((DATA / t["file"]).read_text())
        for s in ELEMENTS:
            f = p.scattering_factor(s)(np.array(Q) ** 2)
            np.testing.assert_allclose(f, formula(name, data[s], Q), rtol=1e-12)
            v = p.projected_scattering_factor(s)(np.array(Q) ** 2)
            np.testing.assert_allclose(v, f * 47.87765, rtol=2e-6)
            rows += [f"abtem,{name},{atomic_numbers[s]},{s},{q:g},{x:.9e}" for q, x in zip(Q, f)]
    # Independent of the three tables.
    lines += [
        "# source exact: hydrogen, Mott-Bethe formula with the 1s density, f_e = (1 - (1 + (pi a0 q)^2)^-2)/(2 pi^2 a0 q^2), f_e(0) = a0.",
        "# source doyle_turner: P. A. Doyle & P. S. Turner, Acta Cryst. A24 (1968) 390-397, relativistic Hartree-Fock, their four Gaussians",
        "#   f_e = sum a_i exp(-b_i s^2), a fit of their table for 0 <= s <= 2 1/A. Lobato is within 2.5 % of it up to q = 1 1/A,",
        "#   within 3.5 % up to q = 2 1/A (make_scattering_tables.py prints the differences).",
    ]
    q = np.array(Q)
    x = (np.pi * BOHR * q) ** 2
    hydrogen = np.where(q > 0, (1 - (1 + x) ** -2) / (2 * np.pi**2 * BOHR * np.where(q > 0, q, 1) ** 2), BOHR)
    rows += [f"exact,mott_bethe,1,H,{k:g},{f:.9e}" for k, f in zip(Q, hydrogen)]
    print("H, exact: worst relative deviation of Lobato", np.max(abs(lobato("H", q) / hydrogen - 1)))
    for s, (a, b) in DOYLE_TURNER.items():
        low = q[q <= 2.0]
        f = (np.array(a)[:, None] * np.exp(-np.array(b)[:, None] * low**2 / 4)).sum(0)
        rows += [f"doyle_turner,doyle_turner,{atomic_numbers[s]},{s},{k:g},{v:.5f}" for k, v in zip(low, f)]
        print(s, "Doyle-Turner: Lobato/D-T - 1 in % at q =", dict(zip(low.tolist(), np.round(100 * (lobato(s, low) / f - 1), 1).tolist())))
    lines.append("source,parametrization,Z,symbol,q,f_e")
    (Path(__file__).parent / "scattering_factors.csv").write_text("\n".join(lines + rows) + "\n")


if __name__ == "__main__":
    tables()
    values()
