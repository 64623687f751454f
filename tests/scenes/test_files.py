"""Scene files: what is right is read, what is wrong is said with its line."""

from __future__ import annotations

from pathlib import Path

import pytest

from shared.errors import InvalidInputError, NotFoundError
from shared.scenes.files import LIBRARY, load_scene, parse_scene, scene_from_data, scene_names
from shared.scenes.schema import Scene

HEAD = "name: x\nbodies:\n"


@pytest.mark.parametrize("name", scene_names())
def test_the_scenes_of_the_package_are_sound(name: str) -> None:
    scene = load_scene(name)
    assert Scene.model_validate(scene.model_dump(mode="json")) == scene, "travels as JSON"


def test_the_short_form_is_one_part() -> None:
    short = parse_scene(HEAD + "  - {name: a, shape: sphere, size_m: [0.2], mass_kg: 2, position_w_m: [0, 0, 1]}")
    spelt = parse_scene(
        HEAD
        + "  - {name: a, motion: free, mass_kg: 2, position_w_m: [0, 0, 1], parts: [{shape: sphere, size_m: [0.2]}]}"
    )
    assert short == spelt
    assert (short.bodies[0].motion, short.bodies[0].part_masses_kg) == ("free", (2.0,))


def test_a_mass_is_spread_by_volume() -> None:
    scene = parse_scene(
        HEAD + "  - {name: a, mass_kg: 5, position_w_m: [0, 0, 0],"
        " parts: [{shape: box, size_m: [1, 1, 1]}, {shape: box, size_m: [1, 1, 0.25]}]}"
    )
    assert scene.bodies[0].part_masses_kg == pytest.approx((4.0, 1.0))


BALL = "name: b, shape: sphere, size_m: [0.1], position_w_m: [0, 0, 1]"


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        (HEAD + "  - {" + BALL + "}\n  - name: a\n    shape: box\n    size_m: [1]\n    position_w_m: [0, 0, 0]", 4,
         "box takes 3 sizes"),
        (HEAD + "  - name: a\n    shape: cube\n    size_m: [1, 1, 1]\n    position_w_m: [0, 0, 0]", 4, "cylinder"),
        (HEAD + "  - name: b\n    shape: sphere\n    size_m: [-1]\n    position_w_m: [0, 0, 1]", 5, "greater than 0"),
        (HEAD + "  - {" + BALL + ", mass_gk: 3}", 3, "mass_gk"),
        (HEAD + "  - {" + BALL + "}\n  - {" + BALL + "}", 1, "share the name b"),
        ("name: x\nname: y", 2, "there twice"),
        ("name: x\nbodies: [", 2, "not YAML"),
        ("name: x\nmarks:\n  seat: {body: sofa, position_b_m: [0, 0, 0]}", 1, "'sofa', which is not a body"),
        ("name: x\nmarks:\n  good: {position_w_m: [0, 0, 0]}\n  seat: {position_b_m: [0, 0, 0]}", 4, "position_w_m"),
        (HEAD + "  - {" + BALL + ", motion: free}", 3, "needs a mass_kg"),
        (HEAD + "  - {" + BALL + ", motion: hinged, mass_kg: 1}", 3, "has a hinge"),
        (HEAD + "  - {" + BALL + ", mass_kg: 1, ground: true}", 3, "only a fixed body"),
        (HEAD + "  - {" + BALL + ", random: {size: [2, 1]}}", 3, "lowest, highest"),
        ("just words", 1, "dictionary"),
        ("name: x\nbodies: !!python/object:os.system []", 2, "not YAML"),
    ],
)  # fmt: skip
def test_a_wrong_scene_gets_the_line_and_the_reason(text: str, line: int, said: str) -> None:
    with pytest.raises(InvalidInputError) as caught:
        parse_scene(text, "mine.yaml")
    assert said in caught.value.message
    assert caught.value.message.startswith(f"mine.yaml line {line}:")
    assert str(caught.value.field).startswith("scene")


LAUGHS = "a0: &a0 [1]\n" + "".join(f"a{k + 1}: &a{k + 1} [{', '.join([f'*a{k}'] * 10)}]\n" for k in range(9))


@pytest.mark.parametrize(
    "text", ["[" * 50_000, "a" * 300_000, "name: \0", "", "? [a]\n: 1", "? {a: 1}\n: 1", LAUGHS, "a: &a [*a]"]
)
def test_text_that_breaks_readers_is_refused(text: str) -> None:
    with pytest.raises(InvalidInputError):
        parse_scene(text)


def test_data_without_lines_is_refused_by_its_field() -> None:
    with pytest.raises(InvalidInputError) as caught:
        scene_from_data({"name": "x", "bodies": [{"name": "a", "position_w_m": [0, 0]}]})
    assert str(caught.value.field).startswith("scene.bodies.0")


def test_a_folder_of_ones_own_comes_first_and_changes_are_seen(tmp_path: Path) -> None:
    folders = (tmp_path, LIBRARY)
    (tmp_path / "den.yaml").write_text("name: den")
    assert {"den", "flat"} <= set(scene_names(folders))
    assert load_scene("den", folders).bodies == ()
    (tmp_path / "den.yaml").write_text(HEAD.replace("x", "den") + "  - {" + BALL + "}")
    assert len(load_scene("den", folders).bodies) == 1
    with pytest.raises(NotFoundError, match="unknown scene 'hall'"):
        load_scene("hall", folders)
    (tmp_path / "odd.yaml").write_text("name: even")
    with pytest.raises(InvalidInputError, match=r"odd\.yaml"):
        load_scene("odd", folders)
