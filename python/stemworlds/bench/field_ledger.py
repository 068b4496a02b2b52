"""Scores episodes of the tasks about the whole field."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .field_scores import BEST_COLUMNS, map_bits, named_columns, rare_score
from .field_truth import FieldTruth, Mask, expected_counts, field_truth
from .findings import Findings
from .ledger import Ledger


@dataclass(eq=False, kw_only=True)
class FieldLedger(Ledger):
    """Records the seen part of a field in one episode, and the last declaration.

    Attributes:
        task: ``"field-recall"``, ``"density-map"`` or ``"rare"``.
        strict: for ``"field-recall"``, score the columns that the agent named instead of the seen ones.
    """

    task: str
    strict: bool
    _looked: int = 0
    _truth: FieldTruth | None = None
    _constant: float = 0.0
    #: Masks of the columns, and of the tiles, that an acquisition shows.
    _columns_seen: Mask = field(default_factory=lambda: np.zeros(0, dtype=bool))
    _tiles_seen: Mask = field(default_factory=lambda: np.zeros((0, 0), dtype=bool))

    def share(self) -> float:
        """Returns the score of the last declaration; 0 before the first declaration, and before the first acquisition."""
        if self.findings is None or not self._views:
            return 0.0
        truth = self._follow()
        if self.task == "density-map":
            gained, most = map_bits(truth, self.findings.density, self._constant, self._tiles_seen)
            return min(max(gained / most, 0.0), 1.0) if most > 0 else 0.0
        if self.task == "rare":
            return rare_score(truth, self.findings.rare, self._tiles_seen)[0]
        if self.strict:
            _, held, best = named_columns(truth, self.findings.columns)
            return held / best if best else 0.0
        return self._recall(truth)

    def _recall(self, truth: FieldTruth) -> float:
        """Returns the share of the field's defects that acquisitions show; 1 if the field has no defect."""
        return float(truth.numbers[self._columns_seen].sum()) / truth.total if truth.total else 1.0

    def _follow(self) -> FieldTruth:
        """Marks the columns and tiles seen since the last call. Returns the truth."""
        if self._truth is None:
            specimen = self.specimen()
            self._truth = field_truth(specimen.toml)
            self._constant = float(expected_counts(specimen, self._truth.grid).mean())
            self._columns_seen = np.zeros(len(self._truth.numbers), dtype=bool)
            self._tiles_seen = np.zeros(self._truth.counts.shape, dtype=bool)
        x, y = self._truth.columns.places_nm.T
        for left, top, right, bottom in self._views[self._looked :]:
            self._columns_seen |= (x >= left) & (x <= right) & (y >= top) & (y <= bottom)
            self._tiles_seen |= self._truth.grid.touched((left, top, right, bottom))
        self._looked = len(self._views)
        return self._truth

    def truth(self, seen: Findings) -> Findings:
        """Adds the true map of the field, the seen columns with most defects, and the seen rare tiles to ``seen``."""
        truth = self._follow()
        own = np.flatnonzero(self._columns_seen)
        best = own[np.argsort(-truth.numbers[own], kind="stable")[:BEST_COLUMNS]]
        width, height = truth.grid.cell_nm
        row, column = np.nonzero((truth.clusters > 0) & self._tiles_seen)
        return dataclasses.replace(
            seen,
            density=truth.counts,
            columns=np.column_stack([truth.columns.places_nm[best], truth.numbers[best]]),
            rare=np.column_stack([(column + 0.5) * width, (row + 0.5) * height]),
        )

    def numbers(self) -> dict[str, float]:
        """Returns all numbers about the last declaration. They do not depend on the task."""
        if self.findings is None or not self._views:
            return {}
        truth = self._follow()
        hits, held, best = named_columns(truth, self.findings.columns)
        gained, most = map_bits(truth, self.findings.density, self._constant, self._tiles_seen)
        rare, found, clusters, claims = rare_score(truth, self.findings.rare, self._tiles_seen)
        unseen = int((~self._tiles_seen).sum())
        named = min(BEST_COLUMNS, len(self.findings.columns))
        return {
            "recall": self._recall(truth),
            "area_seen": float(self._tiles_seen.mean()),
            "precision_at_k": hits / named if named else 0.0,
            "columns_with_a_defect": float((truth.numbers > 0).mean()) if len(truth.numbers) else 0.0,
            "defects_at_k": held / best if best else 0.0,
            "map_bits": gained,
            "map_bits_of_the_truth": most,
            "map_bits_per_tile": gained / unseen if unseen else 0.0,
            "rare": rare,
            "rare_found": found,
            "rare_clusters": clusters,
            "rare_claims": claims,
        }

    def told(self, record: dict[str, Any]) -> dict[str, Any]:
        """Returns the record of the episode with the scores of this task. The library's scores are removed, since they belong to the defect
        census."""
        scores = None if record.get("scores") is None else {"paper": None, "close": None, "strict": None, "columns": None, "field": self.numbers()}
        return {**record, "scores": scores, **self.own_curve()}
