"""Computes the losses of a network for a batch of tiles."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor
from torch.nn import functional

from .network import Seen

#: Weights of the parts. Numbers of defects have the largest weight: they are the aim, and have the weakest gradient in a step.
WEIGHTS = {"heat": 1.0, "offset": 1.0, "kind": 0.3, "defects": 4.0, "phase": 0.3, "particle": 0.3}


def losses(seen: Seen, batch: Mapping[str, Tensor], contents: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Returns the parts of the loss, each a mean.

    ``defects`` is the loss relative to the prior, in nats per column and type. It is negative if the forecasts are better than the prior.
    """
    places, there, row = batch["places"], batch["there"], batch["row"].long()
    weight = there.float()
    total = weight.sum().clamp(min=1.0)
    cell = ((places + 0.5) / 2).clamp(min=0)
    height, width = seen.heat.shape[2:]
    column, line = cell[..., 0].long().clamp(max=width - 1), cell[..., 1].long().clamp(max=height - 1)
    at = line * width + column
    middle = torch.stack([column, line], dim=-1) + 0.5
    off = functional.smooth_l1_loss(_taken(seen.offset, at), cell - middle, beta=0.1, reduction="none").sum(dim=-1)
    kind = functional.cross_entropy(_taken(seen.kind, at).flatten(0, 1), contents["kind"][row].flatten(), reduction="none")
    phases = contents["phases"][batch["source"].long()]
    several = (phases > 1).float()
    phase = functional.cross_entropy(seen.phase, batch["phase"].long().clamp(max=seen.phase.shape[1] - 1), reduction="none").mean(dim=(1, 2))
    return {
        "heat": functional.binary_cross_entropy_with_logits(seen.heat[:, 0], batch["heat"], reduction="sum") / total / 8,
        "offset": (off * weight).sum() / total,
        "kind": (kind * weight.flatten()).sum() / total,
        "defects": _defects(seen, batch, contents),
        "phase": (phase * several).sum() / several.sum().clamp(min=1.0),
        "particle": functional.binary_cross_entropy_with_logits(seen.particle[:, 0], batch["particle"]),
    }


def log_chances(toward: Tensor, log_sharpness: Tensor, log_prior: Tensor) -> Tensor:
    """Returns the log posterior of 0, 1, ... defects (last axis): prior times likelihood, normalised."""
    number = torch.arange(log_prior.shape[-1], dtype=toward.dtype, device=toward.device)
    log = log_prior + number * toward[..., None] - 0.5 * torch.exp(log_sharpness)[..., None] * number**2
    return torch.log_softmax(log, dim=-1)


def _defects(seen: Seen, batch: Mapping[str, Tensor], contents: Mapping[str, Tensor]) -> Tensor:
    """Returns the mean loss of the forecasts minus the loss of the prior, in nats."""
    row, true = batch["row"].long(), batch["defects"].long()[..., None]
    maps = torch.cat([seen.toward, seen.log_sharpness], dim=1)
    height, width = maps.shape[2:]
    # No tensor may be made from Python numbers while a step is recorded on a GPU.
    places = batch["places"] + 0.5
    grid = torch.stack([places[..., 0] / width - 1, places[..., 1] / height - 1], dim=-1)[:, :, None]
    at = functional.grid_sample(maps, grid, mode="bilinear", padding_mode="border", align_corners=False)[..., 0].transpose(1, 2)
    types = seen.toward.shape[1]
    prior = contents["log_chances"][row]
    log = log_chances(at[..., :types], at[..., types:], prior)
    weight = (batch["there"][..., None] & contents["possible"][row]).float()
    gained = (torch.log_softmax(prior, dim=-1).gather(-1, true) - log.gather(-1, true))[..., 0]
    return (gained * weight).sum() / weight.sum().clamp(min=1.0)


def _taken(maps: Tensor, at: Tensor) -> Tensor:
    """Returns the values of maps at cells ``[tile, column]``, ``[tile, column, channel]``."""
    flat = maps.flatten(2)
    return flat.gather(2, at[:, None].expand(-1, flat.shape[1], -1)).transpose(1, 2)
