"""Recipes and specimens."""

from __future__ import annotations

import pickle
import tomllib
from pathlib import Path

import numpy as np
import pytest
from conftest import TINY, command

import stemworlds as sw


def test_recipes_are_those_of_the_command_line(tmp_path: Path) -> None:
    shown = command("show-recipe", "srtio3", "--difficulty", "hard", "--set", "vacancies.rate=0.02", cwd=tmp_path)
    recipe = sw.Recipe("srtio3", "hard", set={"vacancies.rate": 0.02})
    assert tomllib.loads(shown.stdout) == dict(recipe)
    assert sw.recipes()["srtio3"] == ("easy", "medium", "hard") and sw.recipes()["test"] == ()


def test_a_recipe_comes_as_name_path_text_dict_and_recipe(tmp_path: Path) -> None:
    recipe = sw.Recipe("test", seed=9)
    recipe.save(tmp_path / "mine.toml")
    same = [recipe, recipe.toml, dict(recipe), tmp_path / "mine.toml", str(tmp_path / "mine.toml"), pickle.loads(pickle.dumps(recipe))]
    assert all(sw.Recipe(source) == recipe for source in same)


def test_a_file_of_atoms_has_a_recipe(tmp_path: Path) -> None:
    path = tmp_path / "own.xyz"
    path.write_text('2\nLattice="9 0 0 0 9 0 0 0 9"\nAu 2 2 2\nAu 2 2 5\n')
    recipe = sw.Recipe(path)
    assert (recipe.id, recipe["structure"], recipe["atoms.file"]) == ("own", "atoms", str(path))
    assert sw.Recipe(str(path)) == recipe and sw.Recipe(recipe.toml) == recipe
    assert recipe.set("phonons.sigma_angstrom.Au", 0.08)["phonons.sigma_angstrom.Au"] == 0.08
    with pytest.raises(sw.InvalidValue, match="no tiers"):
        sw.Recipe(path, "easy")


def test_changes_give_another_recipe() -> None:
    recipe = sw.Recipe("test")
    changed = recipe.set({"vacancies.rate": np.float64(0.1), "field": {**recipe["field"], "thickness_nm": 0.4}}).unset("boundaries.sigma")
    assert (recipe["vacancies.rate"], changed["vacancies.rate"]) == (recipe["vacancies"]["rate"], 0.1)
    assert changed["field.thickness_nm"] == 0.4 and "boundaries.sigma" not in changed
    assert changed.with_grid(1, 2).grid == (1, 2) and changed.with_seed(2**40).seed == 2**40
    assert recipe.set("boundaries", None) == recipe.unset("boundaries")
    recorded = sw.Recipe("test", acquisition="poor")
    assert recorded["acquisition.profile"] == "poor"
    with pytest.raises(KeyError):
        recipe["nothing.here"]


@pytest.mark.parametrize("layers", [{}, {"surface.entrance_nm": 1, "surface.exit_nm": 0.5}])
def test_specimens_are_those_of_the_command_line(tmp_path: Path, layers: dict[str, float]) -> None:
    from ase.io import read

    settings = {**TINY["set"], **layers}
    changes = [f"--set={key}={value}" for key, value in settings.items()]
    command("specimen", "test", "--grid", "1x2", "--seed", TINY["seed"], *changes, "-o", "atoms.extxyz", cwd=tmp_path)
    stored = read(tmp_path / "atoms.extxyz")
    atoms = sw.specimen("test", **{**TINY, "set": settings})
    assert (atoms.arrays["column"] == -1).any() == bool(layers)
    assert len(atoms) == len(stored) and (atoms.numbers == stored.numbers).all()
    np.testing.assert_allclose(atoms.positions, stored.positions, atol=2e-4)
    np.testing.assert_allclose(atoms.cell.lengths(), stored.cell.lengths(), atol=1e-4)
    np.testing.assert_array_equal(atoms.arrays["column"], stored.arrays["column"])
    np.testing.assert_array_equal(atoms.arrays["atom_type"], stored.arrays["atom_type"])
    np.testing.assert_array_equal(atoms.arrays["defect"], stored.arrays["defect_type"])
    assert (atoms.pbc == stored.pbc).all()


def test_specimens_are_those_of_worlds(world_path: Path) -> None:
    world = sw.World(world_path)
    arrays = sw.specimen_arrays(world.recipe, vacancies=True)
    assert (arrays.numbers == 0).sum() == (world.sites["type"] == 1).sum() > 0
    np.testing.assert_array_equal(arrays.arrays["column"], world.sites["column"])
    names = np.where(world.defect_names == b"", b"none", world.defect_names)
    np.testing.assert_array_equal(arrays.arrays["defect"].astype("S16"), names)
    region = (1.0, 1.0, 2.0, 1.5)
    part = sw.specimen_arrays(world.recipe, region, vacancies=True)
    inside = (world.columns["x_nm"] >= 1) & (world.columns["x_nm"] < 2) & (world.columns["y_nm"] >= 1) & (world.columns["y_nm"] < 1.5)
    assert len(np.unique(part.arrays["column"])) == inside.sum()


def test_a_specimen_can_be_simulated(tmp_path: Path) -> None:
    atoms = sw.specimen("test", region_nm=(1.0, 1.0, 2.2, 2.2), **TINY)
    image = sw.simulate(atoms, scan=sw.Scan(points=(6, 6)))
    assert image.array.shape == (6, 6) and image.array.max() > 0
    atoms.write(tmp_path / "part.extxyz")
    assert sw.simulate(tmp_path / "part.extxyz", scan=sw.Scan(points=(2, 2))).array.shape == (2, 2)
