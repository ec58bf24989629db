"""The buffer of single frames gives the same transitions as the stacks that the environment delivered."""

import mmap
from pathlib import Path

import numpy as np
import pytest
import torch
from thinned import parametrize

import gctd3
from gctd3.data.frame_buffer import FrameBuffer
from gctd3.data.replay import ENDS, KEPT, StackedBuffer
from gctd3.errors import ConfigError

PAGEMAP = Path("/proc/self/pagemap")
PAGE = mmap.PAGESIZE

ROBOTS, STEPS, HISTORY, GAMMA = 5, 160, 5, 0.9


@pytest.fixture(scope="module")
def collected():
    """Collect random actions of five robots, which fall again and again, each at its own time."""
    torch.manual_seed(0)
    rollout = gctd3.make_env("biped", num_envs=ROBOTS, history=HISTORY, seed=0).rollout(
        STEPS, break_when_any_done=False
    )
    assert rollout["next", "done"].sum() > ROBOTS
    return rollout


def fill(buffer, collected, chunk):
    for part in collected.split(chunk, dim=1):
        buffer.extend(part)
    return buffer


def expected(collected, n_step):
    """Return every n-step transition of TorchRL's buffer, by its action, which differs in every step."""
    stacked = fill(StackedBuffer(10_000, 1, n_step, GAMMA), collected, STEPS).torchrl[:]
    return {tuple(action.tolist()): stacked[i] for i, action in enumerate(stacked["action"])}


@parametrize(2, "n_step", [1, 3])
@pytest.mark.parametrize("rows", [STEPS + 10, 37])  # with room to spare; the ring gone round four times
@pytest.mark.parametrize("chunk", [1, 7])
def test_same_transitions_as_the_stacked_buffer(collected, n_step, rows, chunk):
    buffer = fill(FrameBuffer(rows * ROBOTS, 1, HISTORY, n_step, GAMMA), collected, chunk)
    reference, keys = expected(collected, n_step), [*KEPT, *ENDS, *(["steps_to_next_obs"] if n_step > 1 else [])]
    full = rows < STEPS
    assert buffer.ready == (rows - n_step - HISTORY + 1 if full else STEPS - n_step)
    oldest = buffer.head + HISTORY - 1 if full else 0
    drawn = (oldest + torch.arange(buffer.ready)) % buffer.rows
    for robot in range(ROBOTS):
        batch = buffer.gather(drawn, torch.full_like(drawn, robot))
        for i in range(len(drawn)):
            truth = reference[tuple(batch["action"][i].tolist())]
            for key in keys:
                torch.testing.assert_close(batch[key][i].float(), truth[key].float(), rtol=1e-6, atol=1e-6)


def test_draws_every_transition_that_is_ready_and_no_other(collected):
    buffer = fill(FrameBuffer(20 * ROBOTS, 64, HISTORY, 3, GAMMA), collected, 9)
    ready = (buffer.head + HISTORY - 1 + torch.arange(buffer.ready)) % buffer.rows
    actions = {
        tuple(a.tolist()) for r in range(ROBOTS) for a in buffer.gather(ready, torch.full_like(ready, r))["action"]
    }
    torch.manual_seed(0)
    drawn = {tuple(action.tolist()) for _ in range(60) for action in buffer.sample()["action"]}
    assert drawn == actions


def test_final_frames_do_not_pile_up(collected):
    """The places of final frames are used again, so the table stays as small as the ring allows."""
    buffer = FrameBuffer(30 * ROBOTS, 1, HISTORY, 1, GAMMA)
    for _ in range(20):
        fill(buffer, collected, 40)
    held = int((buffer._ring["last"] >= 0).sum())
    assert held + len(buffer._free) == len(buffer._last["nodes"]) <= 128


def test_a_million_transitions_of_the_biped_take_at_most_200_megabytes(collected):
    buffer = FrameBuffer(1_000_000, 256, HISTORY, 3, GAMMA)
    buffer.extend(collected)
    assert buffer.rows * ROBOTS == 1_000_000
    # A final frame for every 20th step on top.
    final = sum(table[0].nbytes for table in buffer._last.values()) * 50_000
    assert buffer.nbytes + final <= 200e6


def resident(tensor):
    """Return the bytes of a tensor's memory that the system has given pages to, whatever else its process does."""
    first, last = (place // PAGE for place in (tensor.data_ptr(), tensor.data_ptr() + tensor.nbytes - 1))
    with PAGEMAP.open("rb", buffering=0) as file:
        file.seek(8 * first)
        entries = np.frombuffer(file.read(8 * (last - first + 1)), dtype=np.uint64)
    assert len(entries) == last - first + 1
    return int((entries >> np.uint64(63)).sum()) * PAGE  # bit 63: the page is in memory


@pytest.mark.skipif(not PAGEMAP.exists(), reason="reads the memory of a process as Linux shows it")
def test_rows_take_up_memory_once_they_are_written(collected):
    # Memory that was used and given back, which an allocator hands out again after writing zeros to all of it.
    for _ in range(3):
        used = [np.ones(size, np.uint8) for size in (31_000_000, 16_000_000, 8_000_000, 4_000_000) for _ in range(4)]
        del used
    buffer = FrameBuffer(4_000_000, 8, history=5, n_step=1, gamma=0.99)
    buffer.extend(collected)
    tables = [*buffer._ring.values(), *buffer._last.values()]
    # Whether a row has a last frame of its own is 4 bytes, and not zero for one that has none.
    assert buffer.nbytes > 400e6 and sum(map(resident, tables)) < 40e6
    buffer._ring["nodes"].fill_(1)
    assert resident(buffer._ring["nodes"]) >= buffer._ring["nodes"].nbytes


def test_restores_what_it_saved(collected):
    buffer = fill(FrameBuffer(30 * ROBOTS, 8, HISTORY, 3, GAMMA), collected, 40)
    other = FrameBuffer(30 * ROBOTS, 8, HISTORY, 3, GAMMA)
    oldest = buffer.total - buffer.filled
    parts = [(start, buffer.rows_between(start, stop)) for start, stop in ((oldest, 150), (150, buffer.total))]
    other.load_state_dict(buffer.state_dict(), iter(parts))
    torch.manual_seed(4)
    first = buffer.sample()
    torch.manual_seed(4)
    assert (first == other.sample()).all()


def test_a_buffer_restored_before_it_is_full_is_filled_like_the_other(collected):
    """Rows that were never written hold no final frame, so that writing them frees none."""
    buffer = fill(FrameBuffer(1000 * ROBOTS, 8, HISTORY, 3, GAMMA), collected[:, :80], 40)
    other = FrameBuffer(1000 * ROBOTS, 8, HISTORY, 3, GAMMA)
    other.load_state_dict(buffer.state_dict(), iter([(0, buffer.rows_between(0, buffer.total))]))
    for one in (buffer, other):
        fill(one, collected[:, 80:160], 40)
        assert int((one.rows_between(0, 160)["last"] >= 0).sum()) + len(one._free) == len(one._last["nodes"])
        assert len(set(one._free)) == len(one._free)
    for _ in range(20):
        torch.manual_seed(5)
        first = buffer.sample()
        torch.manual_seed(5)
        assert (first == other.sample()).all()


@pytest.mark.parametrize("capacity", [1000, 30])  # rows
@pytest.mark.parametrize("restored", [False, True])
def test_once_cleared_it_draws_only_what_came_after(collected, capacity, restored):
    buffer = fill(FrameBuffer(capacity * ROBOTS, 64, HISTORY, 3, GAMMA), collected[:, :100], 10)
    buffer.clear()
    assert len(buffer) == buffer.ready == 0
    if restored:
        state, buffer = buffer.state_dict(), FrameBuffer(capacity * ROBOTS, 64, HISTORY, 3, GAMMA)
        buffer.load_state_dict(state, iter([]))
    fill(buffer, collected[:, 100:120], 10)
    # The first four rows may lack earlier frames, the last three later ones.
    assert buffer.ready == 20 - 4 - 3
    reference = {tuple(action.tolist()) for action in collected["action"][:, 104:117].reshape(-1, 6)}
    torch.manual_seed(0)
    assert {tuple(action.tolist()) for _ in range(40) for action in buffer.sample()["action"]} == reference
    rows = buffer.rows_between(100, 120)
    assert (rows["action"] == collected["action"][:, 100:120].movedim(1, 0)).all()
    assert int((rows["last"] >= 0).sum()) + len(buffer._free) == len(buffer._last["nodes"])


def test_too_little_to_draw_from_and_too_little_room(collected):
    buffer = FrameBuffer(1000, 8, HISTORY, 3, GAMMA)
    with pytest.raises(RuntimeError, match="too few to draw from"):
        buffer.sample()
    with pytest.raises(ConfigError, match=r"at least 40 for 5 robots, a history of 5 and 3 steps, got 39"):
        FrameBuffer(39, 8, HISTORY, 3, GAMMA).extend(collected)
