"""A range of a character's log as a job for the renderer."""

from __future__ import annotations

import numpy as np

from shared.errors import InvalidInputError
from shared.protocol.messages import TICK_HZ, GetTicks, Render
from tracker_service.rendering.video_job import VideoJob
from tracker_service.service.hosted import HostedCharacter
from tracker_service.service.settings import TrackerServiceSettings
from tracker_service.service.worlds import scene_shapes


def video_job(hosted: HostedCharacter, message: Render, settings: TrackerServiceSettings) -> VideoJob:
    """What to draw; raises InvalidInputError for a range that has not happened yet, or is too long."""
    stop = hosted.tick + 1 if message.stop_tick is None else message.stop_tick
    if not message.start_tick < stop <= message.start_tick + settings.video_ticks:
        raise InvalidInputError(
            f"a video of ticks {message.start_tick} to {stop}",
            field="stop_tick",
            allowed=f"{message.start_tick + 1} to {message.start_tick + settings.video_ticks}",
        )
    ranges = [
        hosted.ticks(GetTicks(start_tick=first, stop_tick=min(first + 10_000, stop)))
        for first in range(message.start_tick, stop, 10_000)
    ]
    scene = hosted.simulation.scene.scene
    fps = settings.video_fps
    every = slice(None, None, TICK_HZ // fps)
    return VideoJob(
        body_pos_w_m=np.concatenate([part.body_pos_w_m for part in ranges])[every],
        body_quat_w=np.concatenate([part.body_quat_w for part in ranges])[every],
        object_pose_w=np.concatenate([part.object_pose_w for part in ranges])[every],
        fps=fps,
        objects=tuple(ranges[-1].objects),
        shapes=scene_shapes(scene),
        start_tick=message.start_tick,
        captions=tuple(message.captions),
        width=message.width,
        height=message.height,
        camera=message.camera,
        skeleton_id=hosted.skeleton.id,
    )
