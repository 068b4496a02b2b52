"""Planners: how much to explore, and when to be done."""

from __future__ import annotations

import json
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..errors import _invalid
from .endpoint import Endpoint, Unparsable, json_of
from .protocols import Plan, Seen

if TYPE_CHECKING:
    from .episodes import FieldFacts

__all__ = ["LanguageModelPlanner", "ModePlanner", "NoPlanner", "PlannerLimits"]

#: Exploration of each mode, the paper's.
BETAS: Mapping[str, float] = {"SURVEY": 3.0, "INVESTIGATE": 2.0, "CHARACTERIZE": 0.5, "CENSUS": 1.0, "TERMINATE": 1.0}


@dataclass(frozen=True)
class PlannerLimits:
    """Where one mode becomes the next. The defaults are the paper's.

    Attributes:
        survey_coverage: share of the tiles that the survey sees.
        investigate_defects: number of defects that ends the investigation.
        census_dose: share of the budget below which the census begins, whatever the mode.
        terminate_dose: share of the budget below which the episode ends.
    """

    survey_coverage: float = 0.15
    investigate_defects: int = 2
    census_dose: float = 0.20
    terminate_dose: float = 0.05

    def __post_init__(self) -> None:
        for name in ("survey_coverage", "census_dose", "terminate_dose"):
            if not 0 <= getattr(self, name) <= 1:
                raise _invalid(name, f"{name} = {getattr(self, name)}: expected a share from 0 to 1")

    @classmethod
    def rules(cls) -> PlannerLimits:
        """Those of the ablation "rule planner". The paper does not give its own; these are ours: an early, short survey."""
        return cls(survey_coverage=0.01, investigate_defects=10, census_dose=0.40, terminate_dose=0.02)


class NoPlanner:
    """Explores evenly until the budget is spent."""

    def __init__(self, beta: float = 2.0) -> None:
        self._plan = Plan("NONE", beta)

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        pass

    def plan(self, seen: Seen) -> Plan:
        return self._plan


class ModePlanner:
    """The machine of STEMAgent: SURVEY, INVESTIGATE, CHARACTERIZE, CENSUS, TERMINATE.

    It goes on by coverage and defects found, never back; a budget below ``census_dose`` or ``terminate_dose`` comes first.
    """

    def __init__(self, limits: PlannerLimits | None = None) -> None:
        self.limits: PlannerLimits = PlannerLimits() if limits is None else limits

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        self._mode = "SURVEY"

    def plan(self, seen: Seen) -> Plan:
        limits = self.limits
        if self._mode == "SURVEY" and seen.coverage() >= limits.survey_coverage:
            self._mode = "INVESTIGATE"
        if self._mode == "INVESTIGATE" and seen.defects() >= limits.investigate_defects:
            self._mode = "CHARACTERIZE"
        if seen.dose_left < limits.census_dose:
            self._mode = "CENSUS"
        if seen.dose_left < limits.terminate_dose:
            self._mode = "TERMINATE"
        return plan_of(self._mode)


class LanguageModelPlanner:
    """Asks a language model for the mode, and takes that of :class:`ModePlanner` where the reply cannot be read.

    Args:
        endpoint: an OpenAI-compatible service.
        every: asks once for that many acquisitions.
    """

    def __init__(self, endpoint: Endpoint, *, every: int = 5) -> None:
        if every < 1:
            raise _invalid("every", f"every = {every}: expected 1 or more")
        self.endpoint: Endpoint = endpoint
        self.every: int = every
        self._rules = ModePlanner()

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        self._rules.start(field, random)
        self._task = field.task
        self._last: str | None = None
        self._asked = -1
        self.fallbacks: int = 0
        self.calls: int = 0

    def plan(self, seen: Seen) -> Plan:
        rules = self._rules.plan(seen)
        turn = len(seen.tiles) // self.every
        if rules.end:
            return rules
        if turn != self._asked:
            self._asked = turn
            self._last = self._ask(seen)
        return rules if self._last is None else plan_of(self._last)

    def notes(self) -> dict[str, float]:
        """For the record of the episode."""
        return {"planner_calls": self.calls, "planner_fallbacks": self.fallbacks}

    def _ask(self, seen: Seen) -> str | None:
        state = {
            "task": self._task,
            "tiles_seen": len(seen.tiles),
            "coverage": round(seen.coverage(), 4),
            "defects_found": seen.defects(),
            "budget_left": round(seen.dose_left, 4),
            "mode": None if seen.plan is None else seen.plan.mode,
        }
        self.calls += 1
        try:
            return self.endpoint.ask(_INSTRUCTIONS, json.dumps(state), read=_read_mode)
        except Unparsable:
            self.fallbacks += 1
            return None


def plan_of(mode: str) -> Plan:
    return Plan(mode, BETAS[mode], end=mode == "TERMINATE")


def _read_mode(reply: str) -> str:
    mode = json_of(reply).get("mode")
    if not isinstance(mode, str) or mode not in BETAS:
        raise ValueError(f"mode = {reprlib.repr(mode)}: expected one of {', '.join(BETAS)}")
    return mode


_INSTRUCTIONS = """You plan an experiment in a scanning transmission electron microscope. The budget of electrons is limited.
Modes: SURVEY explores the whole field, INVESTIGATE looks for defects, CHARACTERIZE stays where they are, CENSUS counts with what budget is
left, TERMINATE ends the experiment. You get the state as JSON. Reply with one JSON object and nothing else: {"mode": "SURVEY"}"""
