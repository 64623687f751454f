"""Numbers of the environments that tracking is trained in."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class EnvSettings(BaseModel):
    """How episodes go.

    Attributes:
        envs: humanoids at once. threads: of physics, and of what follows from it. processes: among which the
            environments are spread where there are many cores (`training.processes`), each with one thread.
        action_scale_rad: servo targets move by at most this from the led reference.
        episode_ticks: longest episode.
        stop_mean_m, stop_max_m: mean and largest joint distance that end an episode.
        noise_*: of the starting state, times a number from 0 to noise_most drawn for each episode: some begin on the
            clip, others as far from it as a body from the plan that was made while it stumbled.
        push_*: chance a tick and size of a sudden change of the root's velocity.
        heights: observations end with the heights of what is underfoot and under the seat (`training.seats`).
        knock_*: chance a tick and most of an impulse on a hand, foot, elbow or knee.
        jump_*: chance a tick and size of a sideways jump of the reference, which decays by jump_decay a tick
            (a plan's junction).
    """

    model_config = ConfigDict(frozen=True)
    envs: int = Field(default=320, gt=0)
    threads: int = Field(default=1, ge=1)
    processes: int = Field(default=1, ge=1)
    action_scale_rad: float = 0.4
    episode_ticks: int = 300
    stop_mean_m: float = 0.25
    stop_max_m: float = 0.6
    noise_hinge_rad: float = 0.03
    noise_root_m: float = 0.02
    noise_rate: float = 0.1
    noise_most: float = 3.0
    push_chance: float = 1 / 150
    push_mps: float = 0.3
    knock_chance: float = 1 / 240
    knock_ns: float = 25.0
    jump_chance: float = 1 / 120
    jump_m: float = 0.05
    jump_decay: float = 0.92
    fail_floor: float = 0.15
    exploded_mps: float = 30.0
    heights: bool = False
