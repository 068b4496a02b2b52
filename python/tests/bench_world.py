"""A small world for agents, made of NumPy: a lattice with some bright and some dark atoms, at the interface of the environments."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
import pytest

from stemworlds.bench import TASKS, Acquired, Episode, FieldFacts, Findings, templates
from stemworlds.bench.field_truth import FIELD_TASKS

#: Names of the environments of the paper's tasks; those about the whole field have tests of their own.
PAPER_TASKS = [name for name, task in TASKS.items() if task not in FIELD_TASKS]
#: Tiles that templates are learned from in tests. Columns of one or two atoms show enough in a fifth of the 64 that thick specimens take.
FEW_TILES = 12


@pytest.fixture(autouse=True, scope="module")
def few_tiles() -> Iterator[None]:
    """For files whose agents learn templates, which takes most of the time of their tests; they import it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(templates, "_TILES", FEW_TILES)
        yield
    templates.templates_of.cache_clear()


PIXEL_NM = 0.02
APART_PX = 16
STRIDE_PX = 124


def facts(grid: tuple[int, int] = (5, 6), budget: float = 1000.0, horizon: int = 200) -> FieldFacts:
    """A field of so many tiles."""
    return FieldFacts(
        name="lattice",
        material="lattice",
        grid=grid,
        tile_px=128,
        overlap_px=4,
        pixel_nm=PIXEL_NM,
        size_nm=((grid[0] * STRIDE_PX + 4) * PIXEL_NM, (grid[1] * STRIDE_PX + 4) * PIXEL_NM),
        phases=(),
        task="defect-census",
        target=None,
        strict=False,
        budget=budget,
        horizon=horizon,
        scale=1.0,
        offset=0.0,
    )


def acquired(image: npt.NDArray[Any], row: int = 0, column: int = 0, dose: float = 1.0, zoom: float = 1.0) -> Acquired:
    """A tile that shows these fractions of the beam."""
    scale = float(image.max())
    centre = ((column * STRIDE_PX + 63.5) * PIXEL_NM, (row * STRIDE_PX + 63.5) * PIXEL_NM)
    shown = (image / scale).astype(np.float32)
    return Acquired(row, column, centre, 128 * PIXEL_NM, PIXEL_NM, zoom, dose, 100 * dose * zoom**2, 400 * dose, scale, 0.0, shown)


class Lattice(gym.Env[Any, Any]):
    """A field with a lattice of atoms; columns of tiles from ``bright_from`` on are a brighter phase. Scores the counts as F1 of each kind."""

    def __init__(self, grid: tuple[int, int] = (5, 6), budget: float = 1000.0, horizon: int = 200, bright_from: int | None = None) -> None:
        self.field = facts(grid, budget, horizon)
        self.horizon, self.bright_from = horizon, bright_from
        random = np.random.default_rng(7)
        height, width = (n * STRIDE_PX + 4 for n in grid)
        y, x = np.meshgrid(np.arange(8, height - 8, APART_PX), np.arange(8, width - 8, APART_PX), indexing="ij")
        self.atoms_px = np.column_stack([x.ravel(), y.ravel()]).astype(float)
        self.kinds = random.choice(["", "vacancy", "substitution"], len(self.atoms_px), p=[0.96, 0.02, 0.02])
        heights = np.where(self.kinds == "vacancy", 0.4, np.where(self.kinds == "substitution", 1.7, 1.0))
        self.clean = np.full((height, width), 0.05)
        py, px = np.mgrid[-7:8, -7:8]
        spot = np.exp(-(px**2 + py**2) / (2 * 2.5**2))
        for (x_px, y_px), level in zip(self.atoms_px.astype(int), heights, strict=True):
            self.clean[y_px - 7 : y_px + 8, x_px - 7 : x_px + 8] += 0.1 * level * spot
        if bright_from is not None:
            self.clean[:, bright_from * STRIDE_PX :] += 0.2

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.episode_seed = seed
        self.steps, self.spent, self.refused, self.ended = 0, 0.0, False, None
        self.at = (0, 0)
        self.acquired: list[Acquired] = []
        self.curve: list[list[float]] = []
        self.declared: Findings | None = None
        self.declarations: list[int] = []
        return self._returned({})[0], self._info({})

    def acquire(self, row: int, column: int, zoom: float = 1.0, dose: float = 1.0) -> tuple[Any, ...]:
        self.steps += 2
        cost = 100.0 * dose * zoom**2
        if self.spent + cost > self.field.budget + 1e-9:
            self.refused, self.ended = True, "refused"
            return self._returned({})
        if self.acquired and len(self.acquired) % 5 == 0:
            self._record()
        self.spent += cost
        top, left = row * STRIDE_PX, column * STRIDE_PX
        clean = self.clean[top : top + 128, left : left + 128]
        electrons = 400.0 * dose
        noise = np.random.default_rng([int(self.episode_seed or 0), len(self.acquired)])
        shown = noise.poisson(clean * electrons) / electrons
        tile = acquired(shown, row, column, dose, zoom)
        self.acquired.append(tile)
        return self._returned({"acquired": tile})

    def declare(self, findings: Findings) -> tuple[Any, ...]:
        self.steps += 1
        self.declared = findings
        self.declarations.append(len(self.acquired))
        return self._returned({})

    def step(self, action: dict[str, Any]) -> tuple[Any, ...]:
        assert action == {"type": 3}, "agents make all other steps by acquire and declare"
        self.steps += 1
        self.ended = "done"
        return self._returned({})

    def truth_seen(self) -> Findings:
        seen = np.zeros(len(self.atoms_px), dtype=bool)
        for tile in self.acquired:
            near = self.atoms_px - [tile.column * STRIDE_PX, tile.row * STRIDE_PX]
            seen |= ((near >= 0) & (near < 128)).all(axis=1)
        places = {kind: self.atoms_px[seen & (self.kinds == kind)] * PIXEL_NM for kind in ("substitution", "vacancy")}
        return Findings(defects=places)

    def score(self) -> float:
        if self.declared is None:
            return 0.0
        truth, said = self.truth_seen().defects or {}, self.declared.defects or {}
        scores = []
        for kind, places in truth.items():
            true, claimed = len(places), len(said.get(kind, []))
            scores.append(2 * min(true, claimed) / (true + claimed) if true + claimed else 1.0)
        return float(np.mean(scores))

    def record(self) -> dict[str, Any]:
        curve = [*self.curve, [self.spent / self.field.budget, self.score()]]
        places = [{"tile": [t.row, t.column], "cost": t.cost} for t in self.acquired]
        auc = float(np.trapezoid([0, *(score for _, score in curve)], [0, *(share for share, _ in curve)]))
        metrics = {"dec_auc": auc, "final_score": curve[-1][1]}
        more = ("time_to_threshold", "early_weighted", "late_weighted", "half_budget")
        metrics.update({name: (number + 1) * auc / 8 for number, name in enumerate(more)})
        return {
            "curve": curve,
            "metrics": metrics,
            "acquisitions": places,
            "ended": self.ended,
            "scores": {"paper": curve[-1][1], "strict": curve[-1][1] / 2, "columns": None},
            "seed": self.episode_seed,
        }

    def _record(self) -> None:
        self.curve.append([self.spent / self.field.budget, self.score()])

    def _info(self, more: dict[str, Any]) -> dict[str, Any]:
        return {"dose_spent": self.spent, "budget": self.field.budget, "tiles": len(self.acquired), "unreadable": 0, **more}

    def _returned(self, more: dict[str, Any]) -> tuple[Any, ...]:
        observation = {"step_fraction": np.array([self.steps / self.horizon], dtype=np.float32)}
        truncated = self.steps >= self.horizon and self.ended is None
        if truncated:
            self.ended = "horizon"
        return observation, 0.0, self.ended in ("done", "refused"), truncated, self._info(more)


def lattice_of(episode: Episode) -> Lattice:
    """For the runner, which may call it in processes of its own."""
    grid = episode.world.get("grid", (5, 6))
    return Lattice(tuple(grid), episode.budget)
