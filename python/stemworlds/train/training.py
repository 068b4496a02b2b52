"""Trains the members of an ensemble on a stream, with checkpoints from which a training continues."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from .. import _core
from ..errors import FileMissing, StemworldsError, _invalid
from .config import Config
from .contents import processors
from .exporting import write_network
from .losses import WEIGHTS
from .network import Network
from .optimising import Ensemble, rate_at
from .progress import Progress
from .recording import Recorder
from .saving import Log, read_checkpoint, write_checkpoint
from .tiles import Batch, TileBatches

__all__ = ["TrainingSummary", "export", "train"]

CHECKPOINT, LOG = "checkpoint.pt", "log.jsonl"


@dataclass(frozen=True)
class TrainingSummary:
    """Summary of a call of :func:`train`.

    Attributes:
        networks: files of the members, in the order of their numbers; empty after an interruption.
        steps: number of finished steps, and total number of steps.
        before: number of steps that were finished before the call.
        seconds: duration of the call.
        losses: means of the last lines of the log, by part.
        interrupted: whether Ctrl-C or ``until`` ended the call. An identical call continues the training.
    """

    networks: tuple[str, ...]
    steps: tuple[int, int]
    before: int
    seconds: float
    losses: dict[str, float]
    interrupted: bool


class _Numbered(Dataset[dict[str, Tensor]]):
    """Batches as a dataset, numbered from ``first``."""

    def __init__(self, tiles: TileBatches, first: int, count: int) -> None:
        self._tiles, self._first, self._count = tiles, first, count

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> dict[str, Tensor]:
        if index >= self._count:
            raise IndexError(index)
        return _tensors(self._tiles[self._first + index])


def _tensors(batch: Batch) -> dict[str, Tensor]:
    return {name: torch.from_numpy(np.ascontiguousarray(values)) for name, values in batch.items()}


def train(
    config: Config,
    out: str | os.PathLike[str],
    *,
    progress: Callable[[str], object] | None = None,
    until: float | None = None,
    tiles: TileBatches | None = None,
) -> TrainingSummary:
    """Trains the networks of a config in a folder. Writes ``checkpoint.pt``, ``log.jsonl``, and at the end ``member-0.onnx`` ...

    A config determines the networks, on CPUs to the last bit, also after interruptions. If the folder contains a checkpoint of this config,
    the training continues from it.

    Args:
        config: a config from :func:`read_config`.
        out: the folder. It is created if it does not exist.
        progress: function that receives lines of progress; by default they are printed on standard error.
        until: seconds after which the training stops with a checkpoint, as after Ctrl-C.
        tiles: batches of this config, if they exist already.

    Raises:
        InvalidValue: if the folder contains a checkpoint of another config.
        StemworldsError: if losses become infinite or NaN.
    """
    began = time.monotonic()
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    device = _device(config.run.device)
    shown = Progress(config.optimiser.steps, progress)
    if tiles is None:
        shown.note("laying out specimens")
        tiles = TileBatches(config)
    contents = tiles.contents
    held = {
        "log_chances": torch.from_numpy(contents.log_chances).to(device),
        "kind": torch.from_numpy(contents.kind_of_row).to(device),
        "possible": torch.from_numpy(contents.possible).to(device),
        "phases": torch.from_numpy(tiles.phases).to(device),
    }
    found = read_checkpoint(folder / CHECKPOINT, config, device)
    processes = _processes(config)
    first = 0 if found is None else found[0]
    if processes:
        tiles.prepare(first // config.stream.repeats)
    batches = _batches(config, tiles, first, processes, device)
    ensemble = Ensemble(
        _maker(config, tiles),
        config.optimiser,
        held,
        device,
        config.run.graph,
        shown.note,
    )
    if found is not None:
        ensemble.restore(found[1])
        shown.note(f"{first} steps are done already")
    recorder = Recorder(config.stream, torch.from_numpy(tiles.facts).to(device), config.optimiser.seed)
    run = _Run(config, folder, ensemble, recorder, shown, first)
    interrupted = run.all(batches, None if until is None else began + until)
    networks: list[str] = []
    if not interrupted:
        networks = _exported(config, folder, ensemble.averaged, tiles)
    shown.close()
    return TrainingSummary(
        tuple(networks), (run.done, config.optimiser.steps), first, time.monotonic() - began, run.latest, interrupted
    )


class _Run:
    """Executes the steps of one call."""

    def __init__(self, config: Config, folder: Path, ensemble: Ensemble, recorder: Recorder, shown: Progress, first: int) -> None:
        self._config, self._folder, self._ensemble, self._recorder, self._shown = config, folder, ensemble, recorder, shown
        self.done = self._saved = first
        self._log = Log(folder / LOG, first)
        self._sums: Tensor | None = None
        self._summed = 0
        self.latest: dict[str, float] = {}
        self._began = time.monotonic()

    def all(self, batches: Iterator[dict[str, Tensor]], end: float | None) -> bool:
        """Executes the remaining steps. Returns whether they were interrupted."""
        steps, every = self._config.optimiser.steps, self._config.run.checkpoint_every
        try:
            while self.done < steps:
                self._step(next(batches))
                if self.done % every == 0 or self.done == steps:
                    self._save()
                if end is not None and time.monotonic() > end and self.done < steps:
                    self._save()
                    return True
        except KeyboardInterrupt:
            self._save()
            return True
        finally:
            self._log.close()
        return False

    def _step(self, tiles: dict[str, Tensor]) -> None:
        step = self.done
        said = self._ensemble.step(self._recorder(tiles, step), step)
        self._sums = said if self._sums is None else self._sums + said
        self._summed += 1
        self.done = step + 1
        if self.done % self._config.run.log_every == 0 or self.done == self._config.optimiser.steps:
            self._write(step)

    def _write(self, step: int) -> None:
        assert self._sums is not None
        means = (self._sums / self._summed).tolist()
        self._sums, self._summed = None, 0
        if not np.isfinite(means).all():
            raise StemworldsError(
                f"the loss is no number after {self.done} steps; a smaller rate of [optimiser] may mend it. "
                f"{self._folder / CHECKPOINT} holds step {self._saved}: move it away to begin anew"
            )
        self.latest = {name: float(np.mean([member[n] for member in means])) for n, name in enumerate(WEIGHTS)}
        self._log.row(
            step=self.done,
            seconds=round(time.monotonic() - self._began, 3),
            rate=rate_at(self._config.optimiser, step),
            tiles=self.done * self._config.optimiser.batch,
            losses=self.latest,
            members=[{name: member[n] for n, name in enumerate(WEIGHTS)} for member in means],
        )
        self._shown.step(self.done, self.latest)

    def _save(self) -> None:
        if self.done != self._saved:
            write_checkpoint(self._folder / CHECKPOINT, self._config, self.done, self._ensemble.state())
            self._saved = self.done


def _batches(config: Config, tiles: TileBatches, first: int, processes: int, device: torch.device) -> Iterator[dict[str, Tensor]]:
    """Yields the tiles of each step from ``first`` on, on the device."""
    repeats, steps = config.stream.repeats, config.optimiser.steps
    number = first // repeats
    count = -(-steps // repeats) - number
    gpu = device.type == "cuda"
    loader: Any = DataLoader(
        _Numbered(tiles, number, count),
        batch_size=None,
        num_workers=processes,
        pin_memory=gpu and processes > 0,
        prefetch_factor=2 if processes else None,
        multiprocessing_context="fork" if processes else None,
    )
    used = first % repeats
    iterator = iter(loader)

    def each() -> Iterator[dict[str, Tensor]]:
        nonlocal used
        for batch in iterator:
            there = {name: values.to(device, non_blocking=True) for name, values in batch.items()}
            for _ in range(used, repeats):
                yield there
            used = 0

    return each()


def export(config: Config, out: str | os.PathLike[str], tiles: TileBatches | None = None) -> list[str]:
    """Writes the networks of a training's last checkpoint, before its end. Returns the files.

    Raises:
        FileMissing: if there is no checkpoint.
    """
    folder = Path(out)
    found = read_checkpoint(folder / CHECKPOINT, config, torch.device("cpu"))
    if found is None:
        raise FileMissing(f"{folder / CHECKPOINT}: there is no checkpoint")
    tiles = TileBatches(config) if tiles is None else tiles
    networks = []
    for values in found[1]["averaged"]:
        network = _maker(config, tiles)()
        network.load_state_dict(values)
        networks.append(network)
    return _exported(config, folder, networks, tiles)


def _maker(config: Config, tiles: TileBatches) -> Callable[[], Network]:
    """Returns a function that makes networks for the kinds, phases and types of defects of the tiles."""
    contents = tiles.contents
    return lambda: Network(config.network, len(contents.kinds), int(tiles.phases.max()), contents.log_chances.shape[1])


def _exported(config: Config, folder: Path, networks: Sequence[Network], tiles: TileBatches) -> list[str]:
    """Writes networks, and replaces existing files. Returns the files."""
    written = []
    for member, network in enumerate(networks):
        path = folder / f"member-{member}.onnx"
        about = {"config": config.essence(), "member": member, "program": _core.__version__, "torch": str(torch.__version__)}
        write_network(path, network, tiles.contents, config.stream.size, about)
        written.append(str(path))
    return written


def _device(name: str) -> torch.device:
    there = torch.cuda.is_available()
    if name == "cuda" and not there:
        raise _invalid("config", "device = 'cuda': PyTorch finds no GPU here; device = 'auto' takes what there is")
    return torch.device("cuda" if there and name != "cpu" else "cpu")


def _processes(config: Config) -> int:
    wanted = config.run.processes
    if sys.platform == "win32":
        return 0
    return max(processors() - 1, 1) if wanted < 0 else wanted
