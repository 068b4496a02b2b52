"""The environments by name."""

from __future__ import annotations

import gymnasium as gym

from .episodes import Task

#: Names of the environments, and their tasks.
TASKS: dict[str, Task] = {
    "DefectCensus": "defect-census",
    "PhaseMapping": "phase-mapping",
    "Targeted": "targeted",
    "ParticleCensus": "particle-census",
}


def register() -> None:
    """Registers ``stemworlds/DefectCensus-v0``, ``stemworlds/DefectCensusStrict-v0`` and so on, unless they are there."""
    for name, task in TASKS.items():
        for suffix, strict in (("", False), ("Strict", True)):
            own = f"stemworlds/{name}{suffix}-v0"
            if own not in gym.registry:
                gym.register(
                    own,
                    entry_point="stemworlds.bench.environment:MicroscopeEnv",
                    vector_entry_point="stemworlds.bench.vector:MicroscopeVectorEnv",
                    kwargs={"task": task, "strict": strict},
                )
