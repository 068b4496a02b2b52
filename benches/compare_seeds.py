"""How often `stemgen compare` calls worlds of one recipe different.

    python benches/compare_seeds.py WORLDS FOLDER build srtio3 --difficulty hard --grid 16x16 --audit 0 ...

builds so many worlds with seeds 1, 2, ... in the folder (those that exist are kept), compares each with the next, and prints for
each line how many probabilities lie below 0.001, 0.01, 0.05, 0.1 and 0.5, their mean, and all of them. Between worlds of
one kind they are uniform: a mean of 0.5, one of twenty below 0.05. Lines that chance plays no part in have 1.
Needs `cargo build --release`.
"""

import collections
import json
import pathlib
import subprocess
import sys

STEMGEN = pathlib.Path(__file__).parent.parent / "target" / "release" / "stemgen"


def run(*arguments, codes=(0,)):
    done = subprocess.run([STEMGEN, *map(str, arguments)], capture_output=True, text=True)
    if done.returncode not in codes:
        sys.exit(done.stderr)
    return done.stdout


def main(number, folder, *build):
    folder = pathlib.Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    worlds = [folder / f"seed_{seed}.h5" for seed in range(1, int(number) + 1)]
    for seed, world in enumerate(worlds, 1):
        if not world.exists():
            run(*build, "--set", f"seed={seed}", "--no-png", "--quiet", "-o", world)
    found, different = collections.defaultdict(list), 0
    page = folder / "compare.html"
    for a, b in zip(worlds, worlds[1:]):
        report = run("compare", a, b, "--json", "--quiet", "--overwrite", "-o", page, codes=(0, 3))
        report = json.loads(report)
        different += report["verdict"] == "different"
        for line in report["lines"]:
            found[line["what"]].append(line["p"])
    print(f"{different} of {len(worlds) - 1} pairs different")
    for what, p in found.items():
        below = " ".join(str(sum(v < limit for v in p)) for limit in (0.001, 0.01, 0.05, 0.1, 0.5))
        print(f"{what:32} below: {below:14} mean {sum(p) / len(p):.2f} ", *[f"{v:.3f}" for v in sorted(p)])


main(*sys.argv[1:])
