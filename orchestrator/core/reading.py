"""What a reply to a command says about it: how its words were taken, and what of it the planner cannot honour."""

from __future__ import annotations

from collections import OrderedDict

from orchestrator.core.command import Command
from orchestrator.core.services import Slot
from orchestrator.rest import CommandReading, NearestSentence
from shared.errors import MotionLoopError
from shared.plugins.interfaces import PlannerSpec
from shared.protocol.messages import ReadText, TextRead
from shared.text.wording import Wording

ASK_S = 1.0
"""A planner that is too busy to say leaves the reply without its nearest sentence: commands must not wait for words."""
KEPT_TEXTS = 512


def read_command(command: Command, wording: Wording | None, spec: PlannerSpec) -> CommandReading:
    """What can be said of a command without asking the planner."""
    return CommandReading(
        understood=None if wording is None else wording.text,
        steps=[] if wording is None else list(wording.steps),
        dropped=[] if wording is None else list(wording.dropped),
        ignored_conditions=ignored_conditions(command, spec),
        unreachable_joints=unreachable_joints(command, spec),
    )


def ignored_conditions(command: Command, spec: PlannerSpec) -> list[str]:
    """What a command asks that the planner does not honour, by the names of `CONDITIONS`.

    A velocity without a target is turned into a target ahead, so that any planner with targets goes that way.
    """
    by_target = command.target is None and "target" in spec.conditions
    asked = {
        "text": command.text is not None,
        "target": command.target is not None,
        "heading": command.heading_rad is not None,
        "velocity": command.velocity_mps is not None and not by_target,
        "facing": command.velocity_mps is not None and command.heading_rad is not None,
        "keyframes": any(frame.positions_m for frame in command.keyframes),
        "keyframe_rotations": any(frame.rotations_wxyz for frame in command.keyframes),
        "obstacles": bool(command.avoid),
    }
    return [name for name, given in asked.items() if given and name not in spec.conditions]


def unreachable_joints(command: Command, spec: PlannerSpec) -> list[str]:
    """Joints of a command's target that the planner cannot place."""
    if command.target is None or spec.target_joints is None or command.target.joint in spec.target_joints:
        return []
    return [command.target.joint]


class NearestSentences:
    """Asks planners which of their sentences is nearest to a text, and remembers the answers."""

    def __init__(self) -> None:
        self._kept: OrderedDict[tuple[str, str, str], TextRead] = OrderedDict()

    async def of(self, slot: Slot, planner: str, text: str) -> NearestSentence | None:
        """The nearest sentence to a text that is far from all; None for one that is not, or when nobody can say."""
        key = (slot.welcome.instance_id, planner, text)
        if key not in self._kept:
            try:
                self._kept[key] = await slot.client.ask(ReadText(planner=planner, text=text), TextRead, timeout_s=ASK_S)
            except MotionLoopError:  # away, or of a version that cannot say: a command goes its way without it
                return None
            while len(self._kept) > KEPT_TEXTS:
                self._kept.popitem(last=False)
        read = self._kept[key]
        if not read.far or read.nearest is None or read.similarity is None:
            return None
        return NearestSentence(text=read.nearest, similarity=read.similarity)
