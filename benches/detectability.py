"""The map of detectability of docs/detectability.md: the dose at which a defect is found, for materials, thicknesses and detectors.

    python benches/detectability.py map.jsonl              # some 5 minutes on two cores
    python benches/detectability.py map.jsonl --table      # the tables of the page, from the lines of the file

Each line of the file is one case as JSON: material, defect, thickness, detectors with their needed doses, best annulus. Cases that the file
holds already are not simulated again.
"""

import argparse
import json
import os
import time

import stemworlds as sw

STRUCTURES = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "structures")
#: HAADF of the recipes, and two annuli at lower angles (two semiangles and more, for which windows are exact enough).
DETECTORS = {"HAADF": (68, 200), "MAADF": (45, 68), "ADF": (45, 200)}
#: The detectors at 80 kV and 25 mrad, where windows begin at 50 mrad.
AT_80_KV = {"HAADF": (68, 200), "MAADF": (50, 68), "ADF": (50, 200)}
#: Material, tier, defect, thicknesses in nm, options.
CASES = [
    ("mos2", "easy", "vacancy:S", (0.6147,), {"detectors": AT_80_KV}),
    ("srtio3", "easy", "vacancy:O", (2.0, 5.0), {}),
    ("sige", "easy", "substitution:Si:Ge", (2.0, 5.0), {}),
    ("gan", "easy", "substitution:Ga:In", (2.0, 5.0), {}),
    ("batio3", "easy", "vacancy:O", (2.0, 5.0), {}),
    ("pt", None, "vacancy:Pt", (2.0,), {"zone": (1, 1, 0), "sigma": 0.070}),
    ("srtio3", "easy", "substitution:Ti:Nb", (2.0, 5.0), {}),
    ("srtio3", "easy", "vacancy:O", (10.0,), {}),
    ("sige", "easy", "substitution:Si:Ge", (10.0,), {}),
    ("gan", "easy", "substitution:Ga:In", (10.0,), {}),
]


def run(path: str, phonons: int) -> None:
    """Simulates all cases that the file lacks, and appends them."""
    known = {line["key"] for line in lines(path)}
    for material, tier, defect, thicknesses, options in CASES:
        for nm in thicknesses:
            key = " ".join(map(str, (material, defect, nm, options.get("column", ""), phonons)))
            if key in known:
                continue
            begun = time.process_time()
            specimen = os.path.join(STRUCTURES, "pt.cif") if material == "pt" else material
            given = {"detectors": DETECTORS, "phonons": phonons, **options}
            found = sw.detectability(specimen, defect, thicknesses_nm=nm, difficulty=tier, **given)
            case = found.details["cases"][0]
            for detector in case["detectors"]:
                # The tests at each dose follow from the information.
                del detector["doses"]
            line = {
                "key": key,
                "material": material,
                "recipe_dose": found.details["recipe_dose"],
                "engine": found.details["engine"],
                "phonons": phonons,
                "cpu_s": round(time.process_time() - begun, 1),
                "case": case,
            }
            with open(path, "a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
            print(key, found.sentences[0], f"({line['cpu_s']} s)", flush=True)


def lines(path: str) -> list[dict]:
    """The cases of the file."""
    if not os.path.exists(path):
        return []
    with open(path, encoding="utf-8") as file:
        return [json.loads(line) for line in file]


def short(needed: dict) -> str:
    """A needed dose with its range."""

    def number(value: float) -> str:
        return f"{value:.1e}".replace("e+0", "e").replace(".0e", "e")

    low, high = needed["range"]
    if needed["verdict"] == "found":
        return f"{number(needed['electrons_per_angstrom2'])} ({number(low)} to {number(high)})"
    return f"above {number(low)}" if needed["verdict"] == "unresolved" else "never"


def table(path: str) -> None:
    """Prints the map as a table of the page."""
    print("| material | defect | column | nm | change, HAADF | HAADF | MAADF | best annulus | dose there |\n|---|---|---|---|---|---|---|---|---|")
    for line in lines(path):
        case = line["case"]
        by_name = {d["detector"]: d for d in case["detectors"]}
        haadf, maadf, best = by_name["HAADF"], by_name["MAADF"], case["best_annulus"]
        inner, outer = best["annulus_mrad"]
        print(
            f"| {line['material']} | {case['defect'].removesuffix('@middle')} | {case['column']} | {case['thickness_nm']:.1f} | "
            f"{haadf['contrast_percent']:+.1f} % | {short(haadf['known'])} | {short(maadf['known'])} | {inner:.0f}-{outer:.0f} | "
            f"{short(best['needed'])} |"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file")
    parser.add_argument("--phonons", type=int, default=16)
    parser.add_argument("--table", action="store_true")
    asked = parser.parse_args()
    if asked.table:
        table(asked.file)
    else:
        run(asked.file, asked.phonons)
