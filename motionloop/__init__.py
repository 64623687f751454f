"""motionloop: text- and target-driven physical characters.

::

    from motionloop import Client

    with Client() as client, client.character() as character:
        character.say("a person walks forward", target=(1.5, 0.5))
        for state in character.stream():
            print(state.tick, state.pelvis_w_m)
"""

from __future__ import annotations

TYPE_CHECKING = False  # what type checkers take for true; importing typing for it would take longer than all else here
if TYPE_CHECKING:
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
        ObjectState,
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
    "ObjectState",
    "PlanGhost",
    "ServerProblem",
    "ServiceInfo",
    "ServicesInfo",
    "State",
    "TaskResult",
]

_ELSEWHERE = {"MotionLoopError": "shared.errors", "MotionClip": "shared.motion.clip"}


def __getattr__(name: str) -> object:
    """What is asked for is loaded then, so that the command line starts, and ends on Ctrl-C, at once."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_ELSEWHERE.get(name, "orchestrator.client")), name)
