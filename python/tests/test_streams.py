"""Streams of annotated samples, and the files that others train on."""

from __future__ import annotations

import csv
import json
import multiprocessing
import struct
import tarfile
import zlib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from conftest import TINY

import stemworlds as sw
from stemworlds.streaming import SAMPLE_COLUMN_DTYPE

OPTIONS: dict[str, Any] = {"size": 48, "dose": (1e3, 1e5), "pixel_nm": (0.02, 0.03), "seed": 7, "batch": 4}


@pytest.fixture(scope="module")
def stream() -> sw.Stream:
    """Without a cache; others are compared with it."""
    return sw.stream("test", cache=False, set=TINY["set"], **OPTIONS)


def digest(sample: sw.Sample) -> tuple[int, bytes, bytes, bytes]:
    return sample.index, sample.counts.tobytes(), sample.targets.heat_map.tobytes(), sample.targets.columns.tobytes()


def in_a_worker(indices: list[int]) -> list[tuple[int, bytes, bytes, bytes]]:
    stream = sw.stream("test", set=TINY["set"], threads=1, **OPTIONS)
    return [digest(stream.sample(index)) for index in indices]


def test_a_sample_depends_on_seed_and_index_alone(stream: sw.Stream) -> None:
    first = [digest(sample) for sample in stream.iterate(count=5)]
    assert [index for index, *_ in first] == list(range(5)) and len({data for _, data, *_ in first}) == 5
    assert [digest(sample) for sample in stream.samples([4, 2])] == [first[4], first[2]]
    assert [digest(sample) for sample in stream.iterate(1, 2, 2)] == [first[1], first[3]]
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        found = pool.map(in_a_worker, [[0, 2, 4], [1, 3]])
    assert sorted(found[0] + found[1]) == first
    other = sw.stream("test", set=TINY["set"], **{**OPTIONS, "seed": 8})
    assert digest(other.sample(0)) != first[0]


def test_a_stream_goes_to_another_process(stream: sw.Stream) -> None:
    """As the workers of a DataLoader get it where processes are spawned."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        [found] = pool.map(stream.samples, [[3, 1]])
    assert [digest(sample) for sample in found] == [digest(sample) for sample in stream.samples([3, 1])]


def test_samples_show_what_their_targets_say(stream: sw.Stream) -> None:
    for sample in stream.iterate(count=6):
        image, targets = sample
        assert image.dtype == np.float32 and image.shape == targets.heat_map.shape == (48, 48)
        assert 1e3 <= sample.dose <= 1e5 and 0.02 <= sample.pixel_nm <= 0.03 and 0 <= sample.angle_deg <= 360
        np.testing.assert_allclose(sample.counts.sum(), sample.clean.sum(dtype=float) * sample.dose * (10 * sample.pixel_nm) ** 2, rtol=0.2)
        columns = targets.columns
        x, y = np.rint(columns["x_px"]).astype(int), np.rint(columns["y_px"]).astype(int)
        inner = (x > 0) & (x < 47) & (y > 0) & (y < 47)
        np.testing.assert_array_equal(targets.class_mask[y[inner], x[inner]], columns["class"][inner])
        assert (targets.heat_map[y[inner], x[inner]] > 0.85).all()
        strontium = inner & (columns["number"] == 38)
        assert strontium.any() and np.median(sample.clean[y[strontium], x[strontium]]) > 2 * np.median(sample.clean)
        np.testing.assert_allclose(columns["occupancy"], 1 - columns["vacancies"] / columns["sites"], rtol=1e-6)


def test_a_straight_sample_is_the_world(stream: sw.Stream, world_path: Path) -> None:
    """At the pixels of a world the same image is made of the same atoms."""
    world = sw.World(world_path)
    options = {**OPTIONS, "pixel_nm": None, "angle_deg": 0.0}
    sample = sw.stream(world.recipe, **options).sample(3)
    recipe = world.recipe
    full = np.array(recipe["field.grid"]) * 124 + 4
    built = np.array(recipe.shape)
    corner = (full - built) // 124 // 2 * 124  # the first built pixel in the full field
    x, y = np.array(sample.centre_nm) / world.pixel_nm - 23.5 - corner[::-1]
    from scipy.ndimage import map_coordinates

    rows, places = np.meshgrid(np.arange(48) + y, np.arange(48) + x, indexing="ij")
    clean = map_coordinates(world.image(clean=True).array.astype(float), [rows, places], order=5)
    inner = (slice(4, -4), slice(4, -4))
    assert np.abs(sample.clean[inner] - clean[inner]).max() < 0.02 * clean.max()


def test_mixtures_and_specimens_of_their_own() -> None:
    thick = sw.Recipe("test", set={**TINY["set"], "vacancies.rate": 0.2})
    thin = sw.Recipe("test", set=TINY["set"])
    mixed = sw.stream({thick: 3.0, thin: 1.0}, **{**OPTIONS, "size": 16})
    sources = np.array([mixed._source(index) for index in range(2000)])
    assert 0.22 < (sources == 1).mean() < 0.28
    assert {sample.source for sample in mixed.iterate(count=12)} == {0, 1}
    other = sw.stream(thin, samples_per_specimen=2, **{**OPTIONS, "size": 16})
    assert len({digest(sample) for sample in other.iterate(count=6)}) == 6


@pytest.mark.long
def test_samples_of_all_detectors() -> None:
    haadf = {"name": "HAADF", "inner_mrad": 68.0, "outer_mrad": 200.0}
    halves = {"name": "HALF", "inner_mrad": 50.0, "outer_mrad": 150.0, "sectors": 2, "first_sector_deg": 90.0}
    recipe = sw.Recipe("test", set={**TINY["set"], "detector": [haadf, halves]})
    options = {**OPTIONS, "size": 16, "cache": False}
    sample = sw.stream(recipe, detectors="all", **options).sample(1)
    assert list(sample.images) == ["HAADF", "HALF_0", "HALF_1"] == list(sample.clean_images)
    assert np.array_equal(sample.images["HAADF"], sample.image)
    assert np.array_equal(sample.clean_images["HAADF"], sample.clean)
    alone = sw.stream(recipe, **options).sample(1)
    assert digest(alone) == digest(sample) and not alone.images
    # the two halves of a wider annulus together are brighter than the narrow one
    both = sample.clean_images["HALF_0"] + sample.clean_images["HALF_1"]
    assert both.mean() > sample.clean.mean() and np.corrcoef(both.ravel(), sample.clean.ravel())[0, 1] > 0.9
    with pytest.raises(sw.InvalidValue, match="'main' or 'all'"):
        sw.stream(recipe, detectors="some", **options)  # type: ignore[call-overload]


@pytest.mark.long
def test_particles_have_outlines(tmp_path: Path) -> None:
    recipe = sw.Recipe("pt", "easy", set={"field.fov_nm": [6.0, 6.0], "field.grid": [2, 2], "particles.count": 1, "phonons.configurations": 1, "field.thickness_nm": 1.0, "particles.diameter_nm": [1.5, 2.0]})
    stream = sw.stream(recipe, size=40, pixel_nm=0.1, angle_deg=0, seed=2, batch=2)
    samples = list(stream.iterate(count=2))
    outlines = np.concatenate([sample.targets.particles for sample in samples])
    assert len(outlines) > 0 and set(outlines["morphology"]) <= {"wulff", "icosahedral", "decahedral"}
    assert ((outlines["radius_px"] > 5) & (outlines["radius_px"] < 11)).all()
    sw.export(samples, tmp_path / "coco.json")
    coco = json.loads((tmp_path / "coco.json").read_text())
    assert len(coco["images"]) == 2 and len(coco["annotations"]) > 0
    for sample, about in zip(samples, coco["images"], strict=True):
        # a whole grey image with the pixels of the sample
        data = (tmp_path / about["file_name"]).read_bytes()
        width, height, bits, colour = struct.unpack(">IIBB", data[16:26])
        assert (height, width, bits, colour) == (*sample.image.shape, 8, 0)
        start = data.index(b"IDAT") + 4
        rows = np.frombuffer(zlib.decompress(data[start:]), np.uint8).reshape(height, width + 1)
        low, high = about["grey_from_to"]
        grey = np.clip((sample.image - low) / (high - low) * 255, 0, 255)
        assert np.abs(rows[:, 1:] - grey).max() <= 0.51 and not rows[:, 0].any()
        assert about["dose"] == sample.dose and coco["info"]["recipes"][about["source"]] == sample.recipe
    with pytest.raises(FileExistsError):
        sw.export(samples, tmp_path / "coco.json")
    tools = pytest.importorskip("pycocotools.coco")
    read = tools.COCO(str(tmp_path / "coco.json"))
    for annotation in read.loadAnns(read.getAnnIds()):
        assert read.annToMask(annotation).sum() == pytest.approx(annotation["area"], rel=0.1, abs=12)


def test_files_for_training(stream: sw.Stream, tmp_path: Path) -> None:
    samples = list(stream.iterate(count=3))
    sw.export(stream, tmp_path / "a.npz", count=3)
    stacks = np.load(tmp_path / "a.npz")
    for name in ("images", "clean", "heat_maps", "class_masks", "phase_masks"):
        assert stacks[name].shape == (3, 48, 48)
    for n, sample in enumerate(samples):
        own = stacks["columns"][stacks["columns"]["sample"] == sample.index]
        np.testing.assert_array_equal(own["x_px"], sample.targets.columns["x_px"])
        assert stacks["angle_deg"][n] == sample.angle_deg and tuple(stacks["centre_nm"][n]) == sample.centre_nm
        assert str(stacks["recipes"][stacks["source"][n]]) == sample.recipe and "[field]" in sample.recipe
    # as `stemgen tiles` has it
    assert stacks["columns"].dtype.names == ("sample", *SAMPLE_COLUMN_DTYPE.names)
    np.testing.assert_array_equal(stacks["images"][1], samples[1].image)
    sw.export(samples, tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    sw.export(samples, tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5") as file:
        np.testing.assert_array_equal(file["class_masks"][2], samples[2].targets.class_mask)
        assert file["recipes"].asstr()[0] == samples[0].recipe and file["columns"].dtype == stacks["columns"].dtype
    with pytest.raises(sw.InvalidValue, match="no sample shows a particle"):
        sw.export(samples, tmp_path / "none.json")
    assert not (tmp_path / "none.json").exists() and not (tmp_path / "none_images").exists()
    sw.export(samples, tmp_path / "a.csv")
    with open(tmp_path / "a.csv") as text:
        rows = list(csv.DictReader(text))
    assert len(rows) == sum(len(sample.targets.columns) for sample in samples)
    assert float(rows[0]["x_px"]) == pytest.approx(float(samples[0].targets.columns["x_px"][0]))
    sw.export(samples, tmp_path / "a.tar")
    with tarfile.open(tmp_path / "a.tar") as tar:
        names = tar.getnames()
        assert len(names) == 12 and names[0] == "00000000.image.npy"
    with pytest.raises(FileExistsError):
        sw.export(samples, tmp_path / "a.csv")
    with pytest.raises(sw.InvalidValue, match="endless"):
        sw.export(stream, tmp_path / "c.npz")
    with pytest.raises(sw.InvalidValue, match=".npz"):
        sw.export(samples, tmp_path / "c.png")


def test_bad_streams_are_refused() -> None:
    for bad, told in (
        ({"size": 4}, "8 to 8192"),
        ({"size": 2000}, "does not fit"),
        ({"dose": (5, 1)}, "the lower first"),
        ({"pixel_nm": "fine"}, "pixel_nm"),
        ({"heat_sigma_px": 0.0}, "0.3 to 50"),
        ({"batch": 0}, "above 0"),
    ):
        with pytest.raises(sw.InvalidValue, match=told):
            sw.stream("test", **bad)
    with pytest.raises(sw.InvalidValue, match="no recipe"):
        sw.stream([])


@pytest.mark.parametrize(("workers", "start"), [(0, None), (2, "fork"), (2, "spawn")])
def test_data_loaders_yield_the_same_samples(stream: sw.Stream, workers: int, start: str | None) -> None:
    torch = pytest.importorskip("torch")
    dataset = sw.torch.TileDataset(stream, count=8)
    loader = torch.utils.data.DataLoader(dataset, batch_size=2, num_workers=workers, multiprocessing_context=start)
    found: dict[int, bytes] = {}
    for number, batch in enumerate(loader):
        assert batch["image"].shape == (2, 1, 48, 48) and batch["class_mask"].dtype == torch.int64
        found.update((int(index), image.numpy().tobytes()) for index, image in zip(batch["index"], batch["image"], strict=True))
    assert number == 3, "none twice"
    assert found == {sample.index: sample.image.tobytes() for sample in stream.iterate(count=8)}
