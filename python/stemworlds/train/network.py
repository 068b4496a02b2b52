"""The network, which finds columns and their defects in counts of electrons."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from .config import NetworkTable

#: Number of conditions: dose (e/A^2), electrons per pixel, edge of a pixel (nm), inner and outer angle (mrad), thickness (nm).
CONDITIONS = 6
#: Centre and half width of the conditions' logarithms (base 10).
_MIDDLE = (4.2, 2.5, -1.65, 1.8, 2.3, 0.8)
_WIDTH = (1.5, 1.5, 0.25, 0.3, 0.3, 0.5)
_EMBEDDED = 64
#: Limits of the logarithms of scales, so that no step diverges.
_LEAST_LOG, _MOST_LOG = -12.0, 8.0
#: Electrons per pixel at which ``toward`` has the initial scale 1. The signal-to-noise ratio grows with their square root. The number is so
#: large that steps with the greatest learning rate stay stable.
_USUAL_ELECTRONS = 40_000.0


class Seen(NamedTuple):
    """Maps with half of the tile's pixels along an edge, ``[tile, channel, y, x]``.

    Attributes:
        heat: logit of the centre of a column in the cell.
        offset: offset of the column from the centre of the cell, x and y in cells.
        kind: scores of kinds of columns.
        toward, log_sharpness: evidence by type of defect. The log likelihood of k defects is ``k toward - k^2 exp(log_sharpness) / 2``.
        phase: scores of phases.
        particle: logit of a particle.
    """

    heat: Tensor
    offset: Tensor
    kind: Tensor
    toward: Tensor
    log_sharpness: Tensor
    phase: Tensor
    particle: Tensor


class _Block(nn.Module):
    """A residual block of two convolutions. The conditions scale and shift the values between them. Initially it is the identity."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(channels, channels, 3, padding=1)
        self.second = nn.Conv2d(channels, channels, 3, padding=1)
        self.film = nn.Linear(_EMBEDDED, 2 * channels)
        for weights in (self.second.weight, self.second.bias, self.film.weight, self.film.bias):
            assert weights is not None
            nn.init.zeros_(weights)

    def forward(self, image: Tensor, embedded: Tensor) -> Tensor:
        scale, shift = self.film(embedded)[:, :, None, None].chunk(2, dim=1)
        between = self.first(functional.relu(image)) * (1 + scale) + shift
        out: Tensor = image + self.second(functional.relu(between))
        return out


class Network(nn.Module):
    """A U-shaped network of residual blocks. Each level halves the image; the output has half of the tile's pixels along an edge.

    Args:
        table: channels and blocks of the levels.
        kinds, phases, types: numbers of kinds of columns, phases and types of defects that it distinguishes.
    """

    middle: Tensor
    width: Tensor

    def __init__(self, table: NetworkTable, kinds: int, phases: int, types: int) -> None:
        super().__init__()
        channels, blocks = table.channels, table.blocks
        self.sizes = (1, 2, kinds, types, types, phases, 1)
        self.register_buffer("middle", torch.tensor(_MIDDLE), persistent=False)
        self.register_buffer("width", torch.tensor(_WIDTH), persistent=False)
        self.embed = nn.Sequential(nn.Linear(CONDITIONS, _EMBEDDED), nn.ReLU(), nn.Linear(_EMBEDDED, _EMBEDDED), nn.ReLU())
        self.stem = nn.Conv2d(2, channels[0], 6, stride=2, padding=2)
        self.down = nn.ModuleList(nn.Conv2d(a, b, 2, stride=2) for a, b in zip(channels, channels[1:], strict=False))
        self.up = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in zip(channels, channels[1:], strict=False))
        self.before: Any = nn.ModuleList(nn.ModuleList(_Block(size) for _ in range(count)) for size, count in zip(channels, blocks, strict=True))
        self.after: Any = nn.ModuleList(nn.ModuleList(_Block(size) for _ in range(count)) for size, count in zip(channels[:-1], blocks, strict=False))
        self.mix = nn.Conv2d(channels[0], 2 * channels[0], 1)
        self.heads = nn.Conv2d(2 * channels[0], sum(self.sizes), 1)
        #: Scales of ``toward`` and ``log_sharpness`` from the conditions alone.
        self.gain = nn.Linear(_EMBEDDED, 2 * types)
        nn.init.normal_(self.heads.weight, std=0.01)
        with torch.no_grad():
            assert self.heads.bias is not None
            self.heads.bias.zero_()
            self.heads.bias[0] = -3.0
            self.heads.bias[3 + kinds + types : 3 + kinds + 2 * types] = -3.0
            self.gain.weight.zero_()
            self.gain.bias.zero_()

    def forward(self, counts: Tensor, conditions: Tensor) -> Seen:
        """Computes the maps from counts ``[tile, 1, y, x]`` and conditions ``[tile, 6]``."""
        known = (torch.log10(conditions) - self.middle) / self.width
        embedded = self.embed(known)
        # Anscombe's transform makes the variance of the noise 1 for any mean.
        even = 2 * torch.sqrt(counts + 0.375)
        electrons = conditions[:, 1, None, None, None]
        image = self.stem(torch.cat([2 * even / torch.sqrt(electrons) - 1, even / 16], dim=1))
        kept = []
        for level, blocks in enumerate(self.before):
            if level:
                image = self.down[level - 1](functional.relu(image))
            for block in blocks:
                image = block(image, embedded)
            kept.append(image)
        for level in reversed(range(len(self.up))):
            coarse = functional.interpolate(self.up[level](functional.relu(image)), scale_factor=2.0, mode="nearest")
            image = kept[level] + coarse
            for block in self.after[level]:
                image = block(image, embedded)
        said = self.heads(functional.relu(self.mix(functional.relu(image))))
        heat, offset, kind, toward, log_sharpness, phase, particle = said.split(self.sizes, dim=1)
        of_toward, of_sharpness = self.gain(embedded)[:, :, None, None].chunk(2, dim=1)
        scale = torch.exp((0.5 * torch.log(electrons / _USUAL_ELECTRONS) + of_toward).clamp(_LEAST_LOG, _MOST_LOG))
        return Seen(heat, offset, kind, scale * toward, (log_sharpness + of_sharpness).clamp(_LEAST_LOG, _MOST_LOG), phase, particle)
