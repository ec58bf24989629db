"""The numbers of the walking task: what its reward weighs and when its episodes end.

Source: Phan Bui et al. 2022, Table 3, and the training script that the paper's authors released; which number has which
source stands beside it in ``conf/reward/paper.yaml`` and ``conf/env/walk.yaml``.
"""

from __future__ import annotations

from dataclasses import dataclass

from gctd3.errors import ConfigError, check_between


@dataclass(frozen=True)
class Reward:
    """Weights of the reward; each is positive for a bonus or a punishment of the size that its name says.

    Attributes:
        target_velocity: Forward velocity beyond which the bonus no longer grows (m/s).
        progress: Bonus per metre gained over the last ``progress_steps`` steps (1/m).
        progress_steps: ``h`` (control steps).
        height: ``c1``, punishment per metre between body and its target height, in each stacked frame (1/m).
        height_single: Target height with one foot down (m from standing).
        height_double: Target height with both feet down (m from standing).
        frames: Stacked frames over which height and flight are summed.
        flight: Punishment for each stacked frame with no foot down.
        flight_free: Stacked frames with no foot down that cost nothing.
        living: Punishment for each step.
        fall: Punishment for falling.
        long_contact: Punishment for a foot that stays down too long.
        stuck_hip: Punishment for a hip that stays on one side too long.
        antiphase: Shaping: punishment per radian of the sum of the hip angles of a left and a right leg (1/rad).
        single_support: Shaping: bonus for each step with exactly one foot down.
        overspeed: Shaping: punishment per m/s above ``overspeed_from`` (s/m).
        overspeed_from: Forward velocity from which ``overspeed`` counts (m/s).
        short_swing: Shaping: punishment at a foot's touchdown per second that it was less than ``swing_least`` in the
            air (1/s); after ``feet_air_time`` of Rudin et al. 2022 (arXiv:2109.11978), which pays for longer times.
        long_swing: Shaping: the same per second that it was more than ``swing_most`` in the air (1/s).
        swing_least: Shortest time in the air that costs nothing (s).
        swing_most: Longest time in the air that costs nothing (s).
        tilt: Shaping: punishment per radian between the body's vertical and the world's (1/rad).
        heading: Shaping, for a base that can turn: punishment per radian off the forward axis (1/rad).
        off_line: Shaping, for a base that can move sideways: punishment per metre off the straight line (1/m).
    """

    target_velocity: float = 0.9
    progress: float = 0.2
    progress_steps: int = 5
    height: float = 0.005
    height_single: float = -0.010
    height_double: float = -0.025
    frames: int = 5
    flight: float = 0.01
    flight_free: int = 0
    living: float = 0.1
    fall: float = 10.0
    long_contact: float = 1.0
    stuck_hip: float = 0.5
    antiphase: float = 0.0
    single_support: float = 0.0
    overspeed: float = 0.0
    overspeed_from: float = 1.2
    short_swing: float = 0.0
    long_swing: float = 0.0
    swing_least: float = 0.3
    swing_most: float = 0.4
    tilt: float = 0.0
    heading: float = 0.0
    off_line: float = 0.0

    def __post_init__(self) -> None:
        check_between(self, 1, 1000, "progress_steps", "frames")
        check_between(self, 0, 1000, "flight_free")
        if not 0 <= self.swing_least <= self.swing_most:
            raise ConfigError(
                "swing_least must be at least 0 s and at most swing_most, "
                f"got {self.swing_least} and {self.swing_most}."
            )


@dataclass(frozen=True)
class Endings:
    """When an episode ends; ``finish`` and ``time_limit`` truncate it (its value is bootstrapped), all else terminates.

    Attributes:
        fall_height: Body height below which the robot has fallen (m from standing).
        fall_tilt: Angle between the body's vertical and the world's above which it has fallen (rad); ``None`` for any.
            A boom holds the body upright.
        contact_steps: Steps that a foot may stay down; ``None`` for any number.
        hip_steps: Steps that a hip's angle may keep its sign; ``None`` for any number.
        finish: Distance at which the episode is won (m).
        time_limit: Steps after which it is cut off.
    """

    fall_height: float = -0.1
    contact_steps: int | None = 40
    hip_steps: int | None = 50
    finish: float = 15.0
    time_limit: int = 1600
    fall_tilt: float | None = 0.8

    def __post_init__(self) -> None:
        check_between(self, 1, 10**9, "contact_steps", "hip_steps", "time_limit")
        if self.fall_tilt is not None and not self.fall_tilt > 0:
            raise ConfigError(f"fall_tilt must be an angle above 0 rad, or null, got {self.fall_tilt}.")
        if not self.finish > 0:
            raise ConfigError(f"finish must be a distance above 0 m, got {self.finish}.")
