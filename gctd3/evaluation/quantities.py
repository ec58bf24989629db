"""The quantities of a gait: one name, one unit and one definition each, for every table that shows them."""

from __future__ import annotations

from typing import NamedTuple

TOUCHDOWNS, SINGLE = "stride_hz", "single_support_fraction"
ASYMMETRY = "asymmetry_"  # begins the key of a joint's asymmetry


class Quantity(NamedTuple):
    """Describe a quantity.

    Attributes:
        key: Key in ``evaluation.json``.
        name: Name in tables.
        unit: Unit; empty for a pure number.
        digits: Decimals in tables.
        meaning: Definition, in a few words.
    """

    key: str
    name: str
    unit: str
    digits: int
    meaning: str

    @property
    def title(self) -> str:
        """Return the name with the unit, as in ``stride time, s``."""
        return f"{self.name}, {self.unit}" if self.unit else self.name


QUANTITIES = (
    Quantity("hip_correlation", "hip correlation", "", 2, "of right and left hip angle; -1 when legs take turns"),
    Quantity("stride_frequency", "stride frequency", "Hz", 2, "one over the stride time"),
    Quantity(
        TOUCHDOWNS, "touchdown frequency", "Hz", 2, "of each foot, bounces included; conditions of trainings read it"
    ),
    Quantity("stride_time", "stride time", "s", 2, "median from a foot's touchdown to its next, bounces left out"),
    Quantity("stride_variation", "stride variation", "", 3, "standard deviation of stride times over their mean"),
    Quantity(
        "regularity", "regularity", "", 3, "autocorrelation of the joint angles after a stride; 1 repeats exactly"
    ),
    Quantity("duty_factor", "duty factor", "", 2, "contact time over stride time; above 0.5 it walks, below it runs"),
    Quantity(
        "phase_offset", "phase offset", "", 2, "when the left foot touches down in the right one's stride; ideal 0.5"
    ),
    Quantity("duty_symmetry", "duty symmetry", "%", 1, "(right - left) / mean of duty factors (Herzog 1989); ideal 0"),
    Quantity("step_symmetry", "step symmetry", "%", 1, "the same of the times from foot to foot; ideal 0"),
    Quantity("flight_fraction", "flight", "", 2, "share of time with no foot down"),
    Quantity(SINGLE, "single support", "", 2, "share of time with one foot down"),
    Quantity("double_support_fraction", "double support", "", 2, "share of time with more than one foot down"),
    Quantity("foot_clearance", "foot clearance", "m", 3, "sole above the ground in the middle of a swing"),
    Quantity("slip_speed", "slip", "m/s", 3, "mean speed over the ground of soles that are down"),
    Quantity("height_from_home", "height from standing", "", 3, "of the body on average, over its height standing"),
    Quantity("height_rms", "height RMS", "m", 3, "of the body's height about its mean"),
    Quantity("froude", "Froude number", "", 2, "v² / (g L), L the hip's height when standing"),
    Quantity("cost_of_transport", "cost of transport", "", 2, "Σ|τω|Δt / (m g d), braking costs as driving does"),
    Quantity("cost_of_transport_positive", "cost of transport, positive", "", 2, "the same of driving alone"),
    Quantity("torque_saturation", "torque saturation", "%", 1, "share of time at the servos' limit, over all servos"),
    Quantity("action_rate", "action rate", "1/s", 1, "RMS of the actions' first difference over dt"),
    Quantity("action_jerk", "action jerk", "1/s³", 0, "RMS of their third difference over dt³"),
    Quantity(
        "action_smoothness",
        "action smoothness",
        "",
        4,
        "mean of amplitude times frequency (Mysore 2021); low is smooth",
    ),
    Quantity(
        "floquet_max",
        "largest Floquet multiplier",
        "",
        2,
        "of the touchdown map, from below; under 1 is stable",
    ),
    Quantity("strides", "strides used", "", 0, "of all feet and episodes; the first two of each foot are never used"),
    Quantity("periodic_fraction", "periodic", "", 2, "share of episodes whose strides could be evaluated"),
)


def quantity(key: str) -> Quantity:
    """Return the quantity of a key, that of a joint's asymmetry too; one without unit for a key of another version."""
    for known in QUANTITIES:
        if known.key == key:
            return known
    if key.startswith(ASYMMETRY):
        joint = key.removeprefix(ASYMMETRY).replace("_", " ")
        meaning = "RMS against its mirror image half a stride later; 0 is symmetric"
        return Quantity(key, f"asymmetry, {joint}", "rad", 3, meaning)
    return Quantity(key, key.replace("_", " "), "", 3, "")
