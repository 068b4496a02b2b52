"""The networks that come with the package: they see what docs/training.md says, also where no image of the training occurs."""

from __future__ import annotations

from pathlib import Path

import pytest

import stemworlds as sw
import stemworlds.bench as bench

pytest.importorskip("onnxruntime")


@pytest.mark.parametrize("library_seed", [0, 1])
def test_the_network_of_mos2_sees_most_of_what_can_be_seen(library_seed: int) -> None:
    from stemworlds.bench.fraction import fractions

    # Two configurations: the second library is simulated here.
    recipe = sw.Recipe("mos2", "hard", set={"phonons.library_seed": library_seed, "phonons.configurations": 2, "vacancies.rate": 0.05})
    found = {one.kind: one for one in fractions("mos2", recipe, [3e4], tiles=4)}
    sulphur = found["S"]
    assert sulphur.columns > 200 and sulphur.ideal_bits > 0.1
    assert sulphur.fraction is not None and 0.6 < sulphur.fraction < 1.15, sulphur
    assert sulphur.found > 0.95 and sulphur.error_nm < 0.01
    assert found["Mo"].found > 0.95


def test_shipped_networks_have_names(tmp_path: Path) -> None:
    shipped = bench.packaged_networks()
    assert list(shipped) == ["mos2"] and shipped["mos2"].stat().st_size < 12e6
    agent = bench.make_agent({"name": "n", "navigator": "raster", "analyst": {"kind": "neural", "models": ["mos2"]}})
    assert isinstance(agent.analyst, bench.NeuralAnalyst)
    bench.NeuralAnalyst(["mos2", shipped["mos2"]])
    with pytest.raises(sw.errors.FileMissing, match="mos3"):
        bench.NeuralAnalyst("mos3")
