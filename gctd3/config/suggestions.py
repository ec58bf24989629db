"""Suggest a known key for an unknown one: by its letters, and by what the keys mean. Light."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping

_ALIKE, _SIMILAR = 0.8, 0.6  # ratios of difflib, of keys that differ by a slip and of keys that resemble each other
_WORD = re.compile(r"[a-z]+(?:_[a-z]+)*")


def nearest(key: str, known: Mapping[str, str]) -> str:
    """Return ``" Did you mean ...?"`` if a known key is near to ``key`` by its letters or its meaning, else nothing.

    Args:
        key: The unknown key, dotted.
        known: Meaning of every known key, dotted.
    """
    parent, _, name = key.rpartition(".")
    beside = {known_key.rpartition(".")[2]: known_key for known_key in known if known_key.rpartition(".")[0] == parent}
    elsewhere = {known_key.rpartition(".")[2]: known_key for known_key in known}
    suggestion = (
        _by_letters(name, beside, _ALIKE)
        or _by_words(name, known, parent)
        or _by_letters(name, elsewhere, _ALIKE)
        or _by_letters(name, beside, _SIMILAR)
    )
    return f" Did you mean {suggestion!r}?" if suggestion else ""


def _by_letters(name: str, known: Mapping[str, str], ratio: float) -> str | None:
    """Find the key whose last part, by which ``known`` lists the keys, is spelt most like ``name``."""
    return next((known[close] for close in difflib.get_close_matches(name, known, n=1, cutoff=ratio)), None)


def _by_words(name: str, known: Mapping[str, str], parent: str) -> str | None:
    """Find the key below ``parent`` with all words of ``name``: beside it, in its name, early in its meaning."""
    asked = [_stem(word) for word in name.split("_")]

    def rank(candidate: str) -> tuple[bool, int, int, int] | None:
        place, _, own = candidate.rpartition(".")
        named = [_stem(word) for word in own.split("_")]
        described = [_stem(word) for word in _WORD.findall(known[candidate].lower().replace("-", ""))]
        below = not parent or f"{place}.".startswith(f"{parent}.")
        if not below or not all(word in named or word in described for word in asked):
            return None
        at = min((described.index(word) for word in asked if word in described), default=len(described))
        shared = sum(word in named for word in asked)
        # Of names with the same words of it, the one with the fewest others.
        return place != parent, -shared, len(named) if shared else 0, at

    ranks = {candidate: order for candidate in known if (order := rank(candidate)) is not None}
    return min(ranks, key=lambda candidate: ranks[candidate]) if ranks else None


def _stem(word: str) -> str:
    return word.removesuffix("s")
