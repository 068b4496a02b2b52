"""Training of networks: configs, recordings, steps, checkpoints, ONNX, and what analysts make of it. A tiny network on a thin specimen."""

from __future__ import annotations

import dataclasses
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT

import stemworlds as sw
from stemworlds import bench
from stemworlds.bench.fraction import fractions
from stemworlds.bench.kinds import kind_by_number
from stemworlds.bench.network_format import INPUTS, OUTPUTS, Card
from stemworlds.bench.network_reading import _added, _between, _maxima, _together
from stemworlds.bench.neural import _sums, posterior
from stemworlds.train import Config, NetworkTable, OptimiserTable, RunTable, StreamTable, packaged_configs, read_config, train
from stemworlds.train.command import main

#: A material whose library comes along, and whose specimens are laid out fast. Fields of a few tiles would be simulated anew.
RECIPE: dict[str, Any] = {"recipe": "sige", "difficulty": "easy"}


def config(**optimiser: Any) -> Config:
    """Two members of some thousand weights; seconds."""
    return Config(
        StreamTable(recipes=(RECIPE,), pixel_nm=(0.018, 0.024), dose=(1e4, 1e6), repeats=3),
        NetworkTable(channels=(8, 16), blocks=(1, 1)),
        OptimiserTable(**{"steps": 72, "batch": 8, "members": 2, "rate": 5e-3, "average": 0.9, **optimiser}),
        RunTable(processes=0, device="cpu", checkpoint_every=20, log_every=6),
    )


def torch_or_skip() -> Any:
    """PyTorch, or the reason why nothing is trained."""
    for name in ("onnx", "onnxruntime", "onnxscript"):
        pytest.importorskip(name, reason=f"{name} is not installed: no network is trained")
    return pytest.importorskip("torch", reason="PyTorch is not installed (3 GB; sh tests/run.sh --all installs it): no network is trained")


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a training that was not interrupted."""
    torch_or_skip()
    folder = tmp_path_factory.mktemp("trained")
    summary = train(config(), folder, progress=lambda _text: None)
    assert summary.steps == (72, 72) and len(summary.networks) == 2 and not summary.interrupted
    return folder


def rows(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[steam]\n", "did you mean 'stream'"),
        ("[optimiser]\nstep = 3\n", "did you mean 'steps'"),
        ("[optimiser]\nsteps = 1.5\n", "type int"),
        ("[optimiser]\nsteps = true\n", "type int"),
        ("[stream]\nseed = 3\n", "odd ones are for tests"),
        ("[stream]\ndose = [5, 1]\n", "the lower first"),
        ("[stream]\ndose = 5\n", "a list of 2"),
        ("[stream]\nsize = 100\n", "multiple of 16"),
        ("[stream]\nprofiles = {perfect = 1}\n", "known are ideal"),
        ("[network]\nchannels = [8]\n", "as many of each"),
        ("stream = 3\n", "expected a table"),
    ],
)
def test_odd_configs_are_refused(tmp_path: Path, text: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises(sw.InvalidValue, match=words):
        read_config(tmp_path / "c.toml")
    assert main([str(tmp_path / "c.toml"), "--out", str(tmp_path / "out")]) == 1
    assert words in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_configs_name_recipes(tmp_path: Path) -> None:
    assert {name: len(read_config(name).recipes()) for name in packaged_configs()} == {"crystals": 12, "mos2": 3}
    (tmp_path / "thin.toml").write_text(sw.Recipe("test", set={"field.thickness_nm": 0.4, "boundaries.count": 0}).toml)
    (tmp_path / "c.toml").write_text('[stream]\nrecipes = ["srtio3:easy", {recipe = "thin.toml", weight = 3}]\n')
    (first, one), (second, three) = read_config(tmp_path / "c.toml").recipes()
    assert (first.id, first.tier, one, second.id, three) == ("srtio3", "easy", 1.0, "test", 3.0)
    assert first.seed % 2 == second.seed % 2 == 0
    with pytest.raises(sw.errors.FileMissing, match="crystals"):
        read_config(tmp_path / "none.toml")
    for wrong in (3, {"recipe": "test", "tier": "easy"}, {"recipe": "test", "weight": 0}):
        with pytest.raises(sw.InvalidValue):
            Config(StreamTable(recipes=(wrong,))).recipes()


def test_pytorch_is_asked_for_only_when_something_is_trained(tmp_path: Path) -> None:
    program = f"""
import sys
sys.modules["torch"] = None
import stemworlds.train
from stemworlds.train.command import main
assert main(["crystals", "--show"]) == 0
sys.exit(main(["crystals", "--out", {str(tmp_path / "out")!r}]))
"""
    done = subprocess.run([sys.executable, "-c", program], text=True, capture_output=True, check=False)
    assert done.returncode == 1 and "stemworlds[train]" in done.stderr and "CPU" in done.stderr
    assert "[optimiser]" in done.stdout and not (tmp_path / "out").exists()


def test_profiles_are_those_of_the_docs() -> None:
    torch_or_skip()
    from stemworlds.train.recording import VALUES

    table: dict[str, list[list[float]]] = {}
    for line in (ROOT / "docs" / "acquisition.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 4:
            table.setdefault(cells[0].split(" (")[0].split(":")[0], [[float(number) for number in re.findall(r"-?\d+\.?\d*", cell)] for cell in cells[1:]])
    for n, name in enumerate(("routine", "poor"), 1):
        profile = VALUES[name]
        found = {
            "drift along x, y": [profile.drift_x_nm_per_s, profile.drift_y_nm_per_s],
            "line jitter": [10 * profile.jitter_nm],
            "overshoot": [10 * profile.overshoot_nm, profile.overshoot_us],
            "hum at 50 Hz along x, y": [10 * profile.hum_x_nm, 10 * profile.hum_y_nm],
            "scale x, y; shear": [100 * profile.scale_x, 100 * profile.scale_y, 100 * profile.shear],
            "DQE": [profile.dqe],
            "late light": [profile.late_share, profile.late_us],
        }
        for key, values in found.items():
            assert values == pytest.approx(table[key][n]), key
        gain, _, noise = table["counts"][n]
        assert profile.read_noise_electrons == pytest.approx(noise / gain)
    assert VALUES["poor"].saturation_pa == table["saturation"][2][0] and VALUES["routine"].saturation_pa == 0
    assert VALUES["ideal"].jitter_nm == 0 and VALUES["ideal"].dqe == 1


def spots(torch: Any, count: int, random: np.random.Generator) -> tuple[dict[str, Any], Any]:
    """Noise-free tiles of bright spots, and where they are."""
    size, columns = 128, 9
    places = np.stack([random.permutation([(x, y) for x in range(16, 112, 12) for y in range(16, 112, 12)])[:columns] for _ in range(count)])
    places = places + random.uniform(-0.5, 0.5, places.shape)
    y, x = np.mgrid[:size, :size]
    apart = (x - places[:, :, 0, None, None]) ** 2 + (y - places[:, :, 1, None, None]) ** 2
    clean = np.exp(-apart / (2 * 2.5**2)).max(axis=1).astype(np.float32)
    heat = clean.reshape(count, 64, 2, 64, 2).mean(axis=(2, 4))
    tiles = {
        "clean": clean,
        "heat": heat,
        "phase": np.zeros((count, 64, 64), dtype=np.int8),
        "particle": np.zeros((count, 64, 64), dtype=np.float32),
        "places": places.astype(np.float32),
        "there": np.ones((count, columns), dtype=bool),
        "pixel_nm": np.full(count, 0.02, dtype=np.float32),
        "source": np.zeros(count, dtype=np.int32),
    }
    return {name: torch.from_numpy(values) for name, values in tiles.items()}, places


@pytest.mark.parametrize("profile", ["ideal", "routine", "poor"])
def test_labels_lie_where_recordings_show_columns(profile: str) -> None:
    torch = torch_or_skip()
    from stemworlds.train.recording import Recorder

    tiles, _ = spots(torch, 24, np.random.default_rng(1))
    table = StreamTable(dose=(3e5, 3e5), profiles={profile: 1.0})
    batch = Recorder(table, torch.tensor([[68.0, 200.0, 10.0]]), 1)(tiles, 5)
    counts, places = batch["counts"][:, 0].numpy(), batch["places"].numpy()
    assert batch["conditions"].shape == (24, 6) and batch["conditions"][0].tolist() == pytest.approx([3e5, 1.2e4, 0.02, 68, 200, 10])
    offsets, heats = [], []
    for tile, own, heat, there in zip(counts, places, batch["heat"].numpy(), batch["there"].numpy(), strict=True):
        for x, y in own[there]:
            left, top = round(x) - 5, round(y) - 5
            patch = tile[max(top, 0) : top + 11, max(left, 0) : left + 11]
            if patch.shape == (11, 11):
                weight = np.maximum(patch - 0.1 * patch.max(), 0)
                offsets.append([(weight.sum(axis=n) * np.arange(11)).sum() / weight.sum() - 5 + round(at) - at for n, at in ((0, x), (1, y))])
                heats.append(heat[int((y + 0.5) // 2), int((x + 0.5) // 2)])
    mean, rms = np.abs(np.mean(offsets, axis=0)).max(), np.sqrt(np.mean(np.square(offsets)))
    # Lines jitter by 0.25 and 1 pixel rms; a column is seen in some ten lines.
    assert mean < 0.1 and rms < {"ideal": 0.05, "routine": 0.15, "poor": 0.5}[profile] and np.mean(heats) > 0.8
    electrons = counts.sum() / (tiles["clean"].sum().item() * 1.2e4)
    assert electrons == pytest.approx(1.0, abs=0.02 if profile == "ideal" else 0.05 if profile == "routine" else 0.8)
    again = Recorder(table, torch.tensor([[68.0, 200.0, 10.0]]), 1)(tiles, 5)
    assert torch.equal(again["counts"], batch["counts"])
    other = Recorder(table, torch.tensor([[68.0, 200.0, 10.0]]), 1)(tiles, 6)
    assert not torch.equal(other["counts"], batch["counts"])


def test_recordings_have_the_noise_of_their_detector() -> None:
    torch = torch_or_skip()
    from stemworlds.train.recording import Recorder

    tiles, _ = spots(torch, 8, np.random.default_rng(1))
    tiles["clean"] = torch.full_like(tiles["clean"], 0.1)
    for profile, expected in (("ideal", 1.0), ("routine", 1 / 0.8 * (0.98**2 + 2 * 0.98 * 0.02 * 0.39) + 0.16 / 40)):
        table = StreamTable(dose=(1e4, 1e4), profiles={profile: 1.0})
        counts = Recorder(table, torch.tensor([[68.0, 200.0, 10.0]]), 1)(tiles, 1)["counts"]
        assert counts[..., 64:].mean().item() == pytest.approx(40.0, rel=0.01)
        assert (counts[..., 64:].var() / counts[..., 64:].mean()).item() == pytest.approx(expected, rel=0.05)


def test_the_loss_falls(trained: Path) -> None:
    found = rows(trained)
    assert [row["step"] for row in found] == list(range(6, 73, 6)) and found[-1]["tiles"] == 576
    for part in ("heat", "offset"):
        assert found[-1]["losses"][part] < 0.8 * found[0]["losses"][part], part
    assert len(found[0]["members"]) == 2 and found[0]["members"][0] != found[0]["members"][1]
    assert found[0]["rate"] < found[1]["rate"] or found[0]["rate"] > found[-1]["rate"] == pytest.approx(0, abs=1e-4)


def test_training_goes_on_where_it_was(trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    torch = torch_or_skip()
    from stemworlds.train.optimising import Ensemble
    from stemworlds.train.saving import read_checkpoint

    said: list[str] = []
    first = train(config(), tmp_path, progress=said.append, until=0.0)
    assert first.interrupted and first.steps == (1, 72) and not first.networks

    step = Ensemble.step

    def killed(self: Ensemble, batch: Any, number: int) -> Any:
        if number == 50:
            raise RuntimeError("killed")
        return step(self, batch, number)

    # What comes after the last checkpoint, step 40, is lost, and made again.
    with monkeypatch.context() as patched, pytest.raises(RuntimeError, match="killed"):
        patched.setattr(Ensemble, "step", killed)
        train(config(), tmp_path, progress=said.append)
    summary = train(config(), tmp_path, progress=said.append)
    assert summary.before == 40 and "40 steps are done already" in said
    mine, other = (read_checkpoint(folder / "checkpoint.pt", config(), torch.device("cpu")) for folder in (tmp_path, trained))
    assert mine is not None and other is not None and mine[0] == other[0] == 72
    for name in ("networks", "averaged"):
        for a, b in zip(mine[1][name], other[1][name], strict=True):
            assert a.keys() == b.keys() and all(torch.equal(a[key], b[key]) for key in a)
    essence = [[{key: row[key] for key in row if key != "seconds"} for row in rows(folder) if row["step"] > 42] for folder in (tmp_path, trained)]
    assert essence[0] == essence[1]
    assert [row["step"] for row in rows(tmp_path)] == sorted({row["step"] for row in rows(tmp_path)})
    with pytest.raises(sw.InvalidValue, match=r"another config: \[optimiser\] rate"):
        train(config(rate=1e-3), tmp_path, progress=said.append)
    (tmp_path / "checkpoint.pt").write_bytes(b"no checkpoint")
    with pytest.raises(sw.errors.FormatError, match="remove it"):
        train(config(), tmp_path, progress=said.append)



def test_onnx_says_what_pytorch_says(trained: Path) -> None:
    torch = torch_or_skip()
    import onnxruntime

    from stemworlds.train.network import Network
    from stemworlds.train.saving import read_checkpoint

    card = card_of(trained / "member-1.onnx")
    found = read_checkpoint(trained / "checkpoint.pt", config(), torch.device("cpu"))
    assert found is not None and card.kinds == ("Si",) and card.size_px == 128
    network = Network(config().network, 1, 1, 2)
    network.load_state_dict(found[1]["averaged"][1])
    random = np.random.default_rng(1)
    session = onnxruntime.InferenceSession(str(trained / "member-1.onnx"))
    for count, dose in ((1, 300.0), (3, 1e6)):
        electrons = dose * 0.04
        counts = random.poisson(0.1 * electrons, (count, 1, 128, 128)).astype(np.float32)
        conditions = np.tile(np.array([[dose, electrons, 0.02, 68, 200, 10.0]], dtype=np.float32), (count, 1))
        said = dict(zip(OUTPUTS, session.run(list(OUTPUTS), dict(zip(INPUTS, (counts, conditions), strict=True))), strict=True))
        with torch.no_grad():
            seen = network(torch.from_numpy(counts), torch.from_numpy(conditions))
        expected = {
            "column": torch.sigmoid(seen.heat),
            "offset": seen.offset,
            "kind": torch.softmax(seen.kind, dim=1),
            "toward": seen.toward,
            "sharpness": torch.exp(seen.log_sharpness),
            "phase": torch.softmax(seen.phase, dim=1),
            "particle": torch.sigmoid(seen.particle),
        }
        for name, value in expected.items():
            np.testing.assert_allclose(said[name], value.numpy(), rtol=2e-4, atol=2e-5, err_msg=name)
    assert not any(word in (trained / "member-1.onnx").read_bytes().decode("latin-1") for word in ("site-packages", str(trained)))


def card_of(path: Path) -> Card:
    """The card of a file."""
    import onnx

    model = onnx.load(path)
    return Card.read(str(path), {entry.key: entry.value for entry in model.metadata_props}.get("stemworlds"))


def test_a_network_plays(trained: Path) -> None:
    import gymnasium as gym

    models = [str(trained / "member-0.onnx"), str(trained / "member-1.onnx")]
    agent = {"name": "seeing", "navigator": {"kind": "gp", "interest": "uncertainty"}, "analyst": {"kind": "neural", "models": models}}
    for task in ("DefectCensusStrict", "TargetedStrict", "PhaseMapping"):
        env = gym.make(f"stemworlds/{task}-v0", **RECIPE, budget=600.0)
        record = bench.play(env, bench.make_agent(agent), seed=0)
        assert len(record["acquisitions"]) >= 4 and not record["unreadable"]
    analyst = bench.NeuralAnalyst(models[0], least=0.02)
    env = gym.make("stemworlds/DefectCensusStrict-v0", **RECIPE, budget=600.0)
    bench.play(env, bench.Agent("one", bench.Raster(), analyst), seed=0)
    said = analyst.summary()
    assert len(said.forecasts) > 20 and np.allclose(said.forecasts[:, 2:].sum(axis=1), 1)
    # Columns in the overlap of tiles are one.
    apart = np.hypot(*(said.forecasts[:, None, :2] - said.forecasts[None, :, :2]).transpose(2, 0, 1)) + np.eye(len(said.forecasts))
    assert (apart.min(axis=1) > 0.06).mean() > 0.9
    with pytest.raises(sw.errors.FileMissing):
        bench.NeuralAnalyst("nowhere.onnx")


def test_networks_are_held_against_the_ideal_observer(trained: Path) -> None:
    recipe = sw.Recipe("sige", "easy")
    found = fractions(trained / "member-0.onnx", recipe, [1e4, 1e6], tiles=3)
    assert {(row.kind, row.dose) for row in found} == {("Si", 1e4), ("Si", 1e6)}
    for row in found:
        assert row.tiles == 3 and row.columns > 100 and np.isfinite(row.network_bits) and row.ideal_bits < row.prior_bits
        assert (row.fraction is None) == (row.ideal_bits < 0.005)
        if row.interval is not None:
            assert row.interval[0] <= row.fraction <= row.interval[1]
    with pytest.raises(sw.InvalidValue, match="odd"):
        fractions(trained / "member-0.onnx", recipe, [1e4], seed=2)


def test_training_and_use_agree_about_forecasts() -> None:
    torch = torch_or_skip()
    from stemworlds.train.losses import log_chances

    random = np.random.default_rng(2)
    toward, sharpness = random.normal(1, 2, (50, 1)), random.lognormal(0, 2, (50, 1))
    prior = random.dirichlet(np.ones(5), 50)
    mine = torch.exp(log_chances(*(torch.from_numpy(value) for value in (toward[:, 0], np.log(sharpness[:, 0]), np.log(prior))))).numpy()
    np.testing.assert_allclose(posterior(prior, toward, sharpness), mine, rtol=1e-9)


def test_forecasts_add_evidence_to_what_is_usual() -> None:
    prior = np.array([[0.5, 0.3, 0.2]])
    np.testing.assert_allclose(posterior(prior, np.zeros((1, 1)), np.zeros((1, 1))), prior)
    sure = posterior(prior, np.full((1, 1), 400.0), np.full((1, 1), 200.0))
    assert sure[0, 2] > 0.999
    # Two recordings of one column are one of twice the evidence.
    once = posterior(prior, np.full((1, 1), 1.5), np.full((1, 1), 0.7))
    np.testing.assert_allclose(posterior(once, np.full((1, 1), 1.5), np.full((1, 1), 0.7)), posterior(prior, np.full((1, 1), 3.0), np.full((1, 1), 1.4)))
    np.testing.assert_allclose(_sums(np.array([[0.5, 0.5]]), np.array([[0.2, 0.3, 0.5]])), [[0.1, 0.25, 0.65]])


def test_fine_pixels_are_added_up() -> None:
    counts = np.random.default_rng(3).poisson(5, (128, 128)).astype(float)
    assert [_together(pixel, 128) for pixel in (0.03, 0.0105, 0.01, 0.0025)] == [1, 1, 2, 8]
    shown, margin = _added(counts, 2)
    assert shown.shape == (128, 128) and margin == 32 and shown[32:96, 32:96].sum() == counts.sum()
    assert _added(counts, 1)[0] is counts and _added(counts, 8)[0].shape == (128, 128)
    heat = np.zeros((5, 6))
    heat[1, 2], heat[1, 3], heat[4, 5], heat[0, 0] = 0.5, 0.5, 0.4, 0.1
    assert [index.tolist() for index in _maxima(heat, 0.2)] == [[1, 4], [2, 5]]
    maps = np.stack([np.add.outer(np.arange(4.0), 10 * np.arange(5.0))])
    assert _between(maps, np.array([0.5, 1.25, 4.9]), np.array([0.5, 1.0, 3.9]))[:, 0].tolist() == pytest.approx([0.0, 8.0, 43.0])


def test_kinds_are_told_by_the_heaviest_atom() -> None:
    table = kind_by_number(("O", "O Ti", "Sr"), {})
    assert [table[number] for number in (8, 22, 38)] == [0, 1, 2]
    table = kind_by_number(("Ga", "N"), {"alloy": {"host": "Ga", "guest": "In"}})
    assert [table[number] for number in (31, 49, 7)] == [0, 0, 1]


@pytest.mark.parametrize("text", [None, "{}", "[]", '{"version": 2}', '{"version": 1, "kinds": ["O"], "usual": [1], "size_px": 128, "about": {}}'])
def test_strange_networks_are_refused(text: str | None) -> None:
    with pytest.raises(sw.errors.FormatError, match=r"n\.onnx"):
        Card.read("n.onnx", text)


def test_the_command_trains(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    torch_or_skip()
    text = """
[stream]
recipes = ["sige:easy"]
size = 32
pixel_nm = [0.02, 0.03]
[network]
channels = [8]
blocks = [1]
[optimiser]
steps = 4
batch = 2
members = 1
[run]
device = "cpu"
"""
    (tmp_path / "mine.toml").write_text(text)
    words = [str(tmp_path / "mine.toml"), "--out", str(tmp_path / "out"), "--processes", "2", "--json"]
    assert main([*words, "--minutes", "0"]) == 130
    assert json.loads(capsys.readouterr().out)["steps"] == [1, 4]
    assert main(words) == 0
    done = json.loads(capsys.readouterr().out)
    assert done["steps"] == [4, 4] and done["before"] == 1 and Path(done["networks"][0]).is_file()
    # What makes tiles changes no tile.
    alone = dataclasses.replace(read_config(tmp_path / "mine.toml"), run=RunTable(processes=0, device="cpu"))
    train(alone, tmp_path / "alone", progress=lambda _text: None)
    assert (tmp_path / "alone" / "member-0.onnx").read_bytes() == (tmp_path / "out" / "member-0.onnx").read_bytes()
