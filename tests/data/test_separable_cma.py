"""The separable CMA-ES: it finds the best of a known function, whatever its scale, each distribution by itself."""

import torch

from gctd3.data.separable_cma import SeparableCMA


def searched(levels=2, length=6):
    torch.manual_seed(0)
    return SeparableCMA(torch.zeros(levels, length), torch.full((length,), 0.5))


def test_it_finds_the_bottom_of_a_narrow_bowl():
    """Find the top of an ellipsoid whose axes differ by a factor of 30, outside the first draws."""
    search, target = searched(), torch.linspace(1.0, 2.0, 6)
    weights = torch.logspace(0.0, 3.0, 6)
    level = torch.zeros(20, dtype=torch.int64)
    for _ in range(150):
        tried = search.draw(level)
        search.step(0, tried, -(weights * (tried - target).square()).sum(dim=1))
    torch.testing.assert_close(search.mean[0], target, atol=1e-2, rtol=0)
    # It is narrow where the bowl is, and the other distribution is where it was.
    assert search.spread[0, -1] < search.spread[0, 0] / 10
    assert (search.mean[1] == 0).all() and (search.spread[1] == 0.25).all() and search.size[1] == 1.0


def test_only_the_order_of_the_fitness_counts():
    one, other, tried = searched(), searched(), torch.randn(12, 6)
    fitness = tried.sum(dim=1)
    one.step(1, tried, fitness)
    other.step(1, tried, fitness.exp() * 1000.0 - 7.0)
    for name, value in one.state_dict().items():
        torch.testing.assert_close(other.state_dict()[name], value)


def test_the_mean_moves_by_the_weighted_mean_of_the_fittest():
    """Weigh the best two of eight, by log(2.5) - log(1 and 2) over their sum, by hand."""
    search = searched(levels=1, length=3)
    tried = torch.linspace(-0.2, 0.2, 24).reshape(8, 3)
    search.step(0, tried, torch.arange(8.0))
    first, second = torch.tensor([2.5, 2.5 / 2]).log()
    expected = (first * tried[7] + second * tried[6]) / (first + second)
    torch.testing.assert_close(search.mean[0], expected)


def test_what_is_from_elsewhere_does_not_throw_it_far():
    """A jump 1,000 standard deviations away moves the mean by sqrt(D) + 2 D / (D + 2) of them at most."""
    search = searched(levels=1, length=4)
    search.step(0, torch.full((2, 4), 500.0), torch.tensor([1.0, 0.0]))
    assert search.mean[0].norm() / 0.5 <= 2.0 + 8.0 / 6.0 + 1e-4


def test_draws_have_the_deviation():
    search = searched()
    drawn = search.draw(torch.ones(20_000, dtype=torch.int64))
    torch.testing.assert_close(drawn.std(dim=0), torch.full((6,), 0.5), atol=0.02, rtol=0)
