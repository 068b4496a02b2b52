"""Does it matter where an agent looks? Share of all defects of a field that lie in the 50 tiles it looks at, and what its map is worth.

    python benches/field_navigation.py sige gan batio3 wandering clusters --seeds 10

The analyst is simulated: the true number of defects of a tile, with the error of an observer whose columns have a detectability d' for one defect each,
sqrt(columns of a tile) / d'. No image is made, so a specimen takes seconds. Navigators are those of the package. Means and 95 % intervals (bootstrap) over
specimens that nobody trained on.
"""

import argparse
import functools
from types import SimpleNamespace

import numpy as np

import stemworlds as sw
from stemworlds.bench import ByCounts, ByPrior, ByTruth, RandomTiles, Raster, bootstrap_interval
from stemworlds.bench.agents import random_of
from stemworlds.bench.count_maps import CountProcess
from stemworlds.bench.field_scores import map_bits
from stemworlds.bench.field_truth import expected_counts, field_truth, grid_of

#: The worlds: recipe, changes, and the d' of a defect: about that of an ideal observer at the tier's dose, below it and above.
WORLDS = {
    "sige": (("sige", {}), (0.2, 0.61, 1.3)),
    "gan": (("gan", {}), (0.12, 0.36, 0.72)),
    "batio3": (("batio3", {}), (0.08, 0.16, 0.5)),
    "wandering": (
        (
            "batio3",
            {
                "domains.boundaries": 1,
                "domains.waviness": 0.2,
                "vacancies.rate": 0.004,
                "vacancies.cluster_fraction": 1.0,
                "vacancies.cluster_sigma_nm": 1.0,
            },
        ),
        (0.08, 0.16, 0.5),
    ),
    "clusters": (
        (
            "batio3",
            {
                "domains.boundaries": 0,
                "vacancies.clusters": 20,
                "vacancies.rate": 0.01,
                "vacancies.cluster_fraction": 0.9,
                "vacancies.cluster_sigma_nm": 2.5,
            },
        ),
        (0.08, 0.16, 0.5),
    ),
}
LOOKS = 50


def look(navigator, truth, sigma, seed, world):
    """Tiles that a navigator looks at, in order, and what the analyst counts in them."""
    noise = np.random.default_rng([seed, 1])
    counted, cells = [], truth.counts.ravel()

    def counts_of(tiles):
        while len(counted) < len(tiles):
            tile = tiles[len(counted)]
            mean = cells[tile.row * truth.grid.columns + tile.column]
            counted.append((mean + sigma * noise.standard_normal(), np.hypot(sigma, np.sqrt(max(mean, 1.0)))))
        return np.array(counted)

    field = SimpleNamespace(grid=(truth.grid.rows, truth.grid.columns))
    tiles = []

    def visited():
        grid = np.zeros(field.grid, dtype=bool)
        for tile in tiles:
            grid[tile.row, tile.column] = True
        return grid

    seen = SimpleNamespace(field=field, tiles=tiles, counts_of=counts_of, plan=None, visited=visited)
    if hasattr(navigator, "attach"):
        navigator.attach(world)
    navigator.start(field, random_of(seed, "navigation"))
    for _ in range(LOOKS):
        chosen = navigator.choose(seen)
        tiles.append(SimpleNamespace(row=chosen.row, column=chosen.column))
    own = np.array([tile.row * truth.grid.columns + tile.column for tile in tiles])
    return own, counts_of(tiles)


def played(name, seeds):
    """Rows of (d', navigator, recall by seed, share of the map's bits by seed)."""
    (recipe, changes), detectabilities = WORLDS[name]
    base = sw.Recipe(recipe, "hard", set=changes)
    grid = grid_of(base)
    expected = expected_counts(base, grid)
    navigators = {
        "raster": Raster,
        "random": RandomTiles,
        "prior": ByPrior,
        "counts, flat": functools.partial(ByCounts, usual="flat"),
        "counts, prior": ByCounts,
        "truth": ByTruth,
    }
    found = {}
    for seed in range(1, 2 * seeds, 2):
        specimen = base.with_seed(seed)
        truth = field_truth(specimen.toml)
        world = SimpleNamespace(recipe=base, specimen=lambda specimen=specimen: specimen)
        tile_columns = len(truth.numbers) / truth.counts.size
        for d in detectabilities:
            sigma = np.sqrt(tile_columns) / d
            for kind, make in navigators.items():
                if kind in ("raster", "random", "prior", "truth") and d != detectabilities[0]:
                    continue
                own, counted = look(make(), truth, sigma, seed, world)
                process = CountProcess(truth.counts.shape, None if kind == "counts, flat" else expected)
                process.fit(own, *counted.T)
                density = process.predict(own, *counted.T).numbers()
                gained, most = map_bits(truth, density, float(expected.mean()), np.isin(np.arange(truth.counts.size), own).reshape(truth.counts.shape))
                recall = float(truth.counts.ravel()[own].sum()) / truth.total
                found.setdefault((kind, d), []).append((recall, gained / most))
    return found


def told(values):
    low, high = bootstrap_interval(values)
    return f"{100 * np.mean(values):5.1f} ({100 * low:.1f} to {100 * high:.1f})"


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("worlds", nargs="+", choices=WORLDS)
    options.add_argument("--seeds", type=int, default=10)
    given = options.parse_args()
    for name in given.worlds:
        found = played(name, given.seeds)
        raster = {seed: recall for seed, (recall, _) in enumerate(found["raster", WORLDS[name][1][0]])}
        for (kind, d), values in found.items():
            recall, bits = np.array(values).T
            times = recall / np.array([raster[n] for n in range(len(recall))])
            which = f"d' {d:g}" if kind.startswith("counts") else ""
            print(f"{name:10} {kind:14} {which:8} recall {told(recall)} %, over raster {np.mean(times):.2f}, map {told(bits)} % of the truth's bits", flush=True)


if __name__ == "__main__":
    main()
