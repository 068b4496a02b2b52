"""Planners choose the amount of exploration, and the end of an episode."""

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

#: The STEMGym paper's exploration parameter of each mode.
BETAS: Mapping[str, float] = {"SURVEY": 3.0, "INVESTIGATE": 2.0, "CHARACTERIZE": 0.5, "CENSUS": 1.0, "TERMINATE": 1.0}


@dataclass(frozen=True)
class PlannerLimits:
    """Limits at which the mode changes. The defaults are the paper's.

    Attributes:
        survey_coverage: share of acquired tiles that ends the survey.
        investigate_defects: number of defects that ends the investigation.
        census_dose: remaining share of the budget below which the census begins, in any mode.
        terminate_dose: remaining share of the budget below which the episode ends.
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
        """Returns the limits of the ablation "rule planner": an early, short survey. The paper does not list its limits; these are our
        choice."""
        return cls(survey_coverage=0.01, investigate_defects=10, census_dose=0.40, terminate_dose=0.02)


class NoPlanner:
    """Explores with a constant parameter until the budget is spent."""

    def __init__(self, beta: float = 2.0) -> None:
        self._plan = Plan("NONE", beta)

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        pass

    def plan(self, seen: Seen) -> Plan:
        return self._plan


class ModePlanner:
    """The state machine of STEMAgent: SURVEY, INVESTIGATE, CHARACTERIZE, CENSUS, TERMINATE.

    Coverage and the number of found defects advance the mode; it never returns to an earlier one. A budget below ``census_dose`` or
    ``terminate_dose`` takes precedence.
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
    """Asks a language model for the mode. If the reply cannot be read, it uses the mode of :class:`ModePlanner`.

    Args:
        endpoint: an OpenAI-compatible service.
        every: number of acquisitions from one question to the next.
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
        """Returns numbers for the record of the episode."""
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
