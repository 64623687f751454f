"""What the tracker service can be told."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

from pydantic import Field, field_validator, model_validator
from pydantic_settings import SettingsConfigDict

from shared.protocol.security import check_bind
from shared.settings import Names, ServiceSettings

Count = Annotated[int, Field(ge=1)]


class TrackerServiceSettings(ServiceSettings):
    """Settings of the tracker service; environment prefix MOTIONLOOP_TRACKER_.

    Attributes:
        state_endpoint: where state frames are published.
        trackers: names of the plug-ins to offer; empty for all there are.
        default_tracker: the one used where none is named; empty for the first of learned, pd, or what there is.
        weights: policy of `learned` in place of the one that comes with the package.
        scenes: folder of scenes of one's own (YAML), looked at before those of the package.
        max_characters: more are refused as overloaded.
        spool_dir: folder for recordings that leave memory and for dumps of failed physics; a temporary one, removed at
            the end (dumps stay), by default.
        chunk_samples, memory_chunks: 120 Hz samples in one piece of a recording, and pieces held in memory.
        late_ticks: a plan this many ticks late, or later, is dropped.
        max_ahead_ticks: how far in the future a plan may start.
        reach_m: how far from the character a plan may begin; it may go on at `plan_speed_mps`.
        joint_speed_mps: no joint of a plan may be faster.
        impulse_limit_ns: no impulse may be stronger.
        catch_up_ticks: a realtime clock further behind than this skips ticks.
        video_fps: frames a second of videos; fewer are made quicker.
        video_timeout_s: for one video.
        video_ticks: the longest range of one video.
    """

    model_config = SettingsConfigDict(env_prefix="MOTIONLOOP_TRACKER_")

    endpoint: str = "tcp://127.0.0.1:5602"
    state_endpoint: str = "tcp://127.0.0.1:0"
    trackers: Names = ()
    default_tracker: str = ""
    weights: Path | None = None
    scenes: Path | None = None
    max_characters: Annotated[int, Field(ge=1, le=1024)] = 32
    spool_dir: Path | None = None
    chunk_samples: Annotated[int, Field(ge=2, le=36_000)] = 1200
    memory_chunks: Count = 6
    late_ticks: Count = 9
    max_ahead_ticks: Count = 90
    reach_m: Annotated[float, Field(gt=0)] = 5.0
    plan_speed_mps: Annotated[float, Field(gt=0)] = 12.0
    joint_speed_mps: Annotated[float, Field(gt=0)] = 30.0
    impulse_limit_ns: Annotated[float, Field(gt=0)] = 1000.0
    catch_up_ticks: Count = 6
    video_fps: Annotated[int, Field(ge=10, le=30)] = 15
    video_timeout_s: Annotated[float, Field(gt=0)] = 3600.0
    video_ticks: Annotated[int, Field(ge=1)] = 36_000

    @field_validator("video_fps")
    @classmethod
    def _divides_the_ticks(cls, value: int) -> int:
        if value not in (10, 15, 30):
            raise ValueError(f"got {value}; allowed: 10, 15, 30")
        return value

    @model_validator(mode="after")
    def _safe_to_publish(self) -> TrackerServiceSettings:
        check_bind(self.state_endpoint, self.curve_keys())
        return self


def dump_folder(settings: TrackerServiceSettings) -> Path:
    """Where failed states are written."""
    base = settings.spool_dir if settings.spool_dir is not None else Path(tempfile.gettempdir())
    return base / "motionloop-dumps"
