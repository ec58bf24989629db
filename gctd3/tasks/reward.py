"""The reward: terms by name, summed in their order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from gctd3.errors import ConfigError
from gctd3.tasks import reward_terms as terms
from gctd3.tasks.terms import RewardTerm, check_terms


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
    """What a step is worth.

    Attributes:
        terms: Summands by name, in the order in which they are summed; ``None`` for one that is left out.
    """

    terms: Mapping[str, Any] = field(default_factory=paper_terms)

    def __post_init__(self) -> None:
        if not any(term is not None for term in self.terms.values()):
            raise ConfigError("terms must hold at least one term, got none.")
        object.__setattr__(self, "terms", check_terms("terms", self.terms, RewardTerm))

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Return what each term is, for files that say how something was judged."""
        return {name: {"term": type(term).__name__, **asdict(term)} for name, term in self.terms.items()}
