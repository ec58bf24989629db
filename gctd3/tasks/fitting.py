"""Which terms of a task and of its reward apply to a robot."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from gctd3.errors import ConfigError, suggest
from gctd3.tasks.features import NodeFeature
from gctd3.tasks.term_checks import called
from gctd3.tasks.terms import RobotFacts


def fitting(where: str, terms: Mapping[str, Any], facts: RobotFacts) -> dict[str, Any]:
    """Return the terms by name that are not ``None`` and apply to a robot.

    Args:
        where: Key of the terms, for messages.
        terms: Terms by name; ``None`` leaves one out.
        facts: Facts of the robot.

    Raises:
        TermError: If a term raises an error of its own.
    """
    given = {name: term for name, term in terms.items() if term is not None}
    return {n: term for n, term in given.items() if called(f"{where}.{n}", term.applies, facts)}


def fitting_rewards(
    terms: Mapping[str, Any], facts: RobotFacts, known: Mapping[str, Any], kept: Collection[str]
) -> dict[str, Any]:
    """Return the reward terms that apply, without those that read a termination which the task leaves out.

    Args:
        terms: Terms of the reward by name.
        facts: Facts of the robot.
        known: Terminations of the task by name, with those that it leaves out.
        kept: Names of those that apply.

    Raises:
        ConfigError: If a term reads a termination that the task does not have.
    """
    fit = fitting("reward.terms", terms, facts)
    for name, term in fit.items():
        for end in term.reads():
            if end not in known:
                raise ConfigError(
                    f"reward.terms.{name} reads the termination {end!r}, which the task does not have."
                    f"{suggest(end, known)} Its terminations: {', '.join(known)}."
                )
    return {n: term for n, term in fit.items() if all(end in kept for end in term.reads())}


def named(key: str, terms: Mapping[str, Any]) -> dict[str, Any]:
    """Return terms by the whole names of their keys, for messages."""
    return {f"{key}.{name}": term for name, term in terms.items()}


def check_feature(where: str, feature: NodeFeature, facts: RobotFacts) -> None:
    """Raise a :class:`.ConfigError` that names the feature if it does not suit a robot."""
    try:
        called(where, feature.check, facts)
    except ConfigError as error:
        raise ConfigError(f"{where}.{error}") from error
