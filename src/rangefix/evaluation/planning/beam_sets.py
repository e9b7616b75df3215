"""Sets of beams that are chosen before any is read: greedy, bettered by exchange, or the best of all sets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, combinations
from math import comb

import numpy as np

from ...arrays import IntArray
from ..seeds import stream
from .candidates import candidates_near, coarse_candidates, square_candidates
from .cells import Cells
from .objective import Objective
from .time_left import TimeLeft

FIRST_TRUTHS = 16  # with which many candidates are compared, and by which more are added
FINE_PLACES = 12  # of them, about which all are
SECTORS, FINALISTS = 40, 20  # whose best candidates, and how many of these, meet more truths: for rare modes
CLEARLY = 3.0  # standard errors of the difference on the same truths
WORTH = 0.002  # of the criterion: a difference that does not matter
PASSES = 3  # of exchange over all beams
MOST_SETS = 2000  # of beams, in an exhaustive search
FINAL_SETS = 10  # the best of them, which are compared by many truths
FEW_SETS = 60  # all of which exchange compares by many truths, which takes about as long as its own search
STARTS, ROUGH_TRUTHS = 24, 400  # random sets, which are bettered by a rough guess at so many truths
COMPARED, MORE_TRUTHS = 8, 1600  # the best on which they end; by so many they are bettered again
MOST_POLISHED = 9  # exchanges by many truths, or as many as there are beams
MOST_CHOICES = 2 + MOST_POLISHED  # with those between sets
POLISHING, NEAR = 5, 8  # candidates of each beam that are tried over many truths, and how far about the best
Tell = Callable[[str], None]


@dataclass(frozen=True)
class BeamSets:
    """Sets of candidates, by their places among all.

    Args:
        objective: What is made as small as possible.
        tell: Told what is being done.
        time: Knows how many choices there are, and tells how long they go on.
    """

    objective: Objective
    tell: Tell
    time: TimeLeft = field(default_factory=TimeLeft)

    def greedy(self, beams: int) -> list[int]:
        """So many candidates, one after the other, each the best beside those before it."""
        chosen: list[int] = []
        for count in range(beams):
            text = f"choosing beam {count + 1} of {beams}"
            self.tell(self.time.told(text))
            if count == 0:
                chosen.append(int(np.argmin(self.objective.first)))
                self.time.begin(self.time.least, self.time.most)  # the first beam tells nothing of the others
            else:
                chosen.append(self._best(chosen, text=text))
        return chosen

    def exchanged(self, chosen: list[int]) -> list[int]:
        """A set that no exchange of one beam betters, begun with this one and, where it can be, with others.

        Where sets can be compared over many truths, they are, all of them if they are few. Otherwise
        another candidate is put in the place of each beam in turn, where that is better on fresh truths.
        """
        least = self.objective.mean_after(chosen)
        if least is not None:
            count, beams = len(self.objective.candidates), len(chosen)
            if comb(count, beams) <= FEW_SETS:
                self.time.expect(1, 1)
                return self._ordered(self._best_of(list(combinations(range(count), beams)), chosen, least)[0])
            return self._ordered(self._polished(*self._best_of_many(chosen, least)))
        self.time.expect(len(chosen), PASSES * len(chosen))
        for turn in range(PASSES):
            before = list(chosen)
            for place in range(len(chosen)):
                text = f"exchange {turn + 1}: beam {place + 1} of {len(chosen)}"
                self.tell(self.time.told(text))
                others = chosen[:place] + chosen[place + 1 :]
                other = self._best(others, chosen[place], text)
                if other == chosen[place]:
                    continue
                if self.objective.is_better(others, other, chosen[place], f"check {turn} {place}"):
                    chosen = [*others[:place], other, *others[place:]]
            if chosen == before:
                break
        return self._ordered(chosen)

    def _best_of_many(self, chosen: list[int], least: float) -> tuple[list[int], float]:
        """The best of a set and of those that exchange leads to from others, with the criterion after it.

        Where no exchange of one beam betters a set, one that differs in all of them may be far better yet. So
        many are bettered by a rough guess, which is quick; of the sets on which they end the best are
        compared over many truths.

        Args:
            chosen: The set.
            least: The criterion after it, over many truths.
        """
        beams = len(chosen)
        self.time.expect(2 + beams, max(MOST_CHOICES, 2 + beams))
        coarse = coarse_candidates(len(self.objective.candidates))
        places = np.unique(np.concatenate([coarse, self._square, chosen]))
        rng = stream(self.objective.seed, "plan starts", 0)
        starts = [np.searchsorted(places, chosen).tolist()]
        starts += [rng.choice(len(places), beams, replace=False).tolist() for _ in range(STARTS)]
        ends = self._ends(starts, places, ROUGH_TRUTHS, "exchange from many sets")
        ends = self._ends(ends[:COMPARED], places, MORE_TRUTHS, "exchange from the best of them")
        self.time.made()
        return self._best_of([places[end].tolist() for end in ends], chosen, least)

    def _best_of(
        self, sets: Sequence[Sequence[int]], chosen: list[int], least: float
    ) -> tuple[list[int], float]:
        """The best of a set, after which the criterion is `least`, and of others, by many truths."""
        for number, another in enumerate(sets):
            text = f"comparing sets by many truths: {number + 1} of {len(sets)}"
            self.tell(self.time.told(text))
            mean = self.objective.mean_after(another, least)
            if mean is not None and mean < least:
                chosen, least = list(another), mean
        self.time.made()
        return chosen, least

    def _ends(self, starts: list[list[int]], places: IntArray, truths: int, text: str) -> list[list[int]]:
        """The different sets to which exchange leads from some by a rough guess, the best first.

        Args:
            starts: Sets of some candidates, by their places among these; so are those that are found.
            places: Of these candidates among all.
            truths: At which it is guessed.
            text: What is being done, in words.
        """
        rough = self.objective.rough(places.tolist(), truths)
        ends: dict[tuple[int, ...], float] = {}
        for number, start in enumerate(starts):
            self.tell(self.time.told(f"{text}: {number + 1} of {len(starts)}"))
            found, value = rough.bettered(start, WORTH)
            ends[tuple(sorted(found))] = value
        return [list(end) for end in sorted(ends, key=lambda each: ends[each])]

    def _polished(self, chosen: list[int], least: float) -> list[int]:
        """Put another candidate in the place of each beam where that is better over many truths.

        Beams that leave two places open once in a hundred times are often the best over few truths, all of
        them: those that meet a wall askew tell more of it than square ones, until they meet another.

        Args:
            chosen: The beams.
            least: The criterion after them, over many truths.
        """
        kept = 0  # beams in a row
        for number in range(max(MOST_POLISHED, len(chosen))):
            place = number % len(chosen)
            text = f"exchange by many truths: beam {place + 1} of {len(chosen)}"
            self.tell(self.time.told(text))
            others, mine = chosen[:place] + chosen[place + 1 :], chosen[place]
            tried = [*self._finalists(others, text)[:POLISHING].tolist(), *self._square.tolist()]
            mine, least = self._better(others, mine, tried, least)
            step = NEAR
            while step:
                mine, least = self._better(others, mine, [mine - step, mine + step], least)
                step //= 2
            self.time.made()
            kept = kept + 1 if mine == chosen[place] else 0
            chosen = [*others[:place], mine, *others[place:]]
            if kept == len(chosen):
                break
        return chosen

    def _better(self, others: list[int], mine: int, tried: Sequence[int], least: float) -> tuple[int, float]:
        """Which of some candidates is the best beside others over many truths, with the criterion then.

        Args:
            others: The other beams.
            mine: What is taken unless another is better by more than WORTH.
            tried: Places of candidates; those that are none, or taken, are passed over.
            least: The criterion with `mine`.
        """
        best, bar = mine, least * (1 - WORTH)
        for other in tried:
            if not 0 <= other < len(self.objective.candidates) or other in (*others, mine):
                continue
            mean = self.objective.mean_after([*others, other], bar)
            if mean is not None and mean < bar:
                best, bar = other, mean
        return best, bar if best != mine else least

    def are_few(self, beams: int) -> bool:
        """Whether all sets of so many take about as long as exchange among them, which may miss the best.

        Never where sets can be compared over many truths: exchange begins with many of them there.
        """
        count = len(self.objective.candidates)
        return comb(count - 1, beams - 1) <= (1 + PASSES) * beams and not self.objective.compares_sets

    def exhaustive(self, beams: int) -> list[int]:
        """The best of all sets of so many candidates.

        Raises:
            ValueError: If there are too many sets.
        """
        count = len(self.objective.candidates)
        if comb(count, beams) > MOST_SETS:
            raise ValueError(
                f"{comb(count, beams)} sets of {beams} beams of {count} candidates are more than {MOST_SETS}:"
                " name fewer candidates, or choose by exchange"
            )
        if beams == 1:
            return self.greedy(1)
        sizes = range(1 if self.objective.adds_up else beams - 1, beams)
        sets = sum(comb(count - 1, size) for size in sizes)
        self.time.begin(sets + beams, sets + max(MOST_POLISHED, beams))
        alone = self.objective.values(self.objective.prior) if self.objective.adds_up else np.zeros(count)
        known: dict[tuple[int, ...], float] = {(each,): float(alone[each]) for each in range(count)}
        for others in chain.from_iterable(combinations(range(count - 1), size) for size in sizes):
            text = f"sets with candidates {', '.join(str(each + 1) for each in others)}"
            self.tell(self.time.told(text))
            last = list(range(others[-1] + 1, count))
            beliefs = self.objective.beliefs(others, 0, self.objective.truths, "choice")
            values = np.mean([self.objective.values(belief, last) for belief in beliefs], axis=0)
            before = known[others] if self.objective.adds_up else 0.0
            known |= {
                (*others, each): before + float(value) for value, each in zip(values, last, strict=True)
            }
            self.time.made()
        tried = sorted((value, chosen) for chosen, value in known.items() if len(chosen) == beams)
        best = [list(chosen) for _, chosen in tried[:FINAL_SETS]]
        means = [self.objective.mean_after(chosen) for chosen in best]
        first = int(np.argmin([np.inf if mean is None else mean for mean in means]))
        least = means[first]
        return self._ordered(best[first] if least is None else self._polished(best[first], least))

    def _ordered(self, chosen: list[int]) -> list[int]:
        """A set of beams in the order in which each brings most."""
        first = min(chosen, key=lambda each: float(self.objective.first[each]))
        ordered, left = [first], [each for each in chosen if each != first]
        while len(left) > 1:
            beliefs = self.objective.beliefs(ordered, 0, FIRST_TRUTHS, "order")
            brought = np.mean([self.objective.values(belief, left) for belief in beliefs], axis=0)
            ordered.append(left.pop(int(np.argmin(brought))))
        return ordered + left

    @cached_property
    def _square(self) -> IntArray:
        """The candidates that meet walls squarely; the heading is known."""
        problem, sensor = self.objective.problem, self.objective.sensor
        pose = problem.space.poses(problem.prior.mean)
        return square_candidates(sensor, float(sensor.mount.laser_poses(pose)[2]))

    @cached_property
    def _best_known(self) -> dict[frozenset[int], dict[int | None, int]]:
        """What `_best` has found, by the other beams, and then by what was to be taken instead."""
        return {}

    @cached_property
    def _finalists_known(self) -> dict[frozenset[int], IntArray]:
        """What `_finalists` has found."""
        return {}

    def _best(self, chosen: Sequence[int], instead: int | None = None, text: str = "") -> int:
        """The candidate that brings most beside others, or one that brings hardly less.

        Of the best of each sector on a few truths those that are not clearly worse meet more. The truths are
        the same whatever is chosen.

        Args:
            chosen: The others.
            instead: What is taken unless another is better by more than WORTH.
            text: What is being done, in words.
        """
        known = self._best_known.setdefault(frozenset(chosen), {})
        if instead is not None and instead in known.values():
            known[instead] = instead  # it was best already, on the same truths: it stays
        searched = instead not in known
        if searched:
            known[instead] = self._searched(chosen, instead, text)
        self.time.made(searched)
        return known[instead]

    def _searched(self, chosen: Sequence[int], instead: int | None, text: str) -> int:
        """What `_best` answers, worked out anew."""
        short = self._finalists(chosen, text)
        if instead is not None and instead not in short:
            short = np.append(short, instead)
        return self._race(chosen, self._first_beliefs(chosen), short, instead)

    def _first_beliefs(self, chosen: Sequence[int]) -> list[Cells]:
        """What is believed after some beams, for a few truths; those that were asked for last are kept."""
        key = frozenset(chosen)
        if key not in self._beliefs_known:
            first = min(FIRST_TRUTHS, self.objective.truths)
            self._beliefs_known.clear()
            self._beliefs_known[key] = self.objective.beliefs(chosen, 0, first, "choice")
        return self._beliefs_known[key]

    @cached_property
    def _beliefs_known(self) -> dict[frozenset[int], list[Cells]]:
        """The last of `_first_beliefs`."""
        return {}

    def _finalists(self, chosen: Sequence[int], text: str) -> IntArray:
        """The best candidates of some sectors beside others, on a few truths, the best of all first.

        Some candidates are looked at, and then those about the best of these.

        Args:
            chosen: The others.
            text: What is being done, in words.
        """
        known, key = self._finalists_known, frozenset(chosen)
        if key in known:
            return known[key]
        beliefs, count = self._first_beliefs(chosen), len(self.objective.candidates)
        found, coarse = np.full(count, np.inf), coarse_candidates(count)
        found[coarse] = self.objective.summed(beliefs, coarse.tolist())
        if self.time.guess():
            self.tell(self.time.told(text))
        if len(coarse) < count:
            near = candidates_near(coarse, found[coarse], FINE_PLACES, count)
            found[near] = self.objective.summed(beliefs, near.tolist())
        found[list(chosen)] = np.inf
        sectors = np.array_split(np.arange(count), min(SECTORS, count))
        short = np.array([sector[np.argmin(found[sector])] for sector in sectors])
        short = short[np.isfinite(found[short])]
        known[key] = short[np.argsort(found[short])[:FINALISTS]]
        return known[key]

    def _race(
        self, chosen: Sequence[int], beliefs: list[Cells], finalists: IntArray, instead: int | None
    ) -> int:
        """The best of some candidates; ever more truths decide between those that are not clearly worse."""
        values = np.array([self.objective.values(belief, finalists.tolist()) for belief in beliefs])
        while len(values) < self.objective.truths:
            best = int(values.mean(axis=0).argmin())
            behind = values - values[:, [best]]
            sure = behind.std(axis=0, ddof=1) / np.sqrt(len(values))
            slack = WORTH * abs(values[:, best].mean())
            left = behind.mean(axis=0) <= CLEARLY * sure + slack
            left |= finalists == (-1 if instead is None else instead)
            finalists, values = finalists[left], values[:, left]
            if left.sum() == 1 or (behind.mean(axis=0) + CLEARLY * sure <= slack)[left].all():
                break
            end = min(len(values) + FIRST_TRUTHS, self.objective.truths)
            more = self.objective.beliefs(chosen, len(values), end, "choice")
            found = [self.objective.values(belief, finalists.tolist()) for belief in more]
            values = np.concatenate([values, found])
        means = values.mean(axis=0)
        best = int(means.argmin())
        if instead in finalists:
            own = int(np.flatnonzero(finalists == instead)[0])
            best = own if means[own] <= means[best] + WORTH * abs(means[best]) else best
        return int(finalists[best])
