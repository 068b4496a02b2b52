"""The benchmark: an agent acquires tiles of a world under a dose budget, and is scored by its findings.

Importing it registers the environments with Gymnasium:

    >>> import gymnasium as gym, stemworlds.bench
    >>> env = gym.make("stemworlds/DefectCensus-v0", recipe="srtio3", difficulty="easy")   # doctest: +SKIP

An agent plays episodes. An experiment is a list of episodes:

    >>> from stemworlds.bench import make_agent, play
    >>> record = play(env, make_agent("GP-UCB"), seed=0)                                   # doctest: +SKIP

The environments need ``pip install 'stemworlds[bench]'``, the agents ``'stemworlds[agents]'``. Other packages are imported at their first
use.
"""

try:
    import gymnasium as _gymnasium  # noqa: F401
except ModuleNotFoundError as _missing:
    raise ModuleNotFoundError("stemworlds.bench needs Gymnasium: pip install 'stemworlds[bench]'", name=_missing.name) from None

from .agents import Agent, CompressedSensing, Plays, play
from .analysts import Heuristic, Nothing, Oracle, TileByTile
from .blind import Usual
from .catalogue import agent_names, agent_specification, make_agent
from .endpoint import Endpoint, EndpointError, Unparsable
from .environment import MicroscopeEnv
from .episodes import ACQUIRE, DECLARE, DONE, NAVIGATE, Acquired, FieldFacts
from .experiments import Episode, Experiment, packaged_experiments, read_experiment
from .field_navigators import ByCounts, ByPrior, ByTruth
from .findings import NO_PHASE, Findings
from .forecasts import ForecastScore, score_forecasts
from .ideal import Ideal
from .navigators import GaussianProcess, RandomMask, RandomTiles, Raster
from .networks import packaged_networks
from .neural import NeuralAnalyst
from .onnx import OnnxAnalyst
from .planners import LanguageModelPlanner, ModePlanner, NoPlanner, PlannerLimits
from .protocols import Analyst, Look, Navigator, Plan, Planner, Seen
from .registration import TASKS, register
from .report import leaderboard, write_report
from .results import ResultFile, read_failures, read_results
from .rl import PolicyAgent, train_policy
from .runner import RunSummary, run_experiment
from .statistics import Equivalence, bootstrap_interval, dec_auc, on_checkpoints, paired_wilcoxon, rank_agreement, tost
from .vector import MicroscopeVectorEnv
from .vlm import VisionLanguageAnalyst
from .wrappers import ByteImages, DiscreteGrid, GridChoice, TargetBox

__all__ = [
    "ACQUIRE",
    "DECLARE",
    "DONE",
    "NAVIGATE",
    "NO_PHASE",
    "TASKS",
    "Acquired",
    "Agent",
    "Analyst",
    "ByCounts",
    "ByPrior",
    "ByTruth",
    "ByteImages",
    "CompressedSensing",
    "DiscreteGrid",
    "Endpoint",
    "EndpointError",
    "Episode",
    "Equivalence",
    "Experiment",
    "FieldFacts",
    "Findings",
    "ForecastScore",
    "GaussianProcess",
    "GridChoice",
    "Heuristic",
    "Ideal",
    "LanguageModelPlanner",
    "Look",
    "MicroscopeEnv",
    "MicroscopeVectorEnv",
    "ModePlanner",
    "Navigator",
    "NeuralAnalyst",
    "NoPlanner",
    "Nothing",
    "OnnxAnalyst",
    "Oracle",
    "Plan",
    "Planner",
    "PlannerLimits",
    "Plays",
    "PolicyAgent",
    "RandomMask",
    "RandomTiles",
    "Raster",
    "ResultFile",
    "RunSummary",
    "Seen",
    "TargetBox",
    "TileByTile",
    "Unparsable",
    "Usual",
    "VisionLanguageAnalyst",
    "agent_names",
    "agent_specification",
    "bootstrap_interval",
    "dec_auc",
    "leaderboard",
    "make_agent",
    "on_checkpoints",
    "packaged_experiments",
    "packaged_networks",
    "paired_wilcoxon",
    "play",
    "rank_agreement",
    "read_experiment",
    "read_failures",
    "read_results",
    "register",
    "run_experiment",
    "score_forecasts",
    "tost",
    "train_policy",
    "write_report",
]

register()
