"""The reward: a sum of named terms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from gctd3.tasks import reward_terms as terms
from gctd3.tasks.term_checks import check_terms
from gctd3.tasks.terms import RewardTerm


def paper_terms() -> dict[str, RewardTerm]:
    """Return the terms of the paper's Table 3 and of the training script that its authors released."""
    return {
        "velocity": terms.ForwardVelocity(),
        "progress": terms.Progress(),
        "height": terms.BodyHeight(),
        "flight": terms.Flight(),
        "living": terms.Living(),
        "fall": terms.Ended(),
        "long_contact": terms.Ended(weight=-1.0, by="long_contact"),
        "stuck_hip": terms.Ended(weight=-0.5, by="stuck_hip"),
    }


@dataclass(frozen=True)
class Reward:
    """Hold the terms of the reward.

    Attributes:
        terms: Terms by name, in the order of their sum; ``None`` leaves one out. A task of another library has its
            own reward, and none here.
    """

    terms: Mapping[str, Any] = field(default_factory=paper_terms)

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms", check_terms("terms", self.terms, RewardTerm))

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Return the class and the settings of each term, for files that record the reward of an evaluation."""
        return {name: {"term": type(term).__name__, **asdict(term)} for name, term in self.terms.items()}
