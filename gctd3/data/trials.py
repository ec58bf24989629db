"""How the gaits of a warm-up are tried, and what its robots show them."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Trials:
    """Hold how gaits are tried, and which of them descend from others.

    Attributes:
        duration: Time for which a gait is tried (s).
        control_dt: Control period (s).
        mutation_share: Share of new gaits that descend from others.
        steps: Control steps of the warm-up; ``None`` for one without an end.
        limit: Control steps after which an episode ends though the robot has not fallen; ``None`` for no such limit.
        least_speed: Speed below which a gait is less fit (m/s); ``None`` for the reward alone.
        rounds: Rounds of the warm-up, equally long, each of which ends by trying the fittest few gaits again.
        from_standing: Whether a robot begins a new episode with each gait; somebody has to see to that.
    """

    duration: float
    control_dt: float
    mutation_share: float = 0.8
    steps: int | None = None
    limit: int | None = None
    least_speed: float | None = None
    rounds: int = 1
    from_standing: bool = False


@dataclass(frozen=True)
class Shown:
    """Hold what observations of robots show beside the time, as far as gaits ask for it.

    Attributes:
        command: Commanded velocity, ``[B, 3]`` (m/s, m/s, rad/s), for gaits that follow one, or the commanded height
            of jumps, ``[B, 1]`` (m).
        posture: The body's posture, ``[B, 6]`` (:class:`.Posture`), for gaits with reflexes.
        velocity: Velocity without the body's sway, ``[B, 3]`` (m/s, m/s, rad/s), by which gaits that follow a command
            are corrected; they are not where it is ``None``.
    """

    command: Tensor | None = None
    posture: Tensor | None = None
    velocity: Tensor | None = None


NOTHING = Shown()
