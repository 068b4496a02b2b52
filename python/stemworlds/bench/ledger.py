"""Scores an episode in Python: records the seen areas, the last declaration, and the score as a function of dose."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from .. import _core
from ..recipes import Recipe
from .findings import Findings
from .statistics import CHECKPOINTS


@dataclass(eq=False)
class Ledger:
    """Records the steps of one episode. Derived classes define :meth:`share`, :meth:`told` and :meth:`truth`.

    Attributes:
        specimen: returns the recipe with the seed of the episode's specimen. Damage during the episode is not included.
        budget, cadence: dose budget of the episode, and number of acquisitions from one recorded score to the next.
        scored: whether the ledger records the curve and sets rewards.
    """

    specimen: Callable[[], Recipe]
    budget: float
    cadence: int
    scored: bool
    findings: Findings | None = None
    curve: list[list[float]] = field(default_factory=list)
    electrons: float = 0.0
    _spent: float = 0.0
    _paid: float = 0.0
    _acquired: int = 0
    _due: bool = False
    #: Left, upper, right and lower edge of each acquisition, in nm.
    _views: list[tuple[float, float, float, float]] = field(default_factory=list)

    def took(self, acquired: Mapping[str, Any] | None, declared: Findings | None, ended: bool, spent: float, tile_px: int) -> None:
        """Records one step. As in the other tasks, a due score is recorded before the next acquisition."""
        if acquired is not None:
            if self._due:
                self._note()
            (x, y), half = acquired["centre_nm"], acquired["size_nm"] / 2
            self._views.append((x - half, y - half, x + half, y + half))
            self.electrons += acquired["electrons_per_pixel"] * tile_px**2
            self._acquired += 1
            self._due = self._acquired % self.cadence == 0
        if declared is not None:
            self.findings = declared
        self._spent = spent
        if ended:
            self._note()

    def _note(self) -> None:
        self._due = False
        if self.scored and self.findings is not None:
            self.curve.append([min(self._spent / self.budget, 1.0), self.share()])

    def share(self) -> float:
        """Returns the score of the last declaration."""
        raise NotImplementedError

    def told(self, record: dict[str, Any]) -> dict[str, Any]:
        """Adds the ledger's scores to the record of the episode."""
        raise NotImplementedError

    def truth(self, seen: Findings) -> Findings:
        """Adds the truth of the task to ``seen``, which contains the library's truth of the acquired tiles."""
        raise NotImplementedError

    def gain(self) -> float:
        """Returns the change of the score since the last call."""
        score = self.share()
        gained, self._paid = score - self._paid, score
        return gained

    def own_curve(self) -> dict[str, Any]:
        """Returns the curve and its metrics for the record."""
        return {"curve": self.curve, "metrics": json.loads(_core.dose_metrics([(a, b) for a, b in self.curve], CHECKPOINTS))}
