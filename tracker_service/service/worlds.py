"""Building simulated characters from names, with compiled scenes kept, and how their scenes look."""

from __future__ import annotations

import threading

from pydantic import JsonValue

from shared.errors import InvalidInputError
from shared.plugins.interfaces import Tracker
from shared.scenes.files import load_scene
from shared.scenes.schema import Scene
from tracker_service.rendering.scene_shapes import OBJECT_RGBA, SceneShape
from tracker_service.simulation.character import SimulatedCharacter
from tracker_service.simulation.character_spec import character
from tracker_service.simulation.humanoid import humanoid
from tracker_service.simulation.scene import SceneModel, build_scene


class Worlds:
    """Compiled scenes by character and scene name; MuJoCo models are read-only and shared by their characters."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._models: dict[tuple[str, str], SceneModel] = {}

    def scene_model(self, character_name: str, scene_name: str) -> SceneModel:
        """The compiled world; raises InvalidInputError or NotFoundError that list the known names."""
        with self._lock:
            key = (character_name, scene_name)
            if key not in self._models:
                human = humanoid(character(character_name))
                self._models[key] = build_scene(human, load_scene(scene_name))
            return self._models[key]

    def simulation(
        self,
        character_name: str,
        scene_name: str,
        tracker: Tracker,
        character_id: str,
        xy_w_m: tuple[float, float] = (0.0, 0.0),
        heading_rad: float = 0.0,
    ) -> SimulatedCharacter:
        """A character standing at a place in a scene."""
        return SimulatedCharacter(
            self.scene_model(character_name, scene_name), tracker, character_id, xy_w_m, heading_rad
        )


def scene_name(scene: str | dict[str, JsonValue]) -> str:
    """The name, where a scene is given by name."""
    if not isinstance(scene, str):
        raise InvalidInputError("this service takes scenes by name only", field="scene", allowed="a name")
    return scene


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
