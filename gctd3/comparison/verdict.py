"""The verdict in words: differences between groups as far as the intervals allow."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from gctd3.comparison.equal_time import Limit, duration, reached_by, time_limit, uneven, whole_times
from gctd3.comparison.runs import Run
from gctd3.comparison.statistics import FEW, Interval, improvement, interval
from gctd3.training.saved_configuration import CONFIG

MINUTES = "minutes_to_finish"
# Compared numbers: key, name, unit, decimals, and the words for having more of it.
COMPARED = (
    ("return_mean", "return", "", 1, "returns more"),
    ("velocity_mean", "velocity", " m/s", 3, "is faster"),
    (MINUTES, "time to the first evaluation in which all episodes finish", " min", 1, "takes longer"),
)
# Numbers compared at equal wall-clock: key, name, decimals, and the words for having more of it.
AT_LIMIT = (("return_mean", "return", 1, "returns more"), ("success_rate", "success", 2, "finishes more often"))
# Keys that make the same training slower or faster.
COMPUTING = ("threads", "env.threads", "device")
NOTHING = "no difference shown"
# Ratio of frames or updates from which trainings were not equally long; whole batches make some difference.
LONGER = 1.01
# Comparisons from which chance is worth a word: with five seeds it shows a difference in 1 of 50 of alike groups.
MANY = 5


def scores(runs: Sequence[Run], key: str) -> list[float]:
    """Return a number of each run that has it."""
    values = [run.minutes_to_finish if key == MINUTES else run.value(key) for run in runs]
    return [value for value in values if np.isfinite(value)]


@dataclass(frozen=True)
class Comparison:
    """Hold the comparison of one number between two groups of runs.

    Attributes:
        ours: Name of the one group.
        theirs: Name of the other group.
        what: Name of the number that is compared.
        finding: Conclusion from the numbers.
        numbers: The numbers themselves, as text; empty if a group lacks them.
        shown: The difference, if one is shown, as ``gctd3 returns more than td3``.
        values: Both groups' interquartile means with their intervals; ``None`` if a group lacks numbers.
        chance: Probability that a run of the one group has more than one of the other.
        unit: Unit of the number, with a space before it.
        digits: Decimals of the number.
    """

    ours: str
    theirs: str
    what: str
    finding: str
    numbers: str = ""
    shown: str | None = None
    values: tuple[Interval, Interval] | None = None
    chance: Interval | None = None
    unit: str = ""
    digits: int = 1

    @property
    def text(self) -> str:
        """Return the comparison as a sentence."""
        return f"{self.ours} and {self.theirs}, {self.what}: {self.finding}{': ' * bool(self.numbers)}{self.numbers}."


def too_few(ours: int, theirs: int) -> bool:
    """Return whether equal groups of these sizes fully separate by chance in over 5 % of cases.

    Fully separated means that all runs of one group are above all of the other. Intervals of so few runs reach from the
    lowest to the highest, so that they would not overlap then.
    """
    return 2 / math.comb(ours + theirs, ours) > 0.05


def compare(
    what: str,
    unit: str,
    digits: int,
    more: str,
    ours: tuple[str, Sequence[float]],
    theirs: tuple[str, Sequence[float]],
) -> Comparison:
    """Compare one number of two groups of runs.

    Args:
        what: Name of the number that is compared.
        unit: Unit of the number, with a space before it.
        digits: Decimals of the number.
        more: Words for having more of it, as ``returns more``.
        ours: Name and numbers of the one group.
        theirs: Name and numbers of the other group.
    """
    (name, a), (other, b) = ours, theirs
    if not a or not b:
        nobody = " and ".join(group for group, values in (ours, theirs) if not values)
        return Comparison(name, other, what, f"cannot be compared, {nobody} has no number for it")
    first, second = interval(a), interval(b)
    chance = improvement(a, b)
    numbers = f"{_interval_text(first, unit, digits, len(a))} against {_interval_text(second, unit, digits, len(b))}"
    found = partial(Comparison, values=(first, second), chance=chance, unit=unit, digits=digits)
    if len(a) < 2 or len(b) < 2:
        return found(name, other, what, f"{NOTHING}, a single seed cannot show one", numbers)
    numbers += f"; a run of {name} {more} than one of {other} with probability {chance.text(2)}"
    if too_few(len(a), len(b)):
        return found(name, other, what, f"{NOTHING}, so few seeds cannot show one", numbers)
    if first.overlaps(second):
        return found(name, other, what, f"{NOTHING}, the intervals overlap", numbers)
    high, low = (name, other) if first.value > second.value else (other, name)
    return found(name, other, what, f"{high} {more}", numbers, f"{high} {more} than {low}")


def comparisons(groups: Mapping[str, Sequence[Run]], limit: Limit | None) -> list[Comparison]:
    """Compare the first group with every other, over whole trainings and at ``limit``; no times if uneven."""
    results, timed = [], not uneven(groups)
    first, *others = groups
    for key, what, unit, digits, more in COMPARED:
        for other in others:
            pair = [(name, scores(groups[name], key)) for name in (first, other)]
            # Times of the seeds that reached the finish say little about a group in which others never did.
            if key == MINUTES and (not timed or _unfinished([first, other], groups)):
                continue
            if any(values for _, values in pair):
                results.append(compare(what, unit, digits, more, *pair))
    if limit is not None and timed:
        known = reached_by(groups, limit.seconds)
        for key, what, digits, more in AT_LIMIT:
            for other in others:
                ones = [(name, [getattr(one, key) for one in known[name]]) for name in (first, other)]
                pair = [(name, [value for value in values if np.isfinite(value)]) for name, values in ones]
                if all(values for _, values in pair):
                    results.append(compare(f"{what} after {limit.text} of training", "", digits, more, *pair))
    return results


def _unfinished(names: Iterable[str], groups: Mapping[str, Sequence[Run]]) -> list[str]:
    """Return how many seeds of each group never had an evaluation in which all episodes finish; no entry for zero."""
    never = {name: sum(not run.finished for run in groups[name]) for name in names}
    return [f"{count} of {len(groups[name])} seeds of {name}" for name, count in never.items() if count]


def verdict(groups: Mapping[str, Sequence[Run]], lost: Sequence[str] = ()) -> list[str]:
    """Return the verdict in sentences: differences shown, failures, all comparisons, and caveats.

    Args:
        groups: Runs by the name of their group.
        lost: Names of runs without a configuration.
    """
    limit = time_limit(groups)
    compared = comparisons(groups, limit)
    return [
        *_summary(compared),
        *_outcomes(groups),
        *(
            f"{name} crashed: its {CONFIG} is empty or missing, so it is in no group and has no numbers."
            for name in lost
        ),
        *_lengths(groups),
        *(one.text for one in compared),
        *_at_limit(groups, limit),
        *_caveats(groups),
    ]


def _summary(compared: Sequence[Comparison]) -> list[str]:
    compared = [one for one in compared if one.numbers]
    if not compared:
        return []
    shown = [f"{one.shown} ({one.what})" for one in compared if one.shown]
    made = f"{len(compared)} comparisons" if len(compared) > 1 else "one comparison"
    if not shown:
        return [f"In short: no difference shown in {made}."]
    chance = "; one in so many may be chance" if len(compared) >= MANY else ""
    show = f"{len(shown)} of which show{'s' * (len(shown) == 1)} a difference{chance}"
    return [f"In short: {made}, {show}: {'; '.join(shown)}."]


def _outcomes(groups: Mapping[str, Sequence[Run]]) -> list[str]:
    sentences = []
    for group, runs in groups.items():
        evaluated = [run for run in runs if run.evaluation is not None]
        walked = sum(run.value("success_rate") >= 1.0 for run in evaluated)
        lost = len(runs) - len(evaluated)
        line = f"{group}: {walked} of {len(runs)} seeds reach the finish in every episode that was evaluated"
        line += f"; {lost} failed and have no numbers" if lost else ""
        sentences.append(f"{line}{_cost(runs)}.")
    for group, runs in groups.items():
        for run in runs:
            if run.trouble:
                used = "its best policy until then counts" if run.evaluation is not None else "it has no policy"
                sentences.append(f"{group}, seed {run.seed} ({run.name}) {run.trouble.rstrip('.')}; {used}.")
    return sentences


def _cost(runs: Sequence[Run]) -> str:
    """Return ``; a whole run took 1.6 min in the median (1.5 to 1.8)``; empty without whole, timed runs."""
    times = whole_times(runs)
    if not times:
        return ""
    median, scale = duration(float(np.median(times))), 60.0 if np.median(times) >= 60.0 else 1.0
    low, high = (f"{end / scale:.1f}" for end in (min(times), max(times)))
    return (
        f"; a whole run took {median} in the median ({low} to {high})"
        if low != high
        else f"; a whole run took {median}"
    )


def _lengths(groups: Mapping[str, Sequence[Run]]) -> list[str]:
    """Return a sentence on the frames and updates of each group, if trainings were not equally long."""
    trained = {
        key: {
            group: [run.rows[-1][key] for run in runs if run.rows and key in run.rows[-1]]
            for group, runs in groups.items()
        }
        for key in ("frames", "updates")
    }
    every = [[value for values in by_group.values() for value in values] for by_group in trained.values()]
    if len(groups) < 2 or not any(values and max(values) > LONGER * min(values) for values in every):
        return []
    lengths = []
    for group in groups:
        known = [f"{_range(by_group[group])} {key}" for key, by_group in trained.items() if by_group[group]]
        lengths.append(f"{group} {' and '.join(known) or 'an unknown number of frames'}")
    return [f"Trainings were not equally long, and are compared all the same: {'; '.join(lengths)}."]


def _range(values: Sequence[float]) -> str:
    low, high = f"{min(values):,.0f}", f"{max(values):,.0f}"
    return f"{low} to {high}" if low != high else low


def _at_limit(groups: Mapping[str, Sequence[Run]], limit: Limit | None) -> list[str]:
    if len(groups) < 2:
        return []
    sentences = unlike_machines(groups)
    if limit is None:
        return [
            *sentences,
            "Nothing is compared at equal wall-clock: fewer than two groups have a run that came to its end, timed.",
        ]
    for group, known in reached_by(groups, limit.seconds).items():
        if len(known) < len(groups[group]):
            late = f"{len(groups[group]) - len(known)} of {len(groups[group])} seeds"
            sentences.append(
                f"{group}: {late} had evaluated no policy after {limit.text}; comparisons at that time leave them out."
            )
    for key in COMPUTING:
        values = {group: sorted({str(run.config.get(key)) for run in runs}) for group, runs in groups.items()}
        if len({tuple(those) for those in values.values()}) > 1:
            differing = "; ".join(f"{' or '.join(those)} in {group}" for group, those in values.items())
            sentences.append(f"Times are not like for like, {key} differs: {differing}.")
    return sentences


def unlike_machines(groups: Mapping[str, Sequence[Run]]) -> list[str]:
    """Describe why wall-clock says little about these runs; empty if no uneven times were found."""
    apart = uneven(groups)
    if not apart:
        return []
    return [
        "Wall-clock is of little worth here, and no difference is sought by it: these runs did not all have the same "
        f"machine to themselves, for {'; '.join(apart)}."
    ]


def _caveats(groups: Mapping[str, Sequence[Run]]) -> list[str]:
    sentences = []
    never = _unfinished(groups, groups)
    if never and len(groups) > 1 and not uneven(groups):
        sentences.append(
            f"The time to the finish is compared between groups that always got there; not so {', '.join(never)}."
        )
    if len(groups) < 2:
        sentences.append("There is one kind of run only, so nothing is compared.")
    if any(len(scores(runs, "return_mean")) < FEW for runs in groups.values()):
        sentences.append(f"Some have fewer than {FEW} seeds: their intervals are rougher than they look.")
    return sentences


def _interval_text(number: Interval, unit: str, digits: int, seeds: int) -> str:
    return f"{number.text(digits)}{unit} ({seeds} seed{'s' * (seeds != 1)})"
