"""Writes trained networks as ONNX files, with a card that describes them."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from ..bench.network_format import INPUTS, KEY, OUTPUTS, Card
from .contents import Contents
from .needed import onnx
from .network import CONDITIONS, Network
from .saving import write_whole


class _AsUsed(nn.Module):
    """A network with probabilities instead of scores as outputs."""

    def __init__(self, network: Network) -> None:
        super().__init__()
        self.network = network

    def forward(self, counts: Tensor, conditions: Tensor) -> tuple[Tensor, ...]:
        seen = self.network(counts, conditions)
        kinds, phases = torch.softmax(seen.kind, dim=1), torch.softmax(seen.phase, dim=1)
        return torch.sigmoid(seen.heat), seen.offset, kinds, seen.toward, torch.exp(seen.log_sharpness), phases, torch.sigmoid(seen.particle)


def write_network(path: Path, network: Network, contents: Contents, size: int, about: Mapping[str, Any]) -> None:
    """Writes a network as ONNX, for any number of tiles with ``size`` pixels along an edge."""
    example = (torch.ones(2, 1, size, size), torch.ones(2, CONDITIONS))
    used = _AsUsed(network).cpu().eval()
    tiles = torch.export.Dim("tiles")
    with _quiet():
        program = torch.onnx.export(
            used,
            example,
            dynamo=True,
            input_names=list(INPUTS),
            output_names=list(OUTPUTS),
            dynamic_shapes=({0: tiles}, {0: tiles}),
            optimize=True,
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    card = Card(kinds=contents.kinds, usual=contents.usual.tolist(), size_px=size, about=dict(about))
    del model.metadata_props[:]
    entry = model.metadata_props.add()
    entry.key, entry.value = KEY, json.dumps(card.table())
    for node in model.graph.node:
        # Each node contains paths of the exporting machine, which are removed.
        del node.metadata_props[:]
        node.doc_string = ""
    onnx().checker.check_model(model)
    write_whole(path, model.SerializeToString())


@contextlib.contextmanager
def _quiet() -> Any:
    """Suppresses the messages of the exporter."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)
