"""Where episodes begin: more often in those seconds of those clips that fail now and then."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shared.protocol.rates import TICK_HZ

Ints = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]

BIN_TICKS = int(TICK_HZ)
STEP = 0.1
"""How far one failure or one passage moves a rate."""
FROM_START_SHARE = 0.15


class FailureTable:
    """Failure rate of each second of each clip.

    Args:
        length: (C,) ticks of each clip. weight: (C,) of each clip in the sampling.
        floor: chance of what never fails, relative to what fails half of the time.
        tail_ticks: ticks at a clip's end in which no episode begins.

    Attributes:
        rate: (N,) of all seconds of all clips, clip after clip.
    """

    def __init__(self, length: Ints, weight: Floats, floor: float, tail_ticks: int):
        self._length, self._weight, self._floor, self._tail = length, weight, floor, tail_ticks
        self.bins = np.maximum(-(-length // BIN_TICKS), 1)
        self.first = np.concatenate([[0], np.cumsum(self.bins)[:-1]])
        self.clip = np.repeat(np.arange(len(length)), self.bins)
        self.rate = np.full(len(self.clip), 0.5)
        begin = (np.arange(len(self.clip)) - self.first[self.clip]) * BIN_TICKS
        self._usable = (begin < length[self.clip] - tail_ticks) & (length[self.clip] > tail_ticks)

    def probabilities(self) -> Floats:
        """(N,) chance of each second: f (1 - f) is largest where most is to be learnt; neither what is mastered nor
        what is still out of reach fills the batch."""
        f = self.rate
        p = self._weight[self.clip] / self.bins[self.clip] * (self._floor + 4.0 * f * (1.0 - f)) * self._usable
        return np.asarray(p / p.sum())

    def by_clip(self) -> Floats:
        """(C,) mean failure rate of each clip."""
        return np.asarray(np.add.reduceat(self.rate, self.first) / self.bins)

    def draw(self, rng: np.random.Generator, count: int) -> tuple[Ints, Ints]:
        """Clips and start ticks (count,): up to a second before the chosen one, some at the clip's very start."""
        chosen = rng.choice(len(self.rate), size=count, p=self.probabilities())
        clip = self.clip[chosen]
        begin = (chosen - self.first[clip]) * BIN_TICKS
        tick = begin + rng.integers(-BIN_TICKS, BIN_TICKS, size=count)
        tick = np.clip(tick, 0, np.maximum(self._length[clip] - self._tail - 1, 0))
        tick[rng.random(count) < FROM_START_SHARE] = 0
        return clip, tick

    def note(self, clip: int, begin_tick: int, end_tick: int, failed: bool) -> None:
        """An episode of a clip went from one tick to another, and failed there or not."""
        first = int(self.first[clip])
        last = first + min(end_tick // BIN_TICKS, int(self.bins[clip]) - 1)
        # The mistake was made before the distance showed it: the second before the last counts as failed too.
        stop = last - 1 if failed else first + min(round(end_tick / BIN_TICKS), int(self.bins[clip]))
        passed = slice(first + round(begin_tick / BIN_TICKS), max(stop, first))
        self.rate[passed] -= STEP * self.rate[passed]
        if failed:
            for place in {last, max(last - 1, first)}:
                self.rate[place] += STEP * (1.0 - self.rate[place])
