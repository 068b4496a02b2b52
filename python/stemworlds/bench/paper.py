"""Numbers of the STEMGym paper, for comparison. Its worlds differ from ours, so the numbers are no targets."""

from __future__ import annotations

from typing import NamedTuple


class Told(NamedTuple):
    """The paper's result for an agent in a task: mean and deviation of DEC-AUC."""

    mean: float
    deviation: float


_TASKS = ("defect-census", "phase-mapping", "targeted", "particle-census")
_MAIN: dict[str, tuple[tuple[float, float] | None, ...]] = {
    "Random": ((0.028, 0.027), (0, 0), (0, 0), (0.553, 0.353)),
    "Raster": ((0.052, 0.038), (0, 0), (0, 0), (0.908, 0)),
    "GP-UCB": ((0.034, 0.037), (0, 0), (0, 0), (0.562, 0.375)),
    "PF GP-BO": ((0.013, 0.006), (0.363, 0), (0, 0), None),
    "Raster+Analyst": ((0.287, 0.129), (0.168, 0.023), (0.112, 0.033), (0, 0)),
    "GP-UCB+Analyst": ((0.283, 0.122), (0.184, 0.051), (0.127, 0.089), (0, 0)),
    "STEMAgent": ((0.278, 0.120), (0.185, 0.033), (0.134, 0.085), (0, 0)),
    "PF GP-BO+Analyst": ((0.163, 0.030), (0.128, 0.125), (0.348, 0.048), None),
    "CS-20": ((0.175, 0.055), (0.305, 0.185), None, None),
    "DQN": ((0.112, 0.089), (0, 0), (0, 0), (0.481, 0.388)),
    "DQN+Analyst": ((0.121, 0.089), (0.149, 0.081), (0.205, 0.150), (0, 0)),
    "PPO": ((0.002, 0.001), (0, 0), (0, 0), (0.010, 0)),
    "PPO+Analyst": ((0.001, 0.002), (0, 0), (0.009, 0.002), (0, 0)),
    "SAC": ((0.041, 0.049), (0, 0), (0, 0), (0.690, 0.378)),
    "SAC+Analyst": ((0.259, 0.139), (0.184, 0.027), (0.120, 0.096), (0, 0)),
}
#: Agents with a trained analyst in the paper.
TRAINED = frozenset({"STEMAgent", "CS-20", *(name for name in _MAIN if name.endswith("+Analyst"))})

#: Spearman's rho between DEC-AUC and other metrics, by task.
AGREEMENT: dict[str, dict[str, float]] = {
    "final_score": dict(zip(_TASKS, (0.880, 0.900, 0.931, 0.917), strict=True)),
    "time_to_threshold": dict(zip(_TASKS, (0.097, 0.861, 0.641, 0.829), strict=True)),
    "early_weighted": dict(zip(_TASKS, (0.994, 0.973, 0.977, 0.872), strict=True)),
    "late_weighted": dict(zip(_TASKS, (0.994, 0.994, 0.998, 0.986), strict=True)),
    "half_budget": dict(zip(_TASKS, (0.984, 0.961, 0.974, 0.854), strict=True)),
}
#: Median milliseconds per acquired tile.
LATENCY_MS: dict[str, float] = {
    "Random": 1691.3,
    "Raster": 3179.6,
    "GP-UCB": 3336.2,
    "Raster+Analyst": 3505.4,
    "GP-UCB+Analyst": 3420.9,
    "STEMAgent": 2222.8,
    "STEMAgent without planner": 2369.9,
    "STEMAgent rule planner": 2659.7,
    "PF GP-BO": 763.9,
    "PF GP-BO+Analyst": 804.3,
    "DQN": 14631.1,
    "DQN+Analyst": 15412.1,
    "PPO": 69943.5,
    "PPO+Analyst": 71742.0,
    "SAC": 3021.6,
}
#: Largest difference of DEC-AUC between two numbers of checkpoints.
DISCRETISATION = {(20, 50): 0.0161, (50, 100): 0.0001}


def told(agent: str, task: str) -> Told | None:
    """Returns the paper's result for an agent in a task, at a budget of 5000 electrons per square Angstrom; ``None`` if it has none."""
    numbers = _MAIN.get(agent)
    if numbers is None or task not in _TASKS:
        return None
    pair = numbers[_TASKS.index(task)]
    return None if pair is None else Told(*pair)
