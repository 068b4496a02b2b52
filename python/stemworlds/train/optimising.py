"""Executes the steps of an ensemble: losses, gradients, AdamW, averaged weights."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor, nn

from .config import OptimiserTable
from .losses import WEIGHTS, losses
from .network import Network

#: Number of steps before a step is recorded on a GPU. Memory is then allocated, and algorithms are chosen.
_WARM_STEPS = 4


def rate_at(table: OptimiserTable, step: int) -> float:
    """Returns the learning rate of a step. It rises linearly, then falls as half a cosine to 0."""
    rising = max(round(table.warm_up * table.steps), 1)
    if step < rising:
        return table.rate * (step + 1) / rising
    return table.rate * 0.5 * (1 + math.cos(math.pi * (step - rising) / max(table.steps - rising, 1)))


def kept_at(table: OptimiserTable, step: int) -> float:
    """Returns the share of the averaged weights that is kept in a step.

    It is smaller in the first steps, so that the random initial weights disappear from the average.
    """
    return min(table.average, (1 + step) / (10 + step))


class Ensemble:
    """Networks that are trained together on the same batches.

    Args:
        make: function that makes a network with random weights.
        table: settings of the optimiser.
        contents: tensors by name, see :func:`losses`.
        device: device of all tensors.
        graph: record a step on the GPU once, and replay it.
        say: function that receives a message if a step could not be recorded.
    """

    def __init__(
        self,
        make: Callable[[], Network],
        table: OptimiserTable,
        contents: Mapping[str, Tensor],
        device: torch.device,
        graph: bool,
        say: Callable[[str], object],
    ) -> None:
        self._table, self._contents, self._device, self._say = table, contents, device, say
        self.networks: list[Network] = []
        for member in range(table.members):
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(table.seed * 1_000_003 + member)
                self.networks.append(make().to(device))
        self.averaged: list[Network] = [copy.deepcopy(network).requires_grad_(False) for network in self.networks]
        on_gpu = device.type == "cuda"
        # These numbers are tensors, so that a recorded step reads their present values.
        self._rate = torch.tensor(0.0, device=device)
        self._moving = torch.tensor(0.0, device=device)
        self.optimisers = [
            torch.optim.AdamW(
                network.parameters(),
                lr=self._rate if on_gpu else table.rate,
                weight_decay=table.weight_decay,
                capturable=on_gpu,
                foreach=True,
            )
            for network in self.networks
        ]
        self._weights = torch.tensor(list(WEIGHTS.values()), device=device)
        self._graph: Any = None
        self._recording = graph and on_gpu
        self._steps_here = 0
        self._held: dict[str, Tensor] = {}
        self._out: Tensor | None = None

    def step(self, batch: Mapping[str, Tensor], step: int) -> Tensor:
        """Executes one step. Returns the losses ``[member, part]`` in the order of :data:`WEIGHTS`, without waiting for the GPU."""
        rate = rate_at(self._table, step)
        self._rate.fill_(rate)
        self._moving.fill_(1 - kept_at(self._table, step))
        if self._device.type != "cuda":
            for optimiser in self.optimisers:
                for group in optimiser.param_groups:
                    group["lr"] = rate
        if not self._recording:
            return self._one(batch)
        if self._graph is None:
            self._steps_here += 1
            if self._steps_here <= _WARM_STEPS:
                return self._warm(batch)
            self._record(batch)
            if self._graph is None:
                return self._one(batch)
        for name, held in self._held.items():
            held.copy_(batch[name])
        self._graph.replay()
        assert self._out is not None
        return self._out.clone()

    def _one(self, batch: Mapping[str, Tensor]) -> Tensor:
        said = []
        for network, optimiser, averaged in zip(self.networks, self.optimisers, self.averaged, strict=True):
            optimiser.zero_grad(set_to_none=True)
            parts = losses(network(batch["counts"], batch["conditions"]), batch, self._contents)
            stacked = torch.stack([parts[name] for name in WEIGHTS])
            torch.dot(stacked, self._weights).backward()
            nn.utils.clip_grad_norm_(network.parameters(), self._table.clip, foreach=True)
            optimiser.step()
            with torch.no_grad():
                # PyTorch declares fewer types here than it takes.
                own: Any = list(averaged.parameters())
                apart: Any = torch._foreach_sub(list(network.parameters()), own)
                torch._foreach_mul_(apart, self._moving)
                torch._foreach_add_(own, apart)
            said.append(stacked.detach())
        return torch.stack(said)

    def _warm(self, batch: Mapping[str, Tensor]) -> Tensor:
        """Executes a step on another stream, which CUDA requires before recording."""
        aside, here = torch.cuda.Stream(), torch.cuda.current_stream()
        aside.wait_stream(here)
        with torch.cuda.stream(aside):
            out = self._one(batch)
        here.wait_stream(aside)
        return out

    def _record(self, batch: Mapping[str, Tensor]) -> None:
        """Records a step without executing it. If recording fails, later steps are executed without it."""
        self._held = {name: value.clone() for name, value in batch.items()}
        torch.cuda.synchronize()
        graph = torch.cuda.CUDAGraph()
        try:
            with torch.cuda.graph(graph):
                self._out = self._one(self._held)
        except RuntimeError as error:
            self._recording = False
            self._say(f"a step cannot be recorded on this GPU, so each is launched by itself: {error}")
            return
        self._graph = graph

    def state(self) -> dict[str, Any]:
        """Returns the state on which later steps depend."""
        return {
            "networks": [network.state_dict() for network in self.networks],
            "averaged": [network.state_dict() for network in self.averaged],
            "optimisers": [optimiser.state_dict() for optimiser in self.optimisers],
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restores a state from :meth:`state`."""
        for name, held in (("networks", self.networks), ("averaged", self.averaged)):
            for network, values in zip(held, state[name], strict=True):
                network.load_state_dict(values)
        for optimiser, values in zip(self.optimisers, state["optimisers"], strict=True):
            optimiser.load_state_dict(values)
            if self._device.type == "cuda":
                for group in optimiser.param_groups:
                    group["lr"] = self._rate
