"""What makes motion of one split: its recordings, its random numbers, and what it has made so far."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from shared.data.grounding import ground, measure
from shared.data.label import Label
from shared.data.make_paths import Source, pick
from shared.data.pieces import SHORTEST, Piece, Report, at_origin, reason_to_leave_out
from shared.data.props import Seat, Strike
from shared.data.splice import settle, stand_over_feet
from shared.data.texts import clean, sentences
from shared.motion.body import Array, mirror
from shared.protocol.rates import CORPUS_FPS as FPS


@dataclass
class Maker:
    """Makes pieces of one split from that split's recordings."""

    split: str
    rng: np.random.Generator
    report: Report
    walks: list[Source]
    jogs: list[Source]
    starts: list[tuple[Source, tuple[int, int]]]
    stops: list[tuple[Source, tuple[int, int]]]
    turns: list[tuple[Source, tuple[int, int]]]
    stands: list[Source]
    out: list[Piece] = field(default_factory=list)

    def add(
        self, kind: str, label: Label, p: Array, *sources: Source, seat: Seat | None = None,
        strike: Strike | None = None,
    ) -> None:  # fmt: skip
        """Ground a made motion, check it and keep it; what was made over given feet stands where it is."""
        if len(p) < SHORTEST:
            p = settle(p, SHORTEST - len(p), p[-1])
        final, quality = ground(p) if seat is None and strike is None else (p, measure(p, FPS))
        takes = "+".join(dict.fromkeys(s.take for s in sources))
        name = f"made/{self.split}/{kind}/{len(self.out):04d}"
        reason = reason_to_leave_out(final, quality)
        if reason:
            self.report.drop(f"{name} from {takes}", reason)
            return
        texts = tuple(clean(sentences(label.action, label.side)))
        archives = "+".join(sorted({s.source for s in sources}))
        piece = Piece(name, takes, archives, label, texts, final, True, quality, self.split, seat, strike)
        self.out.append(at_origin(piece))

    def chance(self) -> bool:
        return bool(self.rng.random() < 0.5)

    def flipped(self, source: Source) -> Source:
        """The source or its mirror image, evenly."""
        return source if self.chance() else Source(source.take, source.source, mirror(source.positions))

    def stand_pose(self) -> tuple[Source, Array]:
        """A recorded quiet pose; one in three with the relaxed arms of the standard stand."""
        source = self.flipped(pick(self.rng, self.stands))
        pose = source.positions[0]
        return source, stand_over_feet(pose) if self.rng.random() < 0.33 else pose
