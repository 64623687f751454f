"""The scenes a server knows: of a folder of its own, then of the package; and what a request brings along."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from shared.errors import InvalidInputError, MotionLoopError
from shared.protocol.base import Name
from shared.protocol.tracking import MAX_SCENE_BYTES
from shared.scenes.files import LIBRARY, load_scene, scene_names
from shared.scenes.placing import sampled
from shared.scenes.schema import Scene

SceneChoice = Name | Scene
"""A scene by name, or the document itself."""


class Scenes:
    """Scenes by name.

    Args:
        folder: scenes of one's own (YAML files); they come before those of the package.
    """

    def __init__(self, folder: Path | None = None):
        if folder is not None and not folder.is_dir():
            raise InvalidInputError(f"there is no folder {folder}", field="scenes", allowed="a folder of YAML files")
        self._own = () if folder is None else (folder,)

    def names(self) -> list[str]:
        """All names."""
        return scene_names((*self._own, LIBRARY))

    def all(self) -> tuple[list[Scene], dict[str, str]]:
        """The scenes as their files have them, and what is wrong with the files that cannot be read, by name."""
        scenes, wrong = [], {}
        for name in self.names():
            try:
                scenes.append(load_scene(name, (*self._own, LIBRARY)))
            except MotionLoopError as error:
                wrong[name] = error.message
        return scenes, wrong

    def chosen(self, choice: SceneChoice, seed: int) -> Scene | None:
        """The scene that a seed makes of a choice; None for a name that only the tracker may know.

        Raises:
            InvalidInputError: the file of that name is wrong; with the line and the reason.
        """
        if isinstance(choice, Scene):
            return sampled(choice, seed)
        if choice not in self.names():
            return None
        return sampled(load_scene(choice, (*self._own, LIBRARY)), seed)

    def for_tracker(self, choice: SceneChoice, seed: int) -> str | dict[str, Any]:
        """What to ask the tracker for: a name of the package's, else the document with nothing left to draw.

        Raises:
            InvalidInputError: as `chosen`, or the document is too long for a message.
        """
        scene = self.chosen(choice, seed)
        if scene is None or (isinstance(choice, str) and choice not in scene_names(self._own)):
            return str(choice)
        document = scene.model_dump(mode="json", exclude_defaults=True)
        size = len(json.dumps(document))
        if size > MAX_SCENE_BYTES:
            raise InvalidInputError(
                f"the scene takes {size} bytes", field="scene", allowed=f"<= {MAX_SCENE_BYTES} bytes as JSON"
            )
        return document


def name_of(choice: SceneChoice) -> str:
    """How the choice is called."""
    return choice if isinstance(choice, str) else choice.name
