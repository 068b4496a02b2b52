"""The card of a folder of worlds: valid Croissant, whose records are what the worlds say."""

from __future__ import annotations

import csv
import hashlib
import re
import shutil
import socket
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest
from conftest import command

import stemworlds as sw

SAID = (
    *("--title", "Small worlds", "--license", "CC-BY-4.0", "--creator", "A. Person", "--date", "2026-11-23"),
    *("--url", "https://example.org/worlds", "--cite", "A. Person: Small worlds"),
)
THIN = {"field.thickness_nm": 0.4, "phonons.configurations": 1}


@pytest.fixture(scope="module")
def hub(tmp_path_factory: pytest.TempPathFactory, world_path: Path) -> Path:
    """A folder with vacancies, substitutions and a particle."""
    folder = tmp_path_factory.mktemp("hub")
    shutil.copyfile(world_path, folder / "vacancies.h5")
    sw.build("sige", difficulty="easy", grid=(1, 1), set=THIN, out=folder / "substitutions.h5", audit=0).close()
    small = {"field.fov_nm": [3.0, 3.0], "field.grid": [2, 2], "particles.count": 1, "particles.diameter_nm": [1.2, 1.5]}
    film = THIN | small | {"field.thickness_nm": 1.0}
    sw.build("pt", difficulty="easy", set=film, out=folder / "particles.h5", audit=0).close()
    command("card", folder, *SAID, cwd=folder)
    return folder


@pytest.fixture
def dataset(hub: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The folder as mlcroissant sees it, without a network."""
    mlcroissant = pytest.importorskip("mlcroissant")

    def refuse(*_: object) -> NoReturn:
        raise AssertionError("the network was asked")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)
    return mlcroissant.Dataset(hub / "croissant.json")


def records(dataset: Any, name: str) -> dict[str, list[Any]]:
    """The columns of a record set; texts as such, what is missing as None."""
    found: dict[str, list[Any]] = {}
    for record in dataset.records(name):
        for field, value in record.items():
            assert field.startswith(f"{name}/")
            found.setdefault(field.removeprefix(f"{name}/"), []).append(value.decode() if isinstance(value, bytes) else value)
    return found


def test_the_card_is_valid(dataset: Any, hub: Path) -> None:
    issues = dataset.metadata.ctx.issues
    assert not issues.errors and not issues.warnings
    metadata = dataset.metadata
    assert str(metadata.ctx.conforms_to.value).endswith("/1.1") and metadata.name == "Small worlds"
    assert "no microscope recorded" in metadata.data_collection and metadata.data_limitations and metadata.data_use_cases
    assert any(" columns (" in text for text in metadata.data_biases)
    listed = {file.id: file.sha256 for file in metadata.distribution}
    there = {path.relative_to(hub).as_posix(): path for path in hub.rglob("*") if path.is_file()}
    assert listed.keys() == there.keys() - {"README.md", "croissant.json"}
    assert listed == {name: hashlib.sha256(there[name].read_bytes()).hexdigest() for name in listed}


def test_its_records_are_what_the_worlds_say(dataset: Any, hub: Path) -> None:
    names = {record_set.id for record_set in dataset.metadata.record_sets}
    expected = {"worlds", "columns_particles", "particles_particles", "columns_vacancies", "columns_substitutions"}
    expected |= {"defects_vacancies", "defects_substitutions"}
    assert names - {"defects_particles"} == expected
    worlds = records(dataset, "worlds")
    assert worlds["world"] == ["particles", "substitutions", "vacancies"]
    for i, name in enumerate(worlds["world"]):
        with sw.World(hub / f"{name}.h5") as world:
            facts = world.metadata
            told = {field: values[i] for field, values in worlds.items()}
            assert told["material"] == facts.material and told["seed"] == facts.seed and told["noise"] is facts.noise
            assert (told["tile_rows"], told["tile_columns"]) == world.grid and told["pixel_nm"] == world.pixel_nm
            assert (told["height_px"], told["width_px"]) == world.shape and told["sites"] == facts.site_count
            assert told["dose_electrons_per_angstrom2"] == facts.dose_electrons_per_angstrom2
            columns = records(dataset, f"columns_{name}")
            for field in ("x_nm", "y_nm", "sites", "vacancies", "substitutions"):
                np.testing.assert_array_equal(np.array(columns[field], world.columns[field].dtype), world.columns[field])
            assert [text or "" for text in columns["composition"]] == world.columns["composition"].tolist()
            assert columns["column"] == list(range(told["columns"])) and set(columns["world"]) == {name}
            check_defects(records(dataset, f"defects_{name}") if f"defects_{name}" in names else {}, world, told)
            if name == "particles":
                check_particles(records(dataset, "particles_particles"), world)


def check_defects(defects: dict[str, list[Any]], world: sw.World, told: dict[str, Any]) -> None:
    at = np.flatnonzero(world.sites["type"])
    assert defects.get("site", []) == at.tolist()
    assert told["vacancies"] + told["substitutions"] == len(at)
    if len(at) == 0:
        return
    sites = world.sites[at]
    for field in ("x_nm", "y_nm", "z_nm", "column"):
        np.testing.assert_array_equal(np.array(defects[field], sites[field].dtype), sites[field])
    kinds = {1: "vacancy", 2: "substitution"}
    assert defects["type"] == [kinds[kind] for kind in sites["type"].tolist()]
    named = [f"{kind}_{element}" for kind, element in zip(defects["type"], defects["element"], strict=True)]
    assert named == [name.decode() for name in world.defect_names[at]]


def check_particles(found: dict[str, list[Any]], world: sw.World) -> None:
    particles = world.particles
    assert len(particles) > 0 and found["particle"] == list(range(len(particles)))
    for field in ("x_nm", "y_nm", "z_nm", "diameter_nm"):
        np.testing.assert_array_equal(np.array(found[field], "f4"), particles[field])
    turns = np.array([found[field] for field in ("qw", "qx", "qy", "qz")], "f4").T
    np.testing.assert_array_equal(turns, particles["orientation"])
    assert found["morphology"] == particles["morphology"].tolist()


def test_the_readme_has_a_head_and_code_that_runs(hub: Path, dataset: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    yaml = pytest.importorskip("yaml")
    text = (hub / "README.md").read_text()
    _, head, body = text.split("---\n", 2)
    facts = yaml.safe_load(head)
    assert facts["pretty_name"] == "Small worlds" and facts["license"] == "cc-by-4.0" and facts["size_categories"] == ["n<1K"]
    configs = {config["config_name"]: config["data_files"] for config in facts["configs"]}
    assert configs["worlds"] == "worlds.csv" and configs["defects"] == "defects/*.csv"
    assert all(list(hub.glob(pattern)) for pattern in configs.values())
    # Tables of one kind have the same columns, so that a hub can put them together.
    for kind in ("columns", "defects", "particles"):
        heads = [next(csv.reader(path.open())) for path in sorted(hub.glob(f"{kind}/*.csv"))]
        assert heads and all(line == heads[0] for line in heads)
    pictures = re.findall(r"!\[\w+\]\(([^)]+)\)", body)
    assert len(pictures) == 3 and all((hub / picture).read_bytes().startswith(b"\x89PNG") for picture in pictures)
    blocks = re.findall(r"^```python\n(.*?)^```", body, re.MULTILINE | re.DOTALL)
    assert len(blocks) == 3
    monkeypatch.chdir(hub)
    for block in blocks:
        exec(compile(block, "README.md", "exec"), {})


def test_the_same_worlds_make_the_same_card(hub: Path, tmp_path: Path) -> None:
    command("card", hub, "-o", tmp_path / "copy", *SAID, cwd=tmp_path)
    files = [path.relative_to(hub) for path in hub.rglob("*") if path.is_file()]
    assert len(files) > 15
    assert [name for name in files if (hub / name).read_bytes() != (tmp_path / "copy" / name).read_bytes()] == []
    told = command("card", tmp_path, cwd=tmp_path, check=False)
    assert told.returncode == 1 and "holds no worlds" in told.stderr and "`stemgen build`" in told.stderr
