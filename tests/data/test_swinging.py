"""The warm-up whose joints swing: what its sines are, and that slow gaits are less fit."""

import numpy as np
import pytest
import torch
from robots import opposite_axes

from gctd3.data.swinging import Swinging
from gctd3.data.trials import Trials

DT = 0.02


def swinging(robot, robots=4, **settings):
    torch.manual_seed(0)
    return Swinging(robot, robots, (1.4, 2.2), Trials(0.1, DT, **settings))


@pytest.fixture(scope="module", params=["biped", "opposite axes"])
def biped(request, robot, tmp_path_factory):
    return robot if request.param == "biped" else opposite_axes(robot, tmp_path_factory.mktemp("swinging"))


def test_actions_are_the_sines_that_they_say(robot):
    """By hand, from the genes of the right leg's joints, which the robot lists first: the left lags half a period."""
    gaits = swinging(robot)
    genes = {name: getattr(gaits, name) for name in gaits.GENES}
    cycles = torch.tensor([0.0, 0.2, 0.7, 3.1])
    offset, amplitude, phase = (genes[name].numpy() for name in ("offset", "amplitude", "phase"))
    assert phase.shape == (4, 3)
    right = offset + amplitude * np.sin(2 * np.pi * (cycles.numpy()[:, None] + phase))
    left = offset + amplitude * np.sin(2 * np.pi * (cycles.numpy()[:, None] + phase + 0.5))
    expected = np.concatenate([right, left], axis=1)
    assert robot.actuated[0].endswith("right") and robot.actuated[3].endswith("left")
    np.testing.assert_allclose(gaits.act(genes, cycles).numpy(), expected, atol=1e-5)


def test_mirrored_joints_follow_half_a_period_later(biped):
    gaits = swinging(biped)
    genes = {name: getattr(gaits, name) for name in gaits.GENES}
    now, later = (gaits.act(genes, torch.full((4,), cycles)) for cycles in (0.3, 0.8))
    order, sign = biped.action_mirror
    torch.testing.assert_close(now, torch.from_numpy(sign).float() * later[:, torch.from_numpy(order)])


def test_genes_stay_in_their_ranges(robot):
    gaits = swinging(robot, robots=64, mutation_share=1.0)
    begins, position = torch.ones(64, dtype=torch.bool), torch.zeros(64)
    for step in range(60):
        gaits(begins if step == 0 else ~begins, position)
        position = position + torch.rand(64)
    for name, (low, high, _) in gaits.GENES.items():
        values = getattr(gaits, name)
        assert values.min() >= low and values.max() <= high, name
    assert gaits.frequency.min() >= 1.4 and gaits.frequency.max() <= 2.2


def test_slow_gaits_are_less_fit(robot):
    """A trial of 0.1 s is five steps. At 1.2 m/s a gait keeps its reward; each m/s less costs 2 a step."""
    gaits = swinging(robot, least_speed=1.0)
    nobody = torch.zeros(4, dtype=torch.bool)
    speeds = torch.tensor([1.2, 1.0, 0.5, -0.5])
    gaits(~nobody, torch.zeros(4), torch.zeros(4))
    for step in range(1, 6):
        gaits(nobody, 0.3 * step * torch.ones(4), DT * step * speeds)
    torch.testing.assert_close(gaits.fitness, 0.3 - 2.0 * torch.tensor([0.0, 0.0, 0.5, 1.5]))
    # In the next trial the distance counts from its own beginning.
    before = gaits.fitness.clone()
    gaits.again.fill_(False)
    for step in range(6, 11):
        gaits(nobody, 1.5 + 0.4 * (step - 5) * torch.ones(4), DT * 5 * speeds + DT * (step - 5) * 1.0)
    torch.testing.assert_close(gaits.fitness, torch.maximum(before, torch.full((4,), 0.4)))


def test_a_fall_ends_what_was_walked(robot):
    """After three of five steps at 2 m/s the robot has 0.12 m in 0.1 s, which is 1.2 m/s; and the fall costs 1."""
    gaits = swinging(robot, least_speed=1.5)
    everybody, zeros = torch.ones(4, dtype=torch.bool), torch.zeros(4)
    gaits(everybody, zeros, zeros)
    for step in range(1, 4):
        gaits(~everybody, zeros + 0.5 * step, zeros + 2.0 * DT * step)
    gaits(everybody, zeros, zeros)
    torch.testing.assert_close(gaits.fitness, torch.full((4,), 1.5 / 5 - 1.0 - 2.0 * 0.3))


def test_without_a_least_speed_it_is_not_remembered(robot):
    assert "walked" not in swinging(robot).state_dict() and "walked" in swinging(robot, least_speed=1.0).state_dict()


def test_all_follow_the_winner_at_the_end(robot, monkeypatch):
    """Of 20 steps the last round has 6, and the winner the last 3 of them, which are not known as shown before."""
    monkeypatch.setattr(Swinging, "FINALISTS", 2)
    gaits = swinging(robot, robots=8, steps=20)
    nobody, returned, shown = torch.zeros(8, dtype=torch.bool), torch.zeros(8), []
    for step in range(20):
        if step == 17:
            assert gaits.decides
            gaits.fitness.copy_(torch.tensor([0.1, 0.8] * 4))
            winner = gaits.best_frequency[1].clone()
        gaits(nobody if step else ~nobody, returned)
        shown.append(gaits.shows)
        returned = returned + torch.rand(8)
    assert shown == [False] * 17 + [True] * 3 and not gaits.decides
    assert gaits.followers.all() and (gaits.frequency == winner).all() and (gaits.best_frequency == winner).all()


def test_followers_try_the_fittest_gait(robot, monkeypatch):
    monkeypatch.setattr(Swinging, "FINALISTS", 2)
    gaits = swinging(robot, robots=8, steps=10)
    nobody, returned = torch.zeros(8, dtype=torch.bool), torch.zeros(8)
    gaits(~nobody, returned)
    gaits.fitness.copy_(torch.tensor([0.1, 0.9, 0.2, 0.8, 0.3, 0.0, 0.0, 0.0]))
    gaits.taken.fill_(7)
    gaits(nobody, returned)
    gaits.fitness.copy_(torch.tensor([0.1, 0.8, 0.0, 0.8, 0.0, 0.8, 0.0, 0.8]))
    assert gaits.followers.tolist() == [False, True] * 4
