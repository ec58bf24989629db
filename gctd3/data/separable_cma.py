"""The separable CMA-ES: normal distributions without correlations that move to what is fitter."""

from __future__ import annotations

import math

import torch
from torch import Tensor


class SeparableCMA(torch.nn.Module):
    """Search with several normal distributions side by side (Ros & Hansen 2008, doi 10.1007/978-3-540-87700-4_30).

    Their covariances are diagonal, and all numbers are the method's default ones (Hansen 2016, arXiv:1604.00772).

    Args:
        mean: Mean of each distribution at first, shape ``[L, D]``.
        deviation: Standard deviation of each number at first, shape ``[D]``.

    Attributes:
        mean: Means, shape ``[L, D]``.
        spread: Variances before the step size, shape ``[L, D]``.
        size: Step sizes, shape ``[L]``.
    """

    mean: Tensor
    spread: Tensor
    size: Tensor
    path: Tensor
    size_path: Tensor

    LARGEST = 2.0  # step size
    FITTEST = 0.25  # share of what was tried to which a mean moves

    def __init__(self, mean: Tensor, deviation: Tensor) -> None:
        super().__init__()
        self.register_buffer("mean", mean.clone())
        self.register_buffer("spread", deviation.square().expand_as(mean).clone())
        self.register_buffer("size", torch.ones(len(mean)))
        self.register_buffer("path", torch.zeros_like(mean))
        self.register_buffer("size_path", torch.zeros_like(mean))

    def draw(self, level: Tensor) -> Tensor:
        """Draw from the distributions of given numbers ``[n]``, shape ``[n, D]``."""
        deviation = self.size[level, None] * self.spread[level].sqrt()
        return self.mean[level] + deviation * torch.randn_like(deviation)

    def step(self, level: int, tried: Tensor, fitness: Tensor) -> None:
        """Move a distribution to the fittest of what was tried.

        Args:
            level: Number of the distribution.
            tried: What was tried, shape ``[n, D]``, drawn from it or not.
            fitness: Its fitness, shape ``[n]``.
        """
        length = tried.shape[1]
        best = fitness.argsort(descending=True)[: max(2, round(self.FITTEST * len(tried)))]
        weights = math.log(len(best) + 0.5) - torch.arange(1, len(best) + 1).log()
        weights = weights / weights.sum()
        mass = float(1.0 / weights.square().sum())
        size, spread = float(self.size[level]), self.spread[level]
        steps = (tried[best] - self.mean[level]) / size
        # What is from elsewhere goes as far as the distribution might have gone (Hansen 2011, arXiv:1110.4181).
        far, farthest = (steps / spread.sqrt()).norm(dim=1), math.sqrt(length) + 2.0 * length / (length + 2.0)
        steps = steps * (farthest / far).clamp(max=1.0)[:, None]
        step = weights @ steps
        rate = (mass + 2.0) / (length + mass + 5.0)
        calm = 1.0 + rate + 2.0 * max(0.0, math.sqrt((mass - 1.0) / (length + 1.0)) - 1.0)
        slow = (4.0 + mass / length) / (length + 4.0 + 2.0 * mass / length)
        # Of a diagonal there is less to learn, by a factor of (D + 2) / 3.
        faster = (length + 2.0) / 3.0
        one = min(1.0, faster * 2.0 / ((length + 1.3) ** 2 + mass))
        many = min(1.0 - one, faster * 2.0 * (mass - 2.0 + 1.0 / mass) / ((length + 2.0) ** 2 + mass))
        usual = math.sqrt(length) * (1.0 - 1.0 / (4.0 * length) + 1.0 / (21.0 * length**2))
        self.size_path[level] *= 1.0 - rate
        self.size_path[level] += math.sqrt(rate * (2.0 - rate) * mass) * step / spread.sqrt()
        self.path[level] *= 1.0 - slow
        self.path[level] += math.sqrt(slow * (2.0 - slow) * mass) * step
        self.mean[level] += size * step
        drawn = weights @ steps.square()
        self.spread[level] = (1.0 - one - many) * spread + one * self.path[level].square() + many * drawn
        grows = math.exp(rate / calm * (float(self.size_path[level].norm()) / usual - 1.0))
        self.size[level] = min(size * grows, self.LARGEST)
