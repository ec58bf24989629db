"""What robots did in the last round of a warm-up: who is kept, what is drawn, and that it is saved."""

import torch
from tensordict import TensorDict

from gctd3.data.demonstration import Demonstration
from gctd3.data.mirror_augmentation import MirrorAugmentation
from gctd3.tasks.walk import WalkingTask


def steps(robots=3, time=2, number=0.0):
    nodes = torch.arange(robots).float()[:, None, None, None].expand(robots, time, 8, 10).clone() + number
    return TensorDict({"nodes": nodes, "action": nodes[:, :, 0, :6] / 10}, [robots, time])


def test_batches_are_of_the_robots_that_are_kept():
    shown = Demonstration(200)
    shown.add(steps())
    shown.add(steps(number=10.0))
    assert len(shown) == 0
    shown.keep(torch.tensor([True, False, True]))
    assert len(shown) == 8  # two robots, two batches of two steps
    batch = shown.sample()
    assert set(batch["nodes"].unique().tolist()) == {0.0, 2.0, 10.0, 12.0}
    torch.testing.assert_close(batch["action"], batch["nodes"][:, 0, :6] / 10)


def test_what_is_recorded_is_a_copy():
    """Collectors write into the same arrays again."""
    shown, given = Demonstration(4), steps()
    shown.add(given)
    given["nodes"].fill_(9.0)
    shown.keep(torch.tensor([True, True, True]))
    assert 9.0 not in shown.sample()["nodes"]


def test_half_of_a_batch_is_mirrored(robot):
    reflection = WalkingTask(robot).reflection()
    mirror = MirrorAugmentation(reflection, 5)
    torch.manual_seed(0)
    nodes, action = torch.randn(1, 1, 8, 10), torch.randn(1, 1, 6)
    shown = Demonstration(2, mirror)
    shown.add(TensorDict({"nodes": nodes, "action": action}, [1, 1]))
    shown.keep(torch.tensor([True]))
    batch = shown.sample()
    torch.testing.assert_close(batch["nodes"][0], nodes[0, 0])
    torch.testing.assert_close(batch["nodes"][1:], mirror.reflect("nodes", nodes[0]))
    torch.testing.assert_close(batch["action"][1:], mirror.reflect("action", action[0]))


def test_it_is_saved_while_it_is_recorded_and_after():
    shown, again = Demonstration(5), Demonstration(5)
    for number in (0.0, 10.0):
        shown.add(steps(time=1, number=number))
    again.load_state_dict(shown.state_dict())
    for one in (shown, again):
        one.add(steps(time=1, number=20.0))
        one.keep(torch.tensor([False, True, True]))
    last = Demonstration(5)
    last.load_state_dict(again.state_dict())
    assert len(shown) == len(last) == 6
    drawn = []
    for one in (shown, again, last):
        torch.manual_seed(1)
        drawn.append(one.sample())
    assert (drawn[0] == drawn[1]).all() and (drawn[0] == drawn[2]).all()
    last.load_state_dict(None)
    assert len(last) == 0
