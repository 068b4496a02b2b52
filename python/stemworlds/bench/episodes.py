"""The common part of single and vector environments: options, facts, and steps of the extension."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, cast

import numpy as np
import numpy.typing as npt

from .. import _core
from .._forking import Used
from .._running import Progress, call, running
from ..errors import StemworldsError, _invalid
from ..recipes import Difficulty, Recipe, RecipeLike
from ..worlds import World
from .field_ledger import FieldLedger
from .field_truth import FIELD_TASKS
from .findings import Findings
from .ledger import Ledger
from .strict import ColumnLedger

Task = Literal["defect-census", "phase-mapping", "targeted", "particle-census", "field-recall", "density-map", "rare"]
Exposure = Literal["tier", "physical"]
Noise = Literal["poisson", "stored"]
Reward = Literal["none", "score_gain", "sparse"]
Split = Literal["train", "test"]

#: Tasks whose truth lists columns.
COLUMN_TASKS = ("defect-census", "targeted")
#: Tasks without a strict form.
ONE_FORM = ("density-map", "rare")
#: Keys of a report that only Python reads.
_OWN_KEYS = ("forecasts", "density", "rare")
#: Kinds of actions.
NAVIGATE, ACQUIRE, DECLARE, DONE = range(4)
#: Description of the kinds for messages.
KINDS = "0 goes to a place, 1 acquires, 2 declares, 3 ends the episode"
#: Limits of the zoom of an acquisition.
ZOOM = (1.0, 8.0)
#: Limits of the dose of an acquisition, in units of the reference dose of 100 electrons per square Angstrom.
DOSE = (0.1, 10.0)
#: Edge of an overview pixel, in pixels of the field.
OVERVIEW_FACTOR = 8
#: Edge of the shown part of the overview, in overview pixels.
OVERVIEW_PX = 64


@dataclass(frozen=True)
class FieldFacts:
    """Facts of a field that are known before the first acquisition.

    Attributes:
        name: name of the world.
        material: material of the recipe.
        grid: rows and columns of tiles.
        tile_px: edge of a tile in pixels.
        overlap_px: pixels that neighbouring tiles share.
        pixel_nm: edge of a pixel.
        size_nm: height and width.
        phases: names of the phases; empty if there is one phase.
        task: name of the task.
        target: the type of defect for targeted characterisation; ``None`` for other tasks.
        strict: whether places have to be correct to 0.1 nm.
        budget: dose budget in electrons per square Angstrom.
        horizon: largest number of steps.
    """

    name: str
    material: str
    grid: tuple[int, int]
    tile_px: int
    overlap_px: int
    pixel_nm: float
    size_nm: tuple[float, float]
    phases: tuple[str, ...]
    task: Task
    target: str | None
    strict: bool
    budget: float
    horizon: int
    scale: float
    offset: float

    def centre_of(self, row: int, column: int) -> tuple[float, float]:
        """Returns the centre ``(x, y)`` of a tile in fractions of the field's width and height."""
        stride = self.tile_px - self.overlap_px
        rows, columns = (n * stride + self.overlap_px for n in self.grid)
        return (column * stride + self.tile_px / 2) / columns, (row * stride + self.tile_px / 2) / rows


@dataclass(frozen=True, eq=False)
class Acquired:
    """An acquisition.

    Attributes:
        row, column: row and column of the tile with the nearest centre.
        centre_nm: centre ``(x, y)`` of the acquisition in the field.
        size_nm: edge of the acquired square.
        pixel_nm: edge of a pixel.
        zoom: magnification; the edge of the square is a tile's edge divided by ``zoom``.
        dose: dose in units of the reference dose.
        cost: dose taken from the budget, in electrons per square Angstrom.
        electrons_per_pixel: incident electrons on a pixel.
        scale, offset: fraction of the beam = image * scale + offset.
        image: float32 ``[y, x]``, the array ``tile`` of the observation.
    """

    row: int
    column: int
    centre_nm: tuple[float, float]
    size_nm: float
    pixel_nm: float
    zoom: float
    dose: float
    cost: float
    electrons_per_pixel: float
    scale: float
    offset: float
    image: npt.NDArray[np.float32]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Acquired):
            return NotImplemented
        mine, others = dict(vars(self)), dict(vars(other))
        return np.array_equal(mine.pop("image"), others.pop("image")) and mine == others

    __hash__: ClassVar[None]  # type: ignore[assignment]


def type_of(action: Any) -> Any:
    """Returns the type of an action; for many actions, an array of types."""
    if not isinstance(action, Mapping) or "type" not in action:
        raise _invalid("action", f"action {action!r}: expected a dict with the key type: {KINDS}")
    return action["type"]


def reported(report: Any) -> str:
    """Returns the report of an action in the extension's form."""
    return report.report() if isinstance(report, Findings) else str(report) or "{}"


def _apart(report: str | None, columns: bool) -> tuple[str | None, Findings, str | None]:
    """Splits a report.

    Returns:
        The report for the extension; the findings that only Python scores, with the columns if ``columns`` is true; and the fault of an
        unreadable report, or ``None``.
    """
    keys = (*_OWN_KEYS, "columns") if columns else _OWN_KEYS
    if report is None or not any(f'"{key}"' in report for key in keys):
        return report, Findings(), None
    try:
        found = json.loads(report)
        known = Findings.read(json.dumps({key: found[key] for key in keys if key in found}))
    except (ValueError, TypeError, AttributeError, StemworldsError) as error:
        # This text is no valid report for the extension either, so it counts the report as unreadable.
        return '{"forecasts": []}', Findings(), f"findings: {error}"
    left = {key: value for key, value in found.items() if key not in _OWN_KEYS}
    return json.dumps(left, separators=(",", ":")), known, None


def kinds(given: Sequence[Any]) -> list[int]:
    """Checks the types of actions. Returns them as integers."""
    for kind in given:
        if kind not in range(4):
            raise _invalid("action", f"type {kind!r}: {KINDS}")
    return [int(kind) for kind in given]


@dataclass
class Moves:
    """The next action of each environment."""

    begin: list[tuple[int, int] | None]
    kinds: list[int]
    positions: list[tuple[float, float]]
    zooms: list[float]
    doses: list[float]
    reports: list[str | None]

    @staticmethod
    def none(count: int) -> Moves:
        """Returns actions that end all episodes. The caller overwrites them."""
        return Moves([None] * count, [DONE] * count, [(0.5, 0.5)] * count, [1.0] * count, [1.0] * count, [None] * count)


class Episodes:
    """Episodes of one task in worlds of one kind. :class:`MicroscopeEnv` and :class:`MicroscopeVectorEnv` use them."""

    def __init__(
        self,
        count: int,
        task: Task,
        strict: bool,
        *,
        world: str | os.PathLike[str] | None = None,
        recipe: RecipeLike | None = None,
        difficulty: Difficulty | None = None,
        live: bool = True,
        damage: bool = False,
        split: Split | None = None,
        budget: float = 5000.0,
        horizon: int = 200,
        cadence: int = 5,
        exposure: Exposure = "tier",
        noise: Noise | None = None,
        reward: Reward = "none",
        target: str | None = None,
        overview: bool = True,
        phase_stride_px: int = 8,
        cache: bool | str | os.PathLike[str] = True,
        threads: int | None = None,
        progress: Progress = False,
        **changes: Any,
    ) -> None:
        if (world is None) == (recipe is None):
            raise _invalid("world or recipe", "name either a world file (world=...) or a recipe (recipe=...)")
        if world is not None and (changes or difficulty is not None or damage):
            given = ", ".join([*changes, *(["difficulty"] if difficulty else []), *(["damage"] if damage else [])])
            raise _invalid("world", f"{given}: a world file is as it is; these belong to recipe=...")
        if world is not None and split is not None:
            raise _invalid("split", f"split={split!r}: a world file is one specimen; splits are those of recipe=...")
        if recipe is not None and not live:
            raise _invalid("live", "live=False: worlds of a recipe are made at each reset; build a file and pass world=... instead")
        if strict and task in ONE_FORM:
            raise _invalid("strict", f"strict=True: the task {task} has one form, which asks for seeing")
        self._threads = threads
        self._of_file = world is not None
        self._whole: npt.NDArray[np.float32] | None = None
        self._world_file = None if world is None else os.fspath(world)
        self._recipe = None if recipe is None else Recipe(recipe, difficulty, **changes)
        scene: _core.Scene = {
            "world": self._world_file,
            "toml": None if self._recipe is None else self._recipe.toml,
            "damage": damage,
            "split": split or "train",
            "cache": cache if isinstance(cache, bool) else os.fspath(cache),
        }
        rules: _core.Rules = {
            "task": "defect-census" if task in FIELD_TASKS else task,
            "strict": strict and task not in FIELD_TASKS,
            "target": target,
            "budget": budget,
            "horizon": horizon,
            "cadence": cadence,
            "exposure": exposure,
            "noise": noise,
            "reward": reward,
            "phase_stride_px": phase_stride_px,
            "overview": overview,
        }
        self._core = call(_core.Episodes, scene, rules, count, running(threads, progress))
        self._used = Used("this environment", "make another one in the child")
        self._cadence = cadence
        self._reward = reward
        self._ledgers: dict[int, Ledger] = {}
        told = json.loads(self._core.facts())
        field, settings, asked = told["field"], told["settings"], told["task"]
        rows, columns = (n * (field["tile_px"] - field["overlap_px"]) + field["overlap_px"] for n in field["grid"])
        self.field: FieldFacts = FieldFacts(
            name=field["name"],
            material=field["material"],
            grid=(field["grid"][0], field["grid"][1]),
            tile_px=field["tile_px"],
            overlap_px=field["overlap_px"],
            pixel_nm=field["pixel_nm"],
            size_nm=(rows * field["pixel_nm"], columns * field["pixel_nm"]),
            phases=tuple(field["phases"]),
            task=task if task in FIELD_TASKS else asked["kind"],
            target=asked["target"] or (field["target"] if asked["kind"] == "targeted" else None),
            strict=strict if task in FIELD_TASKS else asked["strict"],
            budget=settings["budget"],
            horizon=settings["horizon"],
            scale=field["scaling"][0],
            offset=field["scaling"][1],
        )
        if task in FIELD_TASKS:
            self._check_field_task()

    def _check_field_task(self) -> None:
        """Checks that the truth of the whole field can be computed.

        Raises:
            InvalidValue: if the world has no recipe, or consists of particles.
        """
        if self.recipe is None:
            raise _invalid("task", f"{self.field.task}: this world has no recipe, so what its whole field holds is not known")
        if self.recipe["structure"] == "particles":
            raise _invalid("task", f"{self.field.task}: it asks for the defects of crystals; worlds of particles have the particle census")

    @property
    def recipe(self) -> Recipe | None:
        """The recipe, for a file the recipe of its build. ``None`` for recorded data and files of other programs."""
        if self._recipe is None and self._world_file is not None:
            with World(self._world_file) as world, contextlib.suppress(StemworldsError):
                self._recipe = world.recipe
        return self._recipe

    def specimen(self, slot: int) -> Recipe | None:
        """Returns the recipe with the seed of an episode's specimen."""
        if self._world_file is not None or self.recipe is None:
            return self.recipe
        # The name of a world from a recipe ends in the seed of its specimen.
        return self.recipe.with_seed(int(self._record(slot)["world"].rpartition(", seed ")[2]))

    def _known_specimen(self, slot: int) -> Recipe:
        found = self.specimen(slot)
        assert found is not None, "the world has a recipe"
        return found

    def step(self, moves: Moves) -> dict[str, Any]:
        """Executes one step of all environments. Returns arrays of observations, and lists of events."""
        texts, known, faults = zip(*(_apart(report, self.field.task in FIELD_TASKS) for report in moves.reports), strict=True)
        asked: Any = {**vars(moves), "reports": list(texts)}
        found: dict[str, Any] = self._used.by(call)(self._core.step, asked, running(self._threads, False))
        for slot, fault in enumerate(faults):
            if fault is not None and found["fault"][slot] is not None:
                found["fault"][slot] = fault
        if self.field.task in (*COLUMN_TASKS, *FIELD_TASKS):
            for slot, kind in enumerate(moves.kinds):
                if moves.begin[slot] is not None:
                    self._ledgers.pop(slot, None)
                else:
                    self._keep(slot, kind, known[slot], found)
        return found

    def _keep(self, slot: int, kind: int, said: Findings, found: dict[str, Any]) -> None:
        """Enters a step into the ledger of a slot. If the ledger computes the score, sets the reward."""
        ledger = self._ledger(slot)
        if ledger is None:
            return
        declared = said if kind == DECLARE and found["fault"][slot] is None else None
        acquired, ended = found["acquired"][slot], found["ended"][slot] is not None
        ledger.took(acquired, declared, ended, found["spent"][slot], self.field.tile_px)
        if ledger.scored and self._reward != "none":
            pays = ended if self._reward == "sparse" else declared is not None or acquired is not None
            found["reward"][slot] = (ledger.share() if self._reward == "sparse" else ledger.gain()) if pays else 0.0

    def _ledger(self, slot: int) -> Ledger | None:
        """Returns the ledger of a slot's episode. ``None`` for tasks that the library scores, and for worlds without a recipe."""
        if self.field.task not in (*COLUMN_TASKS, *FIELD_TASKS):
            return None
        if slot not in self._ledgers:
            if self.recipe is None:
                return None
            self._ledgers[slot] = self._new_ledger(slot)
        return self._ledgers[slot]

    def _new_ledger(self, slot: int) -> Ledger:
        common: dict[str, Any] = {"specimen": lambda: self._known_specimen(slot), "budget": self.field.budget, "cadence": self._cadence}
        if self.field.task in FIELD_TASKS:
            return FieldLedger(**common, scored=True, task=self.field.task, strict=self.field.strict)
        target = self.field.target if self.field.task == "targeted" else None
        return ColumnLedger(**common, scored=self.field.strict, target=target)

    def record(self, slot: int) -> dict[str, Any]:
        """Returns the record of an episode so far."""
        record = self._record(slot)
        ledger = self._ledger(slot)
        return record if ledger is None else ledger.told(record)

    def _record(self, slot: int) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self._used.by(call)(self._core.record, slot, running(self._threads, False)))
        return found

    def score(self, slot: int) -> float:
        """Returns the score of the last declaration."""
        ledger = self._ledger(slot)
        if ledger is not None and ledger.scored:
            return ledger.share()
        score: float = self._used.by(call)(self._core.score, slot, running(self._threads, False))
        return score

    def truth_seen(self, slot: int) -> Findings:
        """Returns the truth of the acquired tiles."""
        truth = Findings.read(self._used.by(call)(self._core.truth_seen, slot, running(self._threads, False)))
        ledger = self._ledger(slot)
        return truth if ledger is None else ledger.truth(truth)

    def overview(self, slot: int, size: int) -> npt.NDArray[np.float32]:
        """Returns the overview, or its central part: ``size`` pixels along each axis."""
        image: npt.NDArray[np.float32] = self._used.by(call)(self._core.overview, slot, size, running(self._threads, False))
        return image

    def whole_overview(self) -> npt.NDArray[np.float32] | None:
        """Returns the overview of a whole file; ``None`` for a recipe, since it would have to be simulated."""
        if self._of_file and self._whole is None:
            rows, columns = (int(n / self.field.pixel_nm + 0.5) // OVERVIEW_FACTOR for n in self.field.size_nm)
            self._whole = self.overview(0, max(rows, columns))[:rows, :columns]
        return self._whole

    def acquired(self, what: Mapping[str, Any], image: npt.NDArray[np.float32]) -> Acquired:
        """Returns an acquisition in the form for agents."""
        pixel = what["size_nm"] / self.field.tile_px
        return Acquired(**what, pixel_nm=pixel, scale=self.field.scale, offset=self.field.offset, image=image.copy())


def observation(found: Mapping[str, Any], slot: int, pixel_nm: float) -> dict[str, npt.NDArray[Any]]:
    """Returns the observation of one environment, in copies of the arrays."""
    names: Sequence[str] = ("tile", "overview", "position", "dose_left", "visited", "step_fraction", "action_mask")
    seen = {name: found[name][slot].copy() for name in names}
    seen["pixel_size_nm"] = np.array([pixel_nm], dtype=np.float32)
    return seen
