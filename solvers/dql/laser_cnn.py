"""The paper's CNN over the beams of a laser, in PyTorch: to be trained."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from defplan_mj.base.space import SPACES
from defplan_solvers.dql.beams import FEATURES, FILTERS, WIDTHS, BeamFilters, taps


class LaserCnn(nn.Module):
    """The paper's CNN: 16 filters of width 8, 16 of 4, 16 of 4, then 32 features; BNLL units.

    A filter is laid around every beam (see `beams.taps`), on a circle or a sphere of beams alike. What it
    looks at is gathered side by side, so that a layer is one product of matrices: on a CPU that is some
    ten times faster than torch's convolution and the gradient of an index.
    """

    def __init__(self, beams: int, space: str, laser_range: float) -> None:
        super().__init__()
        self.laser_range, self.ring = laser_range, SPACES[space].level
        self.filters = nn.ModuleList(
            nn.Linear(width * (FILTERS if i else 1), FILTERS) for i, width in enumerate(WIDTHS)
        )
        self.looks = [torch.from_numpy(taps(beams, space, width)) for width in WIDTHS]
        self.dense = nn.Linear(FILTERS * beams, FEATURES)

    def forward(self, laser: torch.Tensor) -> torch.Tensor:
        """Return (n, 32) features of (n, beams) distances, m."""
        return self.see(1 - laser / self.laser_range)

    def see(self, proximities: torch.Tensor) -> torch.Tensor:
        """Return the same of (n, beams) proximities."""
        x = proximities[..., None]  # n, beams, channels
        for look, filters in zip(self.looks, self.filters, strict=True):
            if self.ring:
                seen = torch.cat([torch.roll(x, -k, 1) for k in range(look.shape[1])], 2)
            else:
                seen = x[:, look].flatten(2)
            x = functional.softplus(filters(seen))
        return functional.softplus(self.dense(x.flatten(1)))

    def frozen(self) -> BeamFilters:
        """Return what it has learnt, in NumPy."""

        def array(parameter: Any) -> np.ndarray:
            return parameter.detach().numpy().copy()

        return BeamFilters(
            tuple(array(one.weight) for one in self.filters),
            tuple(array(one.bias) for one in self.filters),
            array(self.dense.weight),
            array(self.dense.bias),
            tuple(look.numpy() for look in self.looks),
        )
