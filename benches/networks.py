"""Measures the networks of the package against the ideal observer, on held-out specimens.

    python benches/networks.py benches/networks.jsonl

Each line holds one kind of column of one recipe at one dose (:class:`stemworlds.bench.fraction.Fraction`), and the seed of the library:
0 is the library of the training, 1 shares no phonon pattern and no pattern of defects with it. Takes some ten minutes on two cores, most of
it for the second library.
"""

import dataclasses
import json
import sys
from pathlib import Path

import stemworlds as sw
from stemworlds.bench.fraction import fractions

DOSES = [1e3, 3e3, 1e4, 3e4, 1e5]
TILES = 24


def main(out: Path) -> None:
    with out.open("w") as file:
        for tier in ("easy", "medium", "hard"):
            for library_seed in (0, 1):
                recipe = sw.Recipe("mos2", tier, set={"phonons.library_seed": library_seed})
                for one in fractions("mos2", recipe, DOSES, tiles=TILES):
                    line = {"network": "mos2", "library_seed": library_seed, **dataclasses.asdict(one)}
                    print(json.dumps(line), file=file, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
