"""Simulated characters from names and scene documents, with compiled scenes kept, and how scenes look."""

from __future__ import annotations

import threading
from collections import OrderedDict
from pathlib import Path

from pydantic import JsonValue

from shared.errors import InvalidInputError
from shared.plugins.interfaces import Tracker
from shared.scenes.files import LIBRARY, load_scene, scene_from_data
from shared.scenes.placing import sampled
from shared.scenes.schema import Scene
from tracker_service.rendering.scene_shapes import OBJECT_RGBA, SceneShape
from tracker_service.simulation.character import SimulatedCharacter
from tracker_service.simulation.character_spec import character
from tracker_service.simulation.humanoid import humanoid
from tracker_service.simulation.scene import SceneModel, build_scene

KEPT_MODELS = 32


class Worlds:
    """Compiled worlds by character and scene; MuJoCo models are read-only and shared by their characters.

    Args:
        folder: scenes of one's own, looked at before those of the package.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folders = (LIBRARY,) if folder is None else (folder, LIBRARY)
        self._lock = threading.Lock()
        self._models: OrderedDict[tuple[str, str], SceneModel] = OrderedDict()

    def scene(self, scene: str | dict[str, JsonValue], seed: int) -> Scene:
        """A scene by name or as a document, with its random ranges drawn.

        Raises:
            NotFoundError: no such name; lists the known ones.
            InvalidInputError: the document, or the file of that name, is wrong; with the reason.
        """
        if isinstance(scene, str):
            return sampled(load_scene(scene, self._folders), seed)
        return sampled(scene_from_data(scene), seed)

    def scene_model(self, character_name: str, scene: Scene) -> SceneModel:
        """The compiled world; raises InvalidInputError that lists the known characters, or says what MuJoCo refused."""
        key = (character_name, scene.model_dump_json())
        with self._lock:
            if key not in self._models:
                human = humanoid(character(character_name))
                try:
                    self._models[key] = build_scene(human, scene)
                except ValueError as error:
                    raise InvalidInputError(f"the scene cannot be simulated: {error}", field="scene") from error
            self._models.move_to_end(key)
            while len(self._models) > KEPT_MODELS:
                self._models.popitem(last=False)
            return self._models[key]

    def simulation(
        self,
        character_name: str,
        scene: Scene,
        tracker: Tracker,
        character_id: str,
        xy_w_m: tuple[float, float] = (0.0, 0.0),
        heading_rad: float = 0.0,
    ) -> SimulatedCharacter:
        """A character standing at a place in a scene."""
        return SimulatedCharacter(self.scene_model(character_name, scene), tracker, character_id, xy_w_m, heading_rad)


def scene_shapes(scene: Scene) -> tuple[SceneShape, ...]:
    """The scene's objects as the renderer draws them; each follows the pose that the log has for it."""
    return tuple(
        SceneShape(
            body.name, part.shape, part.size_m, part.position_b_m, part.quat_b,
            OBJECT_RGBA if part.colour is None else (*part.colour, 1.0),
        )
        for body in scene.bodies
        for part in body.parts
    )  # fmt: skip
