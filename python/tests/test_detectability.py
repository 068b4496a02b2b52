"""The dose at which a defect is seen."""

from __future__ import annotations

from pathlib import Path

import pytest

import stemworlds as sw
from stemworlds import errors

#: A quick question: one layer of MoS2, few configurations.
QUICK = {"phonons": 4, "ring_mrad": 0.0, "step_angstrom": 0.3}


def test_a_missing_sulphur_atom_of_a_layer_is_found(tmp_path: Path) -> None:
    found = sw.detectability("mos2", difficulty="easy", **QUICK)
    (case,) = found.cases
    assert case.defect == "vacancy:S@middle" and case.column == "S2"
    result = case.detectors["HAADF"]
    assert result.needed.verdict == "found" and result.needed.dose is not None
    assert result.contrast_percent < -20 and 1e2 < result.needed.dose < 1e5
    assert result.needed.low is not None and result.needed.low < result.needed.dose
    power = [at["known"]["power"] for at in result.doses]
    assert power == sorted(power) and [at["electrons_per_angstrom2"] for at in result.doses][:2] == [100.0, 1000.0]
    assert "missing S atom" in found.sentences[0] and str(found) == found.sentences[0]
    for name in ("a.json", "a.csv", "a.svg"):
        found.save(tmp_path / name)
    assert (tmp_path / "a.csv").read_text().startswith("defect,thickness_nm")
    with pytest.raises(errors.FileThere):
        found.save(tmp_path / "a.csv")
    with pytest.raises(sw.InvalidValue, match="ends in"):
        found.save(tmp_path / "a.txt")


def test_threads_change_nothing() -> None:
    one, two = (sw.detectability("mos2", difficulty="easy", threads=n, **QUICK) for n in (1, 2))
    assert one.details == two.details


def test_a_recipe_and_its_atoms_agree() -> None:
    recipe = sw.Recipe("graphene", "easy")
    given = sw.detectability(recipe, "vacancy:C", **QUICK)
    changed = sw.detectability(recipe, "vacancy:C", energy_kv=80.0, semiangle_mrad=30.0, detectors={"ADF": (70, 200)}, **QUICK)
    assert list(changed[0].detectors) == ["ADF"] and changed.details["energy_kev"] == 80.0
    assert given.details["energy_kev"] == recipe["optics.energy_kv"]


def test_wrong_values_name_their_keyword() -> None:
    with pytest.raises(sw.InvalidValue, match="defects") as caught:
        sw.detectability("mos2", "vacancy", difficulty="easy")
    assert caught.value.keyword == "defects"
    with pytest.raises(sw.InvalidValue, match="only Mo, S"):
        sw.detectability("mos2", "vacancy:O", difficulty="easy")
    with pytest.raises(sw.InvalidValue) as caught:
        sw.detectability("mos2", difficulty="easy", power=2.0)
    assert caught.value.keyword == "power"
    with pytest.raises(sw.InvalidValue, match="phonons"):
        sw.detectability("mos2", difficulty="easy", phonons=1)
    with pytest.raises(TypeError, match="nothing"):
        sw.detectability("mos2", difficulty="easy", nothing=1)  # type: ignore[call-arg]
