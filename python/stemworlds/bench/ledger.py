"""What an episode is scored by in Python: the parts that were seen, the last declaration, and the curve of the score over the dose."""

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
    """Follows the steps of one episode. Kinds of ledgers have :meth:`share` and :meth:`told`.

    Attributes:
        specimen: gives the recipe with the seed of the episode's specimen. Its defects are those at the start of the episode.
        budget, cadence: of the episode.
        scored: whether the curve is kept and rewards are paid.
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
    #: Left, upper, right and lower edge of each acquisition in nm.
    _views: list[tuple[float, float, float, float]] = field(default_factory=list)

    def took(self, acquired: Mapping[str, Any] | None, declared: Findings | None, ended: bool, spent: float, tile_px: int) -> None:
        """Follows one step. The record that is due is made before more dose is spent, as of the other tasks."""
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
        """The score of what was declared last."""
        raise NotImplementedError

    def told(self, record: dict[str, Any]) -> dict[str, Any]:
        """The record of the episode with what the ledger knows."""
        raise NotImplementedError

    def truth(self, seen: Findings) -> Findings:
        """The truth of what was seen, as the task asks for it; ``seen`` holds what the library knows of it."""
        raise NotImplementedError

    def gain(self) -> float:
        """The change of the score since the last call."""
        score = self.share()
        gained, self._paid = score - self._paid, score
        return gained

    def own_curve(self) -> dict[str, Any]:
        """The curve, and its areas, for the record."""
        return {"curve": self.curve, "metrics": json.loads(_core.dose_metrics([(a, b) for a, b in self.curve], CHECKPOINTS))}
