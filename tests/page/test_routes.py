"""The routes that the page lives on, over three real processes and without a browser."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from orchestrator.api.binary import pack, unpack
from orchestrator.api.stream import STATES_UNDER_WAY, first_event
from orchestrator.core.supervise import Stack
from orchestrator.rest import Event
from orchestrator.web import STATIC, VENDOR_FILES, missing_vendor_files
from orchestrator.web.fetch_three import install, is_current
from shared.errors import MalformedMessageError, UnavailableError
from shared.motion.skeleton import CANONICAL
from tests.orchestrator.support import play
from tests.page.support import page_stack

JOINTS = len(CANONICAL)


def stream_of(stack: Stack, character: str, query: str = "", **options: Any) -> ClientConnection:
    url = stack.url.replace("http", "ws") + f"/v1/characters/{character}/stream?format=binary{query}"
    return connect(url, **options)


@given(st.lists(st.lists(st.integers(0, 4), max_size=3), max_size=4), st.text(max_size=9))
def test_a_block_holds_what_was_packed(shapes: list[list[int]], words: str) -> None:
    arrays = {f"a{i}": np.arange(np.prod(shape, dtype=int)).reshape(shape) - 0.5 for i, shape in enumerate(shapes)}
    data = pack({"words": words}, arrays)
    assert int.from_bytes(data[:4], "little") % 4 == 0  # browsers read float32 only at multiples of four
    header, found = unpack(data)
    assert header == {"words": words}
    assert {name: array.tolist() for name, array in found.items()} == {n: a.tolist() for n, a in arrays.items()}


@pytest.mark.parametrize("cut", [2, 10, -1])
def test_a_block_that_is_cut_off_is_refused(cut: int) -> None:
    with pytest.raises(MalformedMessageError):
        unpack(pack({"a": 1}, {"x": np.ones(3)})[:cut])


def test_the_page_and_all_its_files_are_served_with_a_policy_of_this_server_only(http: httpx.Client) -> None:
    assert missing_vendor_files() == (), "run make setup"
    files = [f"/web/{path.relative_to(STATIC)}" for path in STATIC.rglob("*") if path.is_file()]
    assert len(files) > 20
    for path in ["/", *files, *(f"/web/vendor/{name}" for name in VENDOR_FILES)]:
        reply = http.get(path)
        assert reply.status_code == 200, path
        policy = reply.headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "script-src 'self';" in policy
        assert "http" not in policy
    assert http.get("/web/../__init__.py").status_code == 404
    assert http.get("/web/js/none.js").status_code == 404


def test_no_page_file_names_another_host_or_writes_markup(http: httpx.Client) -> None:
    for path in STATIC.rglob("*"):
        if path.suffix in {".js", ".html", ".css"}:
            text = path.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
            for forbidden in ("http://", "https://", "innerHTML", "insertAdjacentHTML", "document.write", "eval("):
                assert forbidden not in text, (path, forbidden)


def test_a_package_that_is_not_the_pinned_three_is_refused(tmp_path: Path) -> None:
    wrong = tmp_path / "three.tgz"
    wrong.write_bytes(b"not it")
    with pytest.raises(UnavailableError, match="checksum"):
        install(wrong, tmp_path / "vendor")
    assert not is_current(tmp_path / "vendor")
    assert missing_vendor_files(tmp_path / "vendor") == VENDOR_FILES


def test_a_viewer_that_is_slow_is_sent_the_newest_state_and_no_queue(stack: Stack, http: httpx.Client) -> None:
    character = http.post("/v1/characters", json={"pacing": "realtime"}).json()["id"]
    with stream_of(stack, character) as slow, stream_of(stack, character) as quick:
        held: list[int] = []
        newest = -1
        # One viewer keeps up for two seconds of simulated time; the other acknowledges nothing.
        while newest < (held[0] if held else 0) + 60:
            message = quick.recv(timeout=30)
            if isinstance(message, bytes) and (header := unpack(message)[0])["type"] == "state":
                newest = header["tick"]
                held = held or [newest]
                quick.send(str(newest))
        states = [m for m in drained(slow) if unpack(m)[0]["type"] == "state"]
        assert len(states) == STATES_UNDER_WAY
        assert unpack(states[-1])[0]["tick"] < newest - 30
        slow.send("1")
        slow.send("1")
        later = [unpack(message)[0]["tick"] for message in drained(slow) if unpack(message)[0]["type"] == "state"]
        # What was waiting for room may be old; what comes after it is the present.
        assert len(later) == 2
        assert later[-1] >= newest - 3


def drained(socket: ClientConnection) -> list[bytes]:
    """Blocks that come until nothing has come for half a second."""
    out = []
    while True:
        try:
            message = socket.recv(timeout=0.5)
        except TimeoutError:
            return out
        if isinstance(message, bytes):
            out.append(message)


def test_blocks_of_the_stream_agree_with_the_json_api(stack: Stack, http: httpx.Client) -> None:
    character = http.post("/v1/characters", json={"pacing": "lockstep"}).json()["id"]
    http.post(f"/v1/characters/{character}/steps", json={"ticks": 30})
    with stream_of(stack, character, "&tail=1") as socket:
        found: dict[str, Any] = {}
        while not {"state", "plan", "event"} <= found.keys():
            message = socket.recv(timeout=30)
            if isinstance(message, str):
                found["event"] = json.loads(message)["event"]
            else:
                header, arrays = unpack(message)
                found[header["type"]] = (header, arrays)
    state = http.get(f"/v1/characters/{character}").json()["state"]
    header, arrays = found["state"]
    assert header["tick"] == state["tick"] == 30
    np.testing.assert_allclose(arrays["positions_m"], state["positions_m"], atol=1e-4)
    np.testing.assert_allclose(arrays["rotations_wxyz"], state["rotations_wxyz"], atol=1e-4)
    header, arrays = found["plan"]
    assert arrays["positions_m"].shape == (40, JOINTS, 3)
    assert arrays["rotations_wxyz"].shape == (40, JOINTS, 4)
    np.testing.assert_allclose(np.linalg.norm(arrays["rotations_wxyz"], axis=-1), 1.0, atol=1e-4)


def test_at_most_so_many_past_events_come_first() -> None:
    kept = [Event(seq=seq, type="x", tick=0, unix_s=0.0) for seq in range(11, 21)]
    assert first_event(kept, 0, None) == 0
    assert first_event(kept, 12, None) == 12
    assert first_event(kept, 0, 3) == 17
    assert first_event(kept, 0, 10) == 0
    assert first_event(kept, 0, 0) == 20


def test_pages_of_other_origins_may_not_watch(stack: Stack, http: httpx.Client) -> None:
    character = http.post("/v1/characters", json={"pacing": "lockstep"}).json()["id"]
    with stream_of(stack, character, origin=stack.url) as socket:
        socket.recv(timeout=30)
    with pytest.raises(InvalidStatus):
        stream_of(stack, character, origin="http://elsewhere.example")
    with pytest.raises(InvalidStatus):
        stream_of(stack, "00000000-0000-4000-8000-000000000000")


def test_an_episodes_frames_are_its_recording(http: httpx.Client) -> None:
    tasks = [{"type": "halt", "settle_s": 0.2, "duration_s": 0.5}]
    episode, recording = play(http, {"tasks": tasks, "seed": 2})
    reply = http.get(f"/v1/episodes/{episode['id']}/frames")
    assert reply.status_code == 200
    header, arrays = unpack(reply.content)
    assert header["count"] == episode["tick"] + 1
    assert header["fps"] == 30
    assert [result["label"] for result in header["results"]] == [r["label"] for r in episode["results"]]
    assert arrays["positions_m"].tobytes() == recording["body_pos_w_m"]
    assert arrays["rotations_wxyz"].tobytes() == recording["body_quat_w"]
    assert http.get("/v1/episodes/00000000-0000-4000-8000-000000000000/frames").status_code == 404


def test_tasks_scenes_and_skeleton_are_listed(http: httpx.Client) -> None:
    kinds = {item["type"]: item for item in http.get("/v1/tasks").json()["items"]}
    assert {"reach", "halt", "text"} <= kinds.keys()
    assert kinds["text"]["parameters"]["required"] == ["text"]
    assert all(item["description"] for item in kinds.values())
    assert "flat" in [scene["name"] for scene in http.get("/v1/scenes").json()["items"]]
    skeleton = http.get("/v1/skeleton").json()
    assert skeleton["joints"] == list(CANONICAL.names)
    np.testing.assert_allclose(skeleton["offsets_m"], CANONICAL.offsets_m)
    assert "traj" in skeleton["target_joints"]


def test_a_paused_character_is_stepped_and_a_running_one_is_not(http: httpx.Client) -> None:
    character = http.post("/v1/characters", json={"pacing": "realtime"}).json()["id"]
    path = f"/v1/characters/{character}"
    assert http.post(f"{path}/steps", json={"ticks": 5}).status_code == 409
    held = http.post(f"{path}/pause").json()["tick"]
    http.post(f"{path}/commands", json={"text": "walk forward"})
    assert http.post(f"{path}/steps", json={"ticks": 5}).json()["tick"] == held + 5
    state = http.post(f"{path}/steps", json={"ticks": 60}).json()
    assert state["tick"] == held + 65
    assert state["pelvis_m"][0] > 0.3  # planned on the way
    assert http.get(path).json()["status"] == "paused"
    assert http.post(f"{path}/resume").status_code == 200
    with np.load(io.BytesIO(http.get(f"{path}/motion.npz?seconds=1&until_tick={held + 60}").content)) as data:
        assert int(data["start_tick"]) + len(data["body_pos_w_m"]) == held + 61


def test_a_token_may_come_with_the_socket_and_a_lost_service_is_an_answer(tmp_path: Path) -> None:
    token = "a token with more than sixteen characters"
    with page_stack(tmp_path, token=token) as own:
        headers = {"Authorization": f"Bearer {token}"}
        with httpx.Client(base_url=own.url, timeout=60.0, headers=headers) as http:
            assert httpx.get(f"{own.url}/").status_code == 200  # the page holds no secrets
            assert httpx.get(f"{own.url}/v1/skeleton").status_code == 401
            character = http.post("/v1/characters", json={"pacing": "lockstep"}).json()["id"]
            text = base64.urlsafe_b64encode(token.encode()).decode().rstrip("=")
            with stream_of(own, character, subprotocols=["motionloop", f"bearer.{text}"]) as socket:
                assert socket.subprotocol == "motionloop"
                socket.recv(timeout=30)
            for wrong in (None, ["motionloop", "bearer.d3Jvbmc"], ["motionloop", "bearer.!"]):
                with pytest.raises(InvalidStatus):
                    stream_of(own, character, subprotocols=wrong)
            assert http.get("/v1/services/health").json()["planner"]["status"] == "ok"
            own.planner.stop()
            health = http.get("/v1/services/health")
            while health.json()["planner"]["status"] == "ok":  # the last answer holds for a second
                health = http.get("/v1/services/health")
            assert health.status_code == 200
            assert health.json()["planner"]["status"] == "away"
            assert health.json()["planner"]["message"]
            assert health.json()["tracker"]["status"] == "ok"
