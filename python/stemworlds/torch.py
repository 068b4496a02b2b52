"""Makes samples for PyTorch, which has to be installed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

try:
    import torch
except ModuleNotFoundError as _missing:
    raise ModuleNotFoundError("stemworlds.torch needs PyTorch: pip install torch", name=_missing.name) from None

from torch.utils.data import IterableDataset, get_worker_info

from .streaming import Sample, Stream


class TileDataset(IterableDataset[dict[str, Any]]):
    """A stream as a dataset. Each worker of a ``DataLoader`` makes different samples.

    Worker ``w`` of ``n`` yields the samples ``first + w``, ``first + w + n`` ... The set of samples therefore does not depend on the number
    of workers. Items are dicts of tensors: ``image`` and ``clean`` float32 ``[1, y, x]``, ``heat_map`` float32 ``[1, y, x]``,
    ``class_mask`` and ``phase_mask`` int64 ``[y, x]``, ``index``, ``dose``, ``pixel_nm``.

    Args:
        stream: a stream from :func:`stemworlds.stream`. With workers, ``threads=1`` is fastest, since each worker is a process.
        count: number of samples, summed over all workers; endless by default.
        first: number of the first sample.
    """

    def __init__(self, stream: Stream, *, count: int | None = None, first: int = 0) -> None:
        super().__init__()
        self.stream = stream
        self.count = count
        self.first = first

    def __iter__(self) -> Iterator[dict[str, Any]]:
        info = get_worker_info()
        worker, workers = (0, 1) if info is None else (info.id, info.num_workers)
        count = None if self.count is None else len(range(worker, self.count, workers))
        return map(_tensors, self.stream.iterate(self.first + worker, workers, count))


def _tensors(sample: Sample) -> dict[str, Any]:
    targets = sample.targets
    return {
        "image": torch.from_numpy(sample.image[np.newaxis]),
        "clean": torch.from_numpy(sample.clean[np.newaxis]),
        "heat_map": torch.from_numpy(targets.heat_map[np.newaxis]),
        "class_mask": torch.from_numpy(targets.class_mask.astype(np.int64)),
        "phase_mask": torch.from_numpy(targets.phase_mask.astype(np.int64)),
        "index": sample.index,
        "dose": sample.dose,
        "pixel_nm": sample.pixel_nm,
    }
