"""A replay buffer that stores every frame once and stacks histories when a batch is drawn."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from gctd3.data.lazy_zeros import lazy_zeros
from gctd3.errors import ConfigError
from gctd3.nn.kernels import stack_frames


class FrameBuffer:
    """Store control steps in a ring, with a row for each step and a column for each robot.

    A row holds the newest frame before its step, so the frame after it is the next row's. Only the last step of an
    episode has no such row: its final frame lies in a table beside the ring, which grows as needed and whose places are
    used again when their row is overwritten.

    Worked example (history 3, episode begins in row 5): the stack of row 6 is frames 5, 5, 6, that of row 5 is 5, 5, 5,
    as CatFrames with ``padding="same"`` delivered them.

    Args:
        capacity: Transitions kept, all robots together.
        batch_size: Transitions drawn at once.
        history: ``H``, frames in a stack.
        n_step: Rewards summed before the bootstrap.
        gamma: Discount of these rewards.
        device: Device of the transitions and of the batches.

    Raises:
        ConfigError: If the capacity is too small for the robots that the first batch brings.
    """

    KEYS = ("nodes", "counters")  # observations; of "nodes" only the newest frame is stored
    KEPT = (*KEYS, "action", "step_count", *(("next", key) for key in (*KEYS, "reward", "terminated", "truncated")))

    def __init__(
        self,
        capacity: int,
        batch_size: int,
        history: int,
        n_step: int,
        gamma: float,
        device: torch.device | str = "cpu",
    ) -> None:
        self.device = torch.device(device)
        self.capacity, self.batch_size = capacity, batch_size
        self.history, self.n_step, self.gamma = history, n_step, gamma
        self._ring: dict[str, Tensor] = {}
        self._flat: dict[str, Tensor] = {}  # the same memory, rows and robots as one dimension
        self._last: dict[str, Tensor] = {}
        self._free: list[int] = []
        self._back = torch.arange(history - 1, -1, -1, device=self.device)
        self.head = self.rows = self.filled = self.robots = 0
        self.total = 0  # rows ever appended

    def _allocate(self, step: TensorDictBase) -> None:
        self.robots = step.shape[0]
        self.rows = self.capacity // self.robots
        least = self.history + self.n_step
        if self.rows < least:
            raise ConfigError(
                f"replay.buffer_size must be at least {least * self.robots} for {self.robots} robots, "
                f"a history of {self.history} and {self.n_step} steps, got {self.capacity}."
            )
        try:
            for key, values in step.items():
                self._ring[key] = lazy_zeros((self.rows, *values.shape), values.dtype, self.device)
        except (RuntimeError, MemoryError, OSError, OverflowError) as error:
            raise MemoryError(f"replay.buffer_size={self.capacity}") from error
        self._ring["last"] = torch.full((self.rows, self.robots), -1, dtype=torch.int32, device=self.device)
        self._flat = {key: values.flatten(0, 1) for key, values in self._ring.items()}
        for key in self.KEYS:
            self._last[key] = self._ring[key].new_zeros((0, *self._ring[key].shape[2:]))

    def __len__(self) -> int:
        return self.filled * self.robots

    @property
    def nbytes(self) -> int:
        """Return the memory of the stored frames (bytes)."""
        return sum(tensor.nbytes for tensor in (*self._ring.values(), *self._last.values()))

    def extend(self, collected: TensorDictBase) -> None:
        """Append ``collected``, batch size ``[robots, time]``, in the order of time."""
        collected = collected.select(*self.KEPT).to(self.device)
        following = collected["next"]
        for t in range(collected.shape[1]):
            step = TensorDict(
                {
                    "nodes": self._newest(collected["nodes"][:, t]),
                    "counters": collected["counters"][:, t],
                    "action": collected["action"][:, t],
                    "reward": following["reward"][:, t, 0],
                    "terminated": following["terminated"][:, t, 0],
                    "truncated": following["truncated"][:, t, 0],
                    # Frames of the episode before this one, as far as a stack reaches.
                    "age": collected["step_count"][:, t, 0].clamp(max=self.history - 1).to(torch.uint8),
                },
                [collected.shape[0]],
            )
            if not self._ring:
                self._allocate(step)
            self._append(step, following[:, t])

    def _newest(self, stack: Tensor) -> Tensor:
        """Return the newest frame ``[..., F]`` of a stack ``[..., H * F]``."""
        return stack[..., -(stack.shape[-1] // self.history) :]

    def _append(self, step: TensorDictBase, following: TensorDictBase) -> None:
        row, last = self.head, self._ring["last"]
        self._free += last[row][last[row] >= 0].tolist()
        for key, values in step.items():
            self._ring[key][row] = values
        last[row] = -1
        ended = torch.nonzero(step["terminated"] | step["truncated"])[:, 0]
        if len(ended):
            places = torch.tensor(self._places(len(ended)), device=self.device)
            last[row, ended] = places.to(torch.int32)
            self._last["nodes"][places] = self._newest(following["nodes"][ended])
            self._last["counters"][places] = following["counters"][ended]
        self.head = (row + 1) % self.rows
        self.filled = min(self.filled + 1, self.rows)
        self.total += 1

    def clear(self) -> None:
        """Forget every row; :attr:`total` goes on counting."""
        self.filled, self._free = 0, []
        self._last = {key: values[:0] for key, values in self._last.items()}
        if self._ring:
            self._ring["last"].fill_(-1)

    def _places(self, count: int) -> list[int]:
        size = len(self._last["nodes"])
        if len(self._free) < count:
            more = max(count, size, 64)
            for key, values in self._last.items():
                self._last[key] = torch.cat([values, values.new_zeros((more, *values.shape[1:]))])
            self._free += range(size, size + more)
        return [self._free.pop() for _ in range(count)]

    @property
    def ready(self) -> int:
        """Return the number of rows that can be drawn.

        The newest ``n_step`` lack their future (the very last even its next frame); once rows have been forgotten, the
        oldest ``history - 1`` may lack their past.
        """
        return max(0, self.filled - self.n_step - self._pastless)

    @property
    def _pastless(self) -> int:
        return self.history - 1 if self.total > self.filled else 0

    def sample(self) -> TensorDictBase:
        """Sample a batch of ``batch_size`` transitions with stacked histories uniformly.

        Raises:
            RuntimeError: If too few steps are stored to draw from.
        """
        if not self.ready:
            raise RuntimeError(f"The replay holds {self.filled} steps of each robot: too few to draw from.")
        first = self.head - self.filled + self._pastless
        steps = (first + self._draw(self.ready)) % self.rows
        return self.gather(steps, self._draw(self.robots))

    def _draw(self, below: int) -> Tensor:
        return torch.randint(below, (self.batch_size,), device=self.device)

    def gather(self, row: Tensor, robot: Tensor) -> TensorDictBase:
        """Gather the transitions of the given rows and robots, each ``[B]``; batch size ``[B]``."""
        here = row * self.robots + robot
        # The window: up to n steps, ended early by the end of the episode.
        final, reward, place = here, self._at("reward", here), self._at("last", here)
        steps, following = torch.ones_like(row), here
        for k in range(1, self.n_step):
            going = place < 0
            following = self._later(following, 1)
            reward = reward + going * self.gamma**k * self._at("reward", following)
            final, steps = torch.where(going, following, final), steps + going
            place = torch.where(going, self._at("last", following), place)

        terminated, truncated = self._at("terminated", final), self._at("truncated", final)
        after, ended = self._later(final, 1), (place >= 0)[:, None]
        next_frame = torch.where(ended[..., None], self._last_at("nodes", place), self._at("nodes", after))
        next_counters = torch.where(ended, self._last_at("counters", place), self._at("counters", after))
        done = terminated | truncated
        # Both stacks at once; the later one without its oldest frame, for which the next frame comes.
        stacks = self._stack(here if final is here else torch.cat([here, final]))
        newest = stacks[-len(here) :, ..., next_frame.shape[-1] :]
        following_td = {
            "nodes": torch.cat([newest, next_frame], dim=-1),
            "counters": next_counters,
            "reward": reward[:, None],
            "done": done[:, None],
            "terminated": terminated[:, None],
            "truncated": truncated[:, None],
        }
        batch = {
            "nodes": stacks[: len(here)],
            "counters": self._at("counters", here),
            "action": self._at("action", here),
            "next": TensorDict(following_td, [len(row)]),
        }
        if self.n_step > 1:
            batch["steps_to_next_obs"] = steps
        return TensorDict(batch, [len(row)])

    def _at(self, key: str, place: Tensor) -> Tensor:
        """Return ``key`` at places of the ring; a place is its row times the robots, plus the robot."""
        return self._flat[key].index_select(0, place)

    def _later(self, place: Tensor, rows: int) -> Tensor:
        """Return the places ``rows`` later; a negative number is earlier."""
        return (place + rows * self.robots) % (self.rows * self.robots)

    def _stack(self, place: Tensor) -> Tensor:
        return stack_frames(self._flat["nodes"], self._flat["age"], place, self._back, self.robots)

    def _last_at(self, key: str, place: Tensor) -> Tensor:
        table = self._last[key]
        if not len(table):
            return self._ring[key].new_zeros((len(place), *self._ring[key].shape[2:]))
        return table.index_select(0, place.clamp(min=0))

    def state_dict(self) -> dict[str, Any]:
        """Return everything but the rows themselves, which :meth:`rows_between` gives."""
        return {
            "total": self.total,
            "filled": self.filled,
            "robots": self.robots,
            "last": dict(self._last),
            "free": list(self._free),
        }

    def rows_between(self, start: int, stop: int) -> dict[str, Tensor]:
        """Return rows ``start`` to ``stop - 1`` of all that were ever appended, shapes ``[stop - start, robots, ...]``.

        Raises:
            ValueError: If some are no longer, or not yet, in the ring.
        """
        if not self.total - self.filled <= start <= stop <= self.total:
            raise ValueError(f"The ring holds rows {self.total - self.filled} to {self.total}, not {start} to {stop}.")
        index = torch.arange(start, stop, device=self.device) % self.rows
        return {key: values[index] for key, values in self._ring.items()}

    def load_state_dict(self, state: dict[str, Any], rows: Iterable[tuple[int, dict[str, Tensor]]]) -> None:
        """Restore the state that :meth:`state_dict` returned.

        Args:
            state: State of the buffer.
            rows: The number of the first row and the rows, in order, of every part that was kept.

        Raises:
            ValueError: If rows are missing.
        """
        self._ring, self.head, self.filled, self.total = {}, 0, int(state["filled"]), int(state["total"])
        self._last = {key: value.to(self.device) for key, value in state["last"].items()}
        self._free = list(state["free"])
        if not self.total:
            return
        self.robots = int(state["robots"])
        self.rows = self.capacity // self.robots
        self.head = self.total % self.rows
        if not self.filled:
            return
        covered = self.total - self.filled
        for start, part in rows:
            stop = start + len(part["last"])
            if start > covered or stop <= covered:
                raise ValueError(f"Row {covered} of the replay is missing; the next part has {start} to {stop}.")
            if not self._ring:
                for key, values in part.items():
                    self._ring[key] = lazy_zeros((self.rows, *values.shape[1:]), values.dtype, self.device)
                self._ring["last"].fill_(-1)
            index = torch.arange(covered, stop) % self.rows
            for key, values in part.items():
                self._ring[key][index] = values[covered - start :].to(self.device)
            covered = stop
        if covered != self.total:
            raise ValueError(f"Rows {covered} to {self.total} of the replay are missing.")
        self._flat = {key: values.flatten(0, 1) for key, values in self._ring.items()}
