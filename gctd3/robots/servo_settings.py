"""Settings of a joint's position servo."""

from __future__ import annotations

from dataclasses import dataclass, fields

from gctd3.errors import ConfigError


@dataclass(frozen=True)
class ServoSettings:
    """Hold the settings of a joint's position servo; ``None`` takes the value of the file, else a derived one.

    Attributes:
        stiffness: Torque per radian between the desired angle and the joint's (N m/rad).
        damping: Torque per unit of the joint's velocity (N m s/rad).
        effort: Largest torque (N m).
        armature: Inertia of the rotor, reflected to the joint (kg m^2).
        velocity_limit: Velocity at which no torque is left (rad/s); it is noted but not simulated, as MuJoCo's
            position servos have no such limit.
    """

    stiffness: float | None = None
    damping: float | None = None
    effort: float | None = None
    armature: float | None = None
    velocity_limit: float | None = None

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            least = entry.name in ("damping", "armature")
            if value is not None and not (value >= 0 if least else value > 0):
                raise ConfigError(f"{entry.name} must be {'at least' if least else 'above'} 0, got {value}.")
