"""Where episodes begin: more often in those seconds of those clips that fail now and then."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from shared.protocol.rates import TICK_HZ

Ints = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]

BIN_TICKS = int(TICK_HZ)
STEP = 0.1
"""How far one failure or one passage moves a rate."""
KIN_STEP, KIN_VISITS, KIN_SECONDS = 0.02, 4.0, 8
"""How far one moves the rate of all clips of its kin in that second of theirs (all later ones together), and how many
visits of a clip's own weigh as much as that: a corpus has more seconds than a short training has episodes."""
OUT_OF_REACH = 0.5
"""Chance of what always fails, relative to what fails half of the time."""
FROM_START_SHARE = 0.15


def kin_of(behaviours: Sequence[str], names: Sequence[str]) -> list[str]:
    """For each clip what it has in common with those that fail as it does: its behaviour and where it comes from."""
    return [
        f"{behaviour}|{name.rsplit('/', 1)[0] if '/' in name else name.split('_')[0]}"
        for behaviour, name in zip(behaviours, names, strict=True)
    ]


class FailureTable:
    """Failure rate of each second of each clip.

    Args:
        length: (C,) ticks of each clip. weight: (C,) of each clip in the sampling.
        floor: chance of what never fails, relative to what fails half of the time.
        tail_ticks: ticks at a clip's end in which no episode begins.
        kin: (C,) of `kin_of`; without, clips have nothing in common.

    Attributes:
        rate: (N,) of all seconds of all clips, clip after clip, from a clip's own episodes. visits: (N,) how many.
        kin_rate: (G,) of the first seconds of all kin, kin after kin. kin_names: theirs.
    """

    def __init__(self, length: Ints, weight: Floats, floor: float, tail_ticks: int, kin: Sequence[str] | None = None):
        self._length, self._weight, self._floor, self._tail = length, weight, floor, tail_ticks
        self.bins = np.maximum(-(-length // BIN_TICKS), 1)
        self.first = np.concatenate([[0], np.cumsum(self.bins)[:-1]])
        self.clip = np.repeat(np.arange(len(length)), self.bins)
        self.rate = np.full(len(self.clip), 0.5)
        self.visits = np.zeros(len(self.clip))
        second = np.arange(len(self.clip)) - self.first[self.clip]
        self.kin_names, of = np.unique(
            [str(c) for c in range(len(length))] if kin is None else kin, return_inverse=True
        )
        self.kin_rate = np.full(len(self.kin_names) * KIN_SECONDS, 0.5)
        self._kin = of[self.clip] * KIN_SECONDS + np.minimum(second, KIN_SECONDS - 1)
        begin = second * BIN_TICKS
        self._usable = (begin < length[self.clip] - tail_ticks) & (length[self.clip] > tail_ticks)

    def estimate(self) -> Floats:
        """(N,) failure rate of each second: its own, and its kin's as long as it was seldom met."""
        own = self.visits / (self.visits + KIN_VISITS)
        return np.asarray(own * self.rate + (1.0 - own) * self.kin_rate[self._kin])

    def probabilities(self) -> Floats:
        """(N,) chance of each second: f (1 - f) is largest where most is to be learnt; what is mastered does not fill
        the batch, and what is still out of reach only by half."""
        f = self.estimate()
        worth = 4.0 * f * (1.0 - f)
        worth = np.where(f > 0.5, OUT_OF_REACH + (1.0 - OUT_OF_REACH) * worth, worth)
        p = self._weight[self.clip] / self.bins[self.clip] * (self._floor + worth) * self._usable
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
        self._move(np.arange(passed.start, passed.stop), 0.0)
        if failed:
            self._move(np.unique([last, max(last - 1, first)]), 1.0)

    def _move(self, places: Ints, toward: float) -> None:
        self.rate[places] += STEP * (toward - self.rate[places])
        self.visits[places] += 1.0
        kin = np.unique(self._kin[places])
        self.kin_rate[kin] += KIN_STEP * (toward - self.kin_rate[kin])
