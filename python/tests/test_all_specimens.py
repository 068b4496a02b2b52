"""Streams, live worlds and environments of specimens of every kind: layers, stacks, particles on them, and a user's own atoms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from conftest import ROOT

import stemworlds as sw
import stemworlds.bench as bench

#: Distance of neighbours in the file of atoms, in Angstrom.
SPACING = 3.0
QUICK: dict[str, Any] = {"phonons.configurations": 1, "detector": {"inner_mrad": 50.0, "outer_mrad": 90.0}}
SMALL: dict[str, Any] = {"field.fov_nm": (2.4, 2.4), "field.grid": (3, 3), "field.tile_px": 48, "field.overlap_px": 12}


def own_atoms(folder: Path) -> Path:
    """Writes rows of gold with a missing atom and a foreign one."""
    lines = []
    for i in range(10):
        for j in range(10):
            for k in range(2):
                symbol, occupancy, defect = "Au", 1, "none"
                if (i, j, k) == (4, 4, 0):
                    symbol, occupancy, defect = "X", 0, "vacancy_Au"
                elif (i, j, k) == (5, 6, 1):
                    symbol, occupancy, defect = "Ag", 1, "substitution_Ag"
                lines.append(f"{symbol} {i * SPACING} {j * SPACING} {k * SPACING} {occupancy} {defect}")
    path = folder / "own.xyz"
    head = 'Lattice="30 0 0 0 30 0 0 0 10" Properties=species:S:1:pos:R:3:occupancy:R:1:defect:S:1'
    path.write_text("\n".join([str(len(lines)), head, *lines, ""]))
    return path


def recipe(kind: str, folder: Path) -> sw.Recipe:
    if kind == "layer":
        return sw.Recipe("mos2", "easy", set={**QUICK, **SMALL, "boundaries.count": 0, "vacancies.rate": 0.2})
    if kind == "stack":
        place = {"stack.edges": [{"plane": "(0-10)", "position_nm": [1.2, 0.3]}], "damage.threshold_ev.S": 6.9}
        lines = [{"element": "S", "direction": "[100]", "length_nm": 0.9, "positions_nm": [[1.2, 1.2]]}]
        return sw.Recipe(ROOT / "examples/stacks/mos2_edge.toml", set={**QUICK, **SMALL, **place, "stack.vacancy_lines": lines})
    if kind == "particles":
        gold = {"crystal": str(ROOT / "examples/particles/au.cif"), "diameter_nm": [1.2, 1.2], "positions_nm": [[1.2, 1.2]], "shape": "sphere"}
        changes = {"stack.particles": [gold], "stack.begin_nm": 1.6, "field.thickness_nm": 2.0}
        return sw.Recipe(ROOT / "examples/particles/au_on_mgo.toml", set={**QUICK, **SMALL, **changes})
    return sw.Recipe(own_atoms(folder), set={**QUICK, **SMALL, "phonons.sigma_angstrom": {"Au": 0.08, "Ag": 0.08}})


KINDS = ["layer", "stack", "particles", "atoms"]
#: Each kind simulates a specimen of its own.
FIRST, *OTHERS = KINDS
ONE_NOW = [FIRST, *(pytest.param(kind, marks=pytest.mark.long) for kind in OTHERS)]


@pytest.mark.parametrize("kind", KINDS)
def test_streams_sample_every_kind(kind: str, tmp_path: Path) -> None:
    stream = sw.stream(recipe(kind, tmp_path), size=32, dose=1e5, pixel_nm=0.02, seed=3, threads=1)
    samples = list(stream.iterate(count=4))
    columns = np.concatenate([sample.targets.columns for sample in samples])
    assert len(columns) > 10 and all(sample.clean.max() > 0 for sample in samples)
    again = stream.sample(2)
    assert again.counts.tobytes() == samples[2].counts.tobytes()
    if kind == "layer":
        assert columns["vacancies"].sum() > 0
    if kind == "particles":
        assert any(len(sample.targets.particles) for sample in samples)


@pytest.mark.parametrize("kind", ONE_NOW)
def test_live_worlds_lose_atoms_of_every_kind(kind: str, tmp_path: Path) -> None:
    element = {"layer": "S", "stack": "S", "particles": "O", "atoms": "Au"}[kind]
    dying = recipe(kind, tmp_path).set(f"damage.radiolysis_barn.{element}", 2000)
    live = sw.LiveWorld(dying, most_dose=2e4, threads=1)
    place = (0.8, 0.8, 1.6, 1.6)
    before = live.look(place)
    assert before.image.array.max() > 0 and len(before.columns) > 0
    recording = live.acquire(region_nm=place, dose=2e4)
    assert recording.array.size > 100
    [done] = live.history
    assert done["lost"][element] > 0
    after = live.look(place)
    assert after.columns["vacancies"].sum() > before.columns["vacancies"].sum()
    assert not np.array_equal(after.image.array, before.image.array)


@pytest.mark.parametrize("kind", ONE_NOW)
def test_environments_play_every_kind(kind: str, tmp_path: Path) -> None:
    env = gym.make("stemworlds/DefectCensus-v0", recipe=recipe(kind, tmp_path)).unwrapped
    assert isinstance(env, bench.MicroscopeEnv)
    env.reset(seed=0)
    rows, columns = env.field.grid
    for tile in range(rows * columns):
        seen, *_ = env.acquire(tile // columns, tile % columns)
    truth = env.truth_seen()
    assert seen["tile"].max() > 0
    env.step({"type": bench.DECLARE, "report": truth})
    _, _, terminated, _, info = env.step({"type": bench.DONE})
    assert terminated and info["record"]["metrics"]["dec_auc"] > 0
