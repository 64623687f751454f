"""Scenes from YAML text and from folders; what is wrong with one is said with its line."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from shared.errors import InvalidInputError, NotFoundError
from shared.scenes.schema import Scene

LIBRARY = Path(__file__).parent / "library"
MAX_CHARS = 200_000


def parse_scene(text: str, source: str = "scene") -> Scene:
    """Scene from YAML text.

    Args:
        source: what to call the text in messages, e.g. its file name.

    Raises:
        InvalidInputError: not a scene; the message has the line and the reason, `field` the place in the data.
    """
    if len(text) > MAX_CHARS:
        raise InvalidInputError(f"{source} has {len(text)} characters", field="scene", allowed=f"<= {MAX_CHARS}")
    try:
        tree = yaml.compose(text, Loader=yaml.SafeLoader)
        _refuse_twice(tree, source)
        data = yaml.safe_load(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f" line {mark.line + 1}" if mark is not None else ""
        raise InvalidInputError(
            f"{source}{line}: not YAML: {error.problem or error.context}", field="scene", allowed="YAML"
        ) from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise InvalidInputError(f"{source}: not YAML: {error}", field="scene", allowed="YAML") from error
    return scene_from_data(data, source, tree)


def scene_from_data(data: object, source: str = "scene", tree: yaml.Node | None = None) -> Scene:
    """Scene from plain data (JSON, or YAML once read); `tree` gives the lines of what is wrong.

    Raises:
        InvalidInputError: as `parse_scene`.
    """
    try:
        return Scene.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(("scene", *(str(part) for part in first["loc"])))
        line = "" if tree is None else f" line {_line_of(tree, first['loc'])}"
        place = where.removeprefix("scene").removeprefix(".")
        said = first["msg"].removeprefix("Value error, ")
        # A list whose item is wrong is told of as too short as well: that is the same fault once more.
        rest = [other for other in error.errors()[1:] if first["loc"][: len(other["loc"])] != other["loc"]]
        others = f" (and {len(rest)} more)" if rest else ""
        raise InvalidInputError(
            f"{source}{line}: {place + ': ' if place else ''}{said[0].lower() + said[1:]}{others}", field=where
        ) from error


def scene_names(folders: Iterable[Path] = (LIBRARY,)) -> list[str]:
    """Names of the scenes in some folders."""
    return sorted({path.stem for folder in folders for path in folder.glob("*.yaml")})


def load_scene(name: str, folders: Iterable[Path] = (LIBRARY,)) -> Scene:
    """Scene by name from the first folder that has it.

    Raises:
        NotFoundError: no folder has it; lists the known names.
        InvalidInputError: its file is wrong; with the line and the reason.
    """
    folders = tuple(folders)
    names = scene_names(folders)
    if name not in names:
        raise NotFoundError(f"unknown scene {name!r}", field="scene", allowed=", ".join(names))
    path = next(path for folder in folders if (path := folder / f"{name}.yaml").is_file())
    return _of_file(path, path.stat().st_mtime_ns)


@cache
def _of_file(path: Path, changed_ns: int) -> Scene:
    """The scene of a file; `changed_ns` has a file that was changed read anew."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInputError(f"{path} cannot be read: {error}", field="scene") from error
    scene = parse_scene(text, path.name)
    if "name" not in scene.model_fields_set:
        return scene.model_copy(update={"name": path.stem})
    if scene.name != path.stem:
        raise InvalidInputError(
            f"{path.name}: the scene is called {scene.name!r}", field="scene.name", allowed=path.stem
        )
    return scene


def _line_of(node: yaml.Node, loc: Iterable[Any]) -> int:
    """Line (from 1) of the innermost thing on the way `loc` that the text has."""
    line = node.start_mark.line
    for step in loc:
        if isinstance(node, yaml.MappingNode):
            pair = next(((key, value) for key, value in node.value if key.value == step), None)
            if pair is None:
                continue  # a field the short form put in between, or one that is missing
            line, node = pair[0].start_mark.line, pair[1]
        elif isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
            node = node.value[step]
            line = node.start_mark.line
    return line + 1


def _refuse_twice(root: yaml.Node | None, source: str) -> None:
    """YAML's reader silently takes the last of two equal keys."""
    waiting, looked_at = [root], set[int]()
    while waiting:
        node = waiting.pop()
        if id(node) in looked_at:
            continue  # an alias: the same node once more
        looked_at.add(id(node))
        if isinstance(node, yaml.MappingNode):
            seen: set[str] = set()
            for key, value in node.value:
                waiting.append(value)
                if not isinstance(key, yaml.ScalarNode):
                    continue  # of no scene, as the reader or the schema will say
                if key.value in seen:
                    raise InvalidInputError(
                        f"{source} line {key.start_mark.line + 1}: {key.value!r} is there twice", field="scene"
                    )
                seen.add(key.value)
        elif isinstance(node, yaml.SequenceNode):
            waiting.extend(node.value)
