"""Scenes over HTTP: inline, by name, from a folder of one's own; objects that are moved, recorded and exported."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from orchestrator.core.scenes import Scenes
from orchestrator.core.supervise import Stack
from orchestrator.store.recordings import FIELDS, Recording, from_npz, joined, to_npz
from shared.errors import InvalidInputError
from shared.protocol.tracking import MAX_SCENE_BYTES
from shared.scenes.files import load_scene, scene_from_data
from shared.scenes.placing import sampled
from tests.orchestrator.support import light

TABLE: dict[str, Any] = {
    "bodies": [
        {"name": "table", "shape": "box", "size_m": [0.4, 0.6, 0.36], "position_w_m": [2, 0, 0.36]},
        {"name": "red", "shape": "sphere", "size_m": [0.1], "mass_kg": 0.5, "position_w_m": [2, 0.3, 0.82]},
        {"name": "blue", "shape": "sphere", "size_m": [0.1], "mass_kg": 0.5, "position_w_m": [2, -0.3, 1.5]},
    ],
    "marks": {"top": {"body": "table", "position_b_m": [0, 0, 0.36]}},
}


@pytest.fixture(scope="module")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """A stack with physics and a folder of scenes of its own, one of them wrong."""
    own = tmp_path_factory.mktemp("scenes")
    (own / "den.yaml").write_text(
        "description: A crate.\nbodies:\n  - {name: crate, shape: box, size_m: [0.2, 0.2, 0.2], mass_kg: 4,"
        " position_w_m: [1, 0, 0.2], random: {position_m: [[-0.5, 0.5], [0, 0]]}}"
    )
    (own / "odd.yaml").write_text("bodies:\n  - {name: a, shape: box, size_m: [1], position_w_m: [0, 0, 0]}")
    options = replace(light(tmp_path_factory.mktemp("data")), tracker_plugin="pd", scenes=str(own))
    with Stack(options) as running:
        yield running


@pytest.fixture
def http(stack: Stack) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=stack.url, timeout=60.0, trust_env=False) as client:
        yield client


def make(http: httpx.Client, **spec: Any) -> str:
    reply = http.post("/v1/characters", json={"pacing": "lockstep", **spec})
    assert reply.status_code == 201, reply.text
    return str(reply.json()["id"])


def test_an_inline_scene_runs_from_one_request(http: httpx.Client) -> None:
    character = make(http, scene=TABLE)
    assert http.get(f"/v1/characters/{character}").json()["scene"] == "inline"
    assert http.get(f"/v1/characters/{character}/scene").json() == scene_from_data(TABLE).model_dump(mode="json")
    http.post(f"/v1/characters/{character}/steps", json={"ticks": 30})
    there = http.get(f"/v1/characters/{character}/objects").json()
    assert there["tick"] == 30
    heights = {item["name"]: item["position_m"][2] for item in there["items"]}
    assert heights == pytest.approx({"table": 0.36, "red": 0.82, "blue": 0.82}, abs=0.02)


def test_an_object_is_moved_and_thrown(http: httpx.Client) -> None:
    character = make(http, scene=TABLE)
    path = f"/v1/characters/{character}/objects"
    thrown = http.put(f"{path}/red", json={"position_m": [0, 3, 1], "velocity_mps": [2, 0, 0]})
    assert thrown.status_code == 200, thrown.text
    assert thrown.json()["velocity_mps"] == [2, 0, 0]
    http.post(f"/v1/characters/{character}/steps", json={"ticks": 6})
    x, y, z = http.get(path).json()["items"][1]["position_m"]
    assert (x, y) == pytest.approx((0.4, 3.0), abs=0.02)
    assert z == pytest.approx(1 - 9.81 * 0.2**2 / 2, abs=0.03)
    for name, body, field in (
        ("table", {"velocity_mps": [1, 0, 0]}, "velocity_mps"),
        ("green", {"position_m": [0, 0, 0]}, "name"),
        ("red", {}, None),
        ("red", {"position_m": [0, 0, 1e9]}, "position_m.2"),
        ("red", {"rotation_wxyz": [0, 0, 0, 0]}, None),
    ):
        refused = http.put(f"{path}/{name}", json=body)
        assert refused.status_code == 422, refused.text
        assert field is None or refused.json()["field"] == field


def test_scenes_by_name_are_drawn_by_the_seed(http: httpx.Client) -> None:
    for name in ("den", "bag"):
        drawn = [http.get(f"/v1/characters/{make(http, scene=name, seed=seed)}/scene").json() for seed in (1, 1, 2)]
        assert drawn[0] == drawn[1] != drawn[2]
    character = make(http, scene="bag", seed=5)
    assert http.get(f"/v1/characters/{character}/scene").json() == sampled(load_scene("bag"), 5).model_dump(mode="json")
    item = http.get(f"/v1/characters/{character}/objects").json()["items"][0]
    assert item["position_m"] == pytest.approx(sampled(load_scene("bag"), 5).bodies[0].position_w_m, abs=1e-4)


def test_the_list_says_which_files_are_wrong(http: httpx.Client) -> None:
    listed = http.get("/v1/scenes").json()
    assert {"den", "flat", "room"} <= {scene["name"] for scene in listed["items"]}
    assert listed["wrong"] == {"odd": "odd.yaml line 2: bodies.0.parts.0: a box takes 3 sizes, got 1"}


@pytest.mark.parametrize(
    ("scene", "status", "said"),
    [
        ("odd", 422, "odd.yaml line 2"),
        ("moon", 404, "unknown scene 'moon'"),
        ({"bodies": [{"name": "a", "position_w_m": [0, 0]}]}, 422, ""),
        ({"bodies": [], "colour": "red"}, 422, ""),
        ({"marks": {"seat": {"body": "sofa", "position_b_m": [0, 0, 0]}}}, 422, "not a body"),
        (7, 422, ""),
    ],
)
def test_a_wrong_scene_is_refused_with_the_reason(http: httpx.Client, scene: object, status: int, said: str) -> None:
    reply = http.post("/v1/characters", json={"pacing": "lockstep", "scene": scene})
    assert reply.status_code == status, reply.text
    assert said in reply.text
    if scene != "moon":
        episode = http.post("/v1/episodes", json={"tasks": [{"type": "halt"}], "scene": scene})
        assert episode.status_code == status, episode.text


def test_an_episode_records_its_objects_and_exports_them(http: httpx.Client) -> None:
    spec = {"tasks": [{"type": "halt"}], "scene": TABLE, "seed": 3}
    episode = http.post("/v1/episodes", json=spec).json()["id"]
    assert http.get(f"/v1/episodes/{episode}/scene").json()["bodies"][1]["name"] == "red"
    assert '"end"' in http.get(f"/v1/episodes/{episode}/events").text
    with np.load(io.BytesIO(http.get(f"/v1/episodes/{episode}/motion.npz").content), allow_pickle=False) as data:
        assert data["objects"].tolist() == ["table", "red", "blue"]
        count = len(data["body_pos_w_m"])
        assert data["object_pose_w"].shape == (count, 3, 7)
        assert data["object_vel_w"].shape == (count, 3, 6)
        assert data["hinge_pos_rad"].shape == data["servo_target_rad"].shape == (count, 40)
        assert json.loads(str(data["scene"])) == scene_from_data(TABLE).model_dump(mode="json")
        sample, impulse = data["contact_sample"], data["contact_impulse_ns"]
        second = (sample >= 15) & (sample < 45)
        assert impulse[second & (data["contact_object"] == -1)].sum() == pytest.approx(72 * 9.81, rel=0.05)
    glb = http.get(f"/v1/episodes/{episode}/motion.glb").content
    length = struct.unpack("<I", glb[12:16])[0]
    names = [node["name"] for node in json.loads(glb[20 : 20 + length])["nodes"]]
    assert {"table", "red", "blue", "pelvis"} <= set(names)


def test_parts_join_with_their_contacts_in_place_and_old_files_are_read(tmp_path: Path) -> None:
    def part(start: int, count: int) -> Recording:
        arrays: dict[str, Any] = {name: np.zeros((count, 2, 7)) for name in FIELDS}
        arrays["body_pos_w_m"] = np.zeros((count, 22, 3))
        arrays |= {"contact_sample": np.array([0, count - 1]), "contact_body": np.array([1, 2])}
        arrays |= {"contact_object": np.array([-1, 0]), "contact_impulse_ns": np.array([0.5, 1.5])}
        return Recording(start, arrays, ("a", "b"), "child", scene_from_data(TABLE))

    whole = joined([part(0, 10), part(10, 5)])
    assert whole.arrays["contact_sample"].tolist() == [0, 9, 10, 14]
    path = tmp_path / "new.npz"
    path.write_bytes(to_npz(whole))
    again = from_npz(path)
    assert (again.character, again.scene, again.skeleton.id) == ("child", whole.scene, "child22")
    with np.load(path) as data:
        kept = ("body_pos_w_m", "body_quat_w", "body_linvel_w_mps", "contacts", "object_pose_w", "tracking_error_m",
                "fallen", "reference_pos_w_m", "start_tick", "objects")  # fmt: skip
        np.savez(tmp_path / "old.npz", **{name: data[name] for name in kept})
    old = from_npz(tmp_path / "old.npz")
    assert old.arrays["object_vel_w"].shape == (15, 2, 6)
    assert old.arrays["contact_sample"].shape == (0,)
    assert (old.character, old.scene) == ("human", None)


def test_what_travels_to_the_tracker_is_a_name_or_a_document_without_anything_to_draw(tmp_path: Path) -> None:
    (tmp_path / "bag.yaml").write_text(
        "bodies: [{name: sack, shape: sphere, size_m: [0.3], position_w_m: [1, 0, 0.3]}]"
    )
    scenes = Scenes(tmp_path)
    assert scenes.for_tracker("sofa", 1) == "sofa"
    assert scenes.for_tracker("known_to_the_tracker", 1) == "known_to_the_tracker"
    own = scenes.for_tracker("bag", 1)
    assert isinstance(own, dict)
    assert own["name"] == "bag"
    drawn = scenes.for_tracker(load_scene("stool"), 4)
    assert scene_from_data(drawn) == sampled(load_scene("stool"), 4)
    part = {"shape": "sphere", "size_m": [0.123456789], "position_b_m": [1.25, 2.25, 3.25]}
    many = [{"name": f"b{i}", "position_w_m": [i, 0, 0], "parts": [part] * 32} for i in range(32)]
    with pytest.raises(InvalidInputError, match=r"bytes"):
        scenes.for_tracker(scene_from_data({"bodies": many}), 0)
    assert len(json.dumps(many)) > MAX_SCENE_BYTES
    with pytest.raises(InvalidInputError, match="there is no folder"):
        Scenes(tmp_path / "none")
