"""motionloop: text- and target-driven physical characters.

::

    from motionloop import Client

    with Client() as client, client.character() as character:
        character.say("a person walks forward", target=(1.5, 0.5))
        for state in character.stream():
            print(state.tick, state.pelvis_w_m)
"""

from __future__ import annotations

from orchestrator.client import (
    AsyncCharacter,
    AsyncClient,
    AsyncEpisode,
    Character,
    CharacterInfo,
    Client,
    Episode,
    EpisodeInfo,
    Event,
    Motion,
    PlanGhost,
    ServerProblem,
    ServiceInfo,
    ServicesInfo,
    State,
    TaskResult,
)
from shared.errors import MotionLoopError
from shared.motion.clip import MotionClip

__all__ = [
    "AsyncCharacter",
    "AsyncClient",
    "AsyncEpisode",
    "Character",
    "CharacterInfo",
    "Client",
    "Episode",
    "EpisodeInfo",
    "Event",
    "Motion",
    "MotionClip",
    "MotionLoopError",
    "PlanGhost",
    "ServerProblem",
    "ServiceInfo",
    "ServicesInfo",
    "State",
    "TaskResult",
]
