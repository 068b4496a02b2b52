"""atomap, an atom finder of another package, finds the columns of MoS2 where the ground truth lists them."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest
from conftest import ROOT

import stemworlds as sw

pytestmark = pytest.mark.skipif(importlib.util.find_spec("atomap") is None, reason="atomap is not installed")


def test_atomap_finds_the_columns_of_a_layer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "benches"))
    sys.modules.pop("atomap_columns", None)
    from atomap_columns import measured  # type: ignore[import-not-found]

    path = tmp_path / "mos2.h5"
    sw.build("mos2", difficulty="easy", grid=(1, 1), out=path, keep_clean=True, audit=0).close()
    [counted, clean] = measured(str(path), 0.08)
    assert (counted["image"], clean["image"]) == ("counted", "noise-free")
    for row in (counted, clean):
        assert row["of"]["Mo1"][1] == 1.0 and row["false"] < 0.03, row
        assert row["of"]["S2"][1] > 0.9 and row["rms_pm"] < 12, row
    assert clean["of"]["S2"][1] == 1.0 and clean["rms_pm"] < 7, clean
