"""The benchmark: act in a world under a dose budget, and be scored by what was found for it.

Importing it registers the environments with Gymnasium:

    >>> import gymnasium as gym, stemworlds.bench
    >>> env = gym.make("stemworlds/DefectCensus-v0", recipe="srtio3", difficulty="easy")   # doctest: +SKIP
"""

from .environment import MicroscopeEnv
from .episodes import ACQUIRE, DECLARE, DONE, NAVIGATE, Acquired, FieldFacts
from .findings import NO_PHASE, Findings
from .registration import TASKS, register
from .vector import MicroscopeVectorEnv
from .wrappers import ByteImages, DiscreteGrid, GridChoice, TargetBox

__all__ = [
    "ACQUIRE",
    "DECLARE",
    "DONE",
    "NAVIGATE",
    "NO_PHASE",
    "TASKS",
    "Acquired",
    "ByteImages",
    "DiscreteGrid",
    "FieldFacts",
    "Findings",
    "GridChoice",
    "MicroscopeEnv",
    "MicroscopeVectorEnv",
    "TargetBox",
    "register",
]

register()
