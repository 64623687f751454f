"""The rates of the system, named once, and the grid of frames on which plans start (DESIGN 2).

Physics and the log run at 120 Hz, control (the ticks that everything is counted in) at 30 Hz. A planner has any rate
that divides 120 from 5 to 60 fps. Its frame n lies at n / fps seconds since tick 0, always a sample of the log, so that
prefixes are read and never interpolated. A plan starts where a tick is a frame: at ticks divisible by
30 / gcd(30, fps), that is 3 at 20 fps.
"""

from __future__ import annotations

from math import gcd
from typing import Annotated, Final

from pydantic import AfterValidator

from shared.errors import InvalidInputError

PHYSICS_HZ: Final = 120
LOG_HZ: Final = 120
TICK_HZ: Final = 30
PLANNER_FPS: Final = 20
"""Rate of the planners that come along and of the character's own standing."""
CORPUS_FPS: Final = float(TICK_HZ)
"""Rate of the clips of a corpus: the tracker's; a planner is trained on windows of them at its own rate."""
PLANNER_RATES: Final = tuple(fps for fps in range(5, 61) if LOG_HZ % fps == 0)
LOG_RATES: Final = tuple(rate for rate in range(1, LOG_HZ + 1) if LOG_HZ % rate == 0)


def _planner_rate(fps: int) -> int:
    if fps not in PLANNER_RATES:
        raise ValueError(f"{fps} fps does not divide {LOG_HZ}; allowed: {', '.join(map(str, PLANNER_RATES))}")
    return fps


def _log_rate(rate_hz: int) -> int:
    if rate_hz not in LOG_RATES:
        raise ValueError(f"{rate_hz} Hz does not divide {LOG_HZ}; allowed: {', '.join(map(str, LOG_RATES))}")
    return rate_hz


Fps = Annotated[int, AfterValidator(_planner_rate)]
LogRate = Annotated[int, AfterValidator(_log_rate)]


def start_spacing(fps: int) -> int:
    """Ticks from one possible start of a plan at `fps` to the next: the ticks that are frames are its multiples."""
    return TICK_HZ // gcd(TICK_HZ, fps)


def first_start_by(tick: int, fps: int) -> int:
    """First tick at or after `tick` at which a plan at `fps` may start."""
    spacing = start_spacing(fps)
    return -(-tick // spacing) * spacing


def frame_of_tick(tick: int, fps: int) -> int:
    """Absolute planner frame at a tick; raises InvalidInputError (field `start_tick`) for one between two frames."""
    spacing = start_spacing(fps)
    if tick % spacing:
        raise InvalidInputError(
            f"tick {tick} lies between two frames at {fps} fps", field="start_tick", allowed=f"multiples of {spacing}"
        )
    return tick * fps // TICK_HZ


def last_frame_by(tick: int, fps: int) -> int:
    """Last absolute planner frame at or before `tick`."""
    return tick * fps // TICK_HZ
