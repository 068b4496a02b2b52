"""Scores episodes of the tasks about columns, column by column."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ..recipes import Recipe
from .columns import columns_of
from .findings import Findings
from .forecasts import ForecastScore, score_forecasts
from .ledger import Ledger
from .prior import prior_of


@dataclass(eq=False, kw_only=True)
class ColumnLedger(Ledger):
    """Records the columns that one episode has seen, and the last declaration about them.

    Attributes:
        target: the type of defect of the task; ``None`` for all types.
    """

    target: str | None
    _looked: int = 0
    _toml: str | None = None
    _held: dict[tuple[int, int], tuple[tuple[float, float], int, npt.NDArray[np.float64]]] = field(default_factory=dict)

    def share(self) -> float:
        """Returns the score of the last declaration; 0 if it contains no forecasts."""
        if self.findings is None or not len(self.findings.forecasts) or not self._views:
            return 0.0
        return self.score().share

    def score(self) -> ForecastScore:
        """Returns all numbers about the last declaration."""
        places, counts, prior = self._seen()
        return score_forecasts(self.findings, places, counts, prior)

    def _seen(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64], npt.NDArray[np.float64]]:
        """Returns places, numbers of defects and prior probabilities of the columns in the acquired areas, each column once."""
        if self._toml is None:
            self._toml = self.specimen().toml
        prior = prior_of(Recipe(self._toml))
        for view in self._views[self._looked :]:
            columns = columns_of(self._toml, view)
            counts, chances = columns.counts(self.target), prior.of(columns, self.target)
            for n, (x, y) in enumerate(columns.places_nm.tolist()):
                self._held.setdefault((round(x * 1e5), round(y * 1e5)), ((x, y), int(counts[n]), chances[n]))
        self._looked = len(self._views)
        found = [self._held[key] for key in sorted(self._held)]
        classes = prior.chances[self.target].shape[2]
        places = np.array([place for place, _, _ in found], dtype=np.float64).reshape(-1, 2)
        counted = np.array([count for _, count, _ in found], dtype=np.int64)
        return places, counted, np.array([chances for _, _, chances in found]).reshape(-1, classes)

    def truth(self, seen: Findings) -> Findings:
        """Adds forecasts with the true numbers of defects in the seen columns to ``seen``."""
        if not self.scored:
            return seen
        places, counts, prior = self._seen()
        sure = np.zeros_like(prior)
        sure[np.arange(len(counts)), np.minimum(counts, prior.shape[1] - 1)] = 1.0
        return dataclasses.replace(seen, forecasts=np.column_stack([places, sure]))

    def told(self, record: dict[str, Any]) -> dict[str, Any]:
        """Adds the scores by column to the record of the episode."""
        scores = record.get("scores")
        if scores is not None and self.findings is not None:
            forecast = bool(len(self.findings.forecasts)) and bool(self._views)
            # The library's strict census scores counts alone, which a blind agent can know, so its score is not passed on.
            close = {} if self.target is None else {"close": scores["strict"]}
            scores = {**scores, **close, "strict": self.share() if forecast or self.scored else None}
            if forecast:
                scores["forecasts"] = self.score().numbers(self.electrons)
        more: dict[str, Any] = {"scores": scores}
        if self.scored:
            more |= self.own_curve()
        return {**record, **more}
