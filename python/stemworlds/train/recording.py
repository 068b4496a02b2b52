"""Records noise-free tiles: rotates and mirrors them, applies the errors of a scan, and counts electrons.

The random numbers depend on seed and step.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from .config import PROFILES, StreamTable

#: Time on a pixel, and time from the end of a line to the start of the next, in microseconds.
_DWELL_US, _FLYBACK_US = 10.0, 60.0
_ELECTRONS_PER_PA_US = 6.2415


@dataclass(frozen=True)
class Profile:
    """Errors of a microscope, see docs/acquisition.md.

    The random walk is left out, since it moves a tile by a fifth of a pixel at most. Converters are left out, since their range depends on
    a whole frame. No profile contains contamination.
    """

    drift_x_nm_per_s: float = 0.0
    drift_y_nm_per_s: float = 0.0
    jitter_nm: float = 0.0
    overshoot_nm: float = 0.0
    overshoot_us: float = 100.0
    hum_x_nm: float = 0.0
    hum_y_nm: float = 0.0
    hum_hz: float = 50.0
    scale_x: float = 0.0
    scale_y: float = 0.0
    shear: float = 0.0
    dqe: float = 1.0
    late_share: float = 0.0
    late_us: float = 20.0
    saturation_pa: float = 0.0
    read_noise_electrons: float = 0.0


#: Values by profile. A test compares them with the table in the documentation.
VALUES = {
    "ideal": Profile(),
    "routine": Profile(0.007, 0.004, 0.005, 0.01, 100.0, 0.005, 0.002, 50.0, 0.005, -0.005, 0.002, 0.8, 0.02, 20.0, 0.0, 20 / 50),
    "poor": Profile(0.05, 0.03, 0.02, 0.05, 200.0, 0.03, 0.01, 50.0, 0.02, -0.01, 0.01, 0.5, 0.1, 50.0, 50.0, 2 / 4),
}


class Recorder:
    """Records noise-free tiles. Seed and step determine a recording on one kind of device.

    Args:
        table: settings with the range of doses and the weights of profiles.
        facts: float32 ``[recipe, (inner mrad, outer mrad, thickness nm)]``.
        seed: seed of all random numbers, together with the step.
    """

    def __init__(self, table: StreamTable, facts: Tensor, seed: int) -> None:
        self._facts, self._seed = facts, seed
        self._logs = tuple(math.log(dose) for dose in table.dose)
        device = facts.device
        self._shares = torch.tensor([table.profiles.get(name, 0.0) for name in PROFILES], device=device)
        rows = [[getattr(VALUES[name], one.name) for one in fields(Profile)] for name in PROFILES]
        self._values = {one.name: torch.tensor([row[n] for row in rows], device=device) for n, one in enumerate(fields(Profile))}
        self._late = torch.stack([_late_light(VALUES[name], table.size) for name in PROFILES]).to(device)
        self._disturbed = bool((self._shares[1:] > 0).any())

    def __call__(self, tiles: Mapping[str, Tensor], step: int) -> dict[str, Tensor]:
        """Returns the batch with ``counts`` and ``conditions`` instead of ``clean``. Its labels have their places in the recording."""
        batch = dict(tiles)
        clean = batch.pop("clean")
        random = torch.Generator(clean.device).manual_seed((self._seed << 32) ^ step)
        count = len(clean)
        clean, batch = _turned(clean, batch, torch.rand(3, count, generator=random, device=clean.device) < 0.5)
        dose = torch.exp(self._logs[0] + (self._logs[1] - self._logs[0]) * torch.rand(count, generator=random, device=clean.device))
        electrons = dose * (10 * batch["pixel_nm"]) ** 2
        if self._disturbed:
            counts = self._disturb(clean, batch, electrons, random)
        else:
            counts = torch.poisson(clean.clamp(min=0) * electrons[:, None, None], generator=random)
        batch["counts"] = counts[:, None]
        facts = self._facts[batch["source"].long()]
        batch["conditions"] = torch.stack([dose, electrons, batch["pixel_nm"], *facts.unbind(dim=1)], dim=1)
        return batch

    def _disturb(self, clean: Tensor, batch: dict[str, Tensor], electrons: Tensor, random: torch.Generator) -> Tensor:
        """Returns counts by the chain of docs/acquisition.md. Ideal values of a profile have no effect."""
        which = torch.multinomial(self._shares, len(clean), replacement=True, generator=random)
        own = {name: values[which][:, None] for name, values in self._values.items()}
        moved = self._moved(clean, batch, own, random)
        ideal = (which == 0)[:, None, None]
        mean = torch.where(ideal, clean, moved).clamp(min=0) * electrons[:, None, None]
        number = torch.poisson(mean, generator=random)
        # The sum of gamma-distributed pulse heights is approximated by a normal distribution with equal variance.
        spread = torch.sqrt(number * (1 / own["dqe"] - 1)[:, None])
        light = (number + spread * torch.randn(number.shape, generator=random, device=number.device)).clamp(min=0)
        light = torch.bmm(light, self._late[which])
        most = (own["saturation_pa"] * _ELECTRONS_PER_PA_US * _DWELL_US)[:, None]
        light = torch.where(most > 0, light / (1 + light / most.clamp(min=1e-6)), light)
        noise = own["read_noise_electrons"][:, None] * torch.randn(light.shape, generator=random, device=light.device)
        return torch.where(ideal, number, (light + noise).clamp(min=0))

    def _moved(self, clean: Tensor, batch: dict[str, Tensor], own: Mapping[str, Tensor], random: torch.Generator) -> Tensor:
        """Returns the noise-free image at the true places of the beam. Places of columns are moved too, without the jitter of lines."""
        count, height, width = clean.shape
        device, pixel = clean.device, batch["pixel_nm"][:, None]
        row, column = torch.arange(height, device=device).float(), torch.arange(width, device=device).float()
        line_us = width * _DWELL_US + _FLYBACK_US
        phase = 2 * math.pi * torch.rand(2, count, 1, generator=random, device=device)

        def steady(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
            """Returns the displacement in pixels, along x and y, of pixels ``[tile, ...]``."""
            across, down = x - (width - 1) / 2, y - (height - 1) / 2
            time = (y * line_us + (x + 0.5) * _DWELL_US) * 1e-6
            turn = 2 * math.pi * own["hum_hz"] * time
            after = own["overshoot_nm"] * torch.exp(-(x + 0.5) * _DWELL_US / own["overshoot_us"])
            x_nm = own["hum_x_nm"] * torch.sin(turn + phase[0]) - after - own["drift_x_nm_per_s"] * time
            y_nm = own["hum_y_nm"] * torch.sin(turn + phase[1]) - own["drift_y_nm_per_s"] * time
            return own["scale_x"] * across + own["shear"] * down + x_nm / pixel, own["scale_y"] * down + y_nm / pixel

        def grid(x: Tensor, y: Tensor, more: Tensor | float = 0.0) -> Tensor:
            """Returns the places of the beam in the coordinates of grid_sample, ``[tile, row, column, (x, y)]``."""
            across, down = torch.meshgrid(x, y, indexing="xy")
            moved = torch.stack(steady(across.flatten()[None], down.flatten()[None]), dim=-1).reshape(count, len(y), len(x), 2)
            at = torch.stack([across, down], dim=-1) + moved + more
            return (2 * at + 1) / torch.tensor([width, height], device=device) - 1

        jitter = own["jitter_nm"][..., None] / pixel[..., None] * torch.randn(count, height, 2, generator=random, device=device)
        options: Any = {"padding_mode": "reflection", "align_corners": False}
        moved = functional.grid_sample(clean[:, None], grid(column, row, jitter[:, :, None]), mode="bicubic", **options)[:, 0]
        places = batch["places"]
        batch["places"] = places - torch.stack(steady(places[..., 0], places[..., 1]), dim=-1)
        batch["there"] = batch["there"] & ((batch["places"] > -0.5) & (batch["places"] < width - 0.5)).all(dim=-1)
        cells = grid(column[: width // 2] * 2 + 0.5, row[: height // 2] * 2 + 0.5)
        for name in ("heat", "particle"):
            batch[name] = functional.grid_sample(batch[name][:, None], cells, mode="bilinear", **options)[:, 0]
        return moved


def _turned(clean: Tensor, batch: dict[str, Tensor], chosen: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
    """Mirrors tiles along x, along y, and at the diagonal, as chosen for each tile."""
    size = clean.shape[-1]
    batch = dict(batch)
    images = {"clean": clean, **{name: batch[name] for name in ("heat", "phase", "particle")}}
    for which, axis in ((chosen[0], 2), (chosen[1], 1)):
        images = {name: torch.where(which[:, None, None], image.flip(axis), image) for name, image in images.items()}
    images = {name: torch.where(chosen[2][:, None, None], image.transpose(1, 2), image) for name, image in images.items()}
    places = batch["places"]
    mirrored = torch.where(torch.stack([chosen[0], chosen[1]], dim=-1)[:, None], size - 1 - places, places)
    batch["places"] = torch.where(chosen[2][:, None, None], mirrored.flip(-1), mirrored)
    clean = images.pop("clean")
    return clean, {**batch, **images}


def _late_light(profile: Profile, size: int) -> Tensor:
    """Returns the share of each pixel's light in the pixels of its line, ``[from, to]``."""
    away = torch.arange(size)[None, :] - torch.arange(size)[:, None]
    step = math.exp(-_DWELL_US / profile.late_us)
    late = torch.where(away >= 0, (1 - step) * step ** away.clamp(min=0).float(), 0.0)
    return (1 - profile.late_share) * torch.eye(size) + profile.late_share * late
