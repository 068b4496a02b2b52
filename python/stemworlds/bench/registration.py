"""Registers the environments with Gymnasium."""

from __future__ import annotations

import gymnasium as gym

from .episodes import ONE_FORM, Task

#: Names of the environments, and their tasks.
TASKS: dict[str, Task] = {
    "DefectCensus": "defect-census",
    "PhaseMapping": "phase-mapping",
    "Targeted": "targeted",
    "ParticleCensus": "particle-census",
    "FieldRecall": "field-recall",
    "DensityMap": "density-map",
    "Rare": "rare",
}


def register() -> None:
    """Registers ``stemworlds/DefectCensus-v0``, ``stemworlds/DefectCensusStrict-v0`` and so on, unless they are registered already."""
    for name, task in TASKS.items():
        forms = (("", False),) if task in ONE_FORM else (("", False), ("Strict", True))
        for suffix, strict in forms:
            own = f"stemworlds/{name}{suffix}-v0"
            if own not in gym.registry:
                gym.register(
                    own,
                    entry_point="stemworlds.bench.environment:MicroscopeEnv",
                    vector_entry_point="stemworlds.bench.vector:MicroscopeVectorEnv",
                    kwargs={"task": task, "strict": strict},
                )
