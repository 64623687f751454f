"""Settings of all services: where a value comes from, and what is said of a wrong one."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.api.settings import OrchestratorSettings
from planner_service.service.settings import PlannerSettings
from shared.errors import InvalidInputError
from shared.settings import ServiceSettings, load_settings
from tracker_service.service.settings import TrackerServiceSettings


def test_settings_come_from_arguments_then_environment_then_defaults(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MOTIONLOOP_ENDPOINT", "tcp://127.0.0.1:1")
    monkeypatch.setenv("MOTIONLOOP_WORKERS", "7")
    settings = load_settings(ServiceSettings, {"endpoint": "tcp://127.0.0.1:2", "workers": None})
    assert (settings.endpoint, settings.workers, settings.max_pending) == ("tcp://127.0.0.1:2", 7, 256)
    with pytest.raises(InvalidInputError) as caught:
        load_settings(ServiceSettings, {"endpoint": "tcp://127.0.0.1:2", "workers": "0"})
    assert (caught.value.field, caught.value.allowed) == ("workers", ">= 1")


def test_each_service_has_its_own_prefix(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MOTIONLOOP_PLANNER_MAX_BATCH", "3")
    monkeypatch.setenv("MOTIONLOOP_PLANNER_DIP_WEIGHTS", "w.safetensors")
    monkeypatch.setenv("MOTIONLOOP_TRACKER_MAX_CHARACTERS", "8")
    monkeypatch.setenv("MOTIONLOOP_PLANNER", "tcp://planner:5601")
    planner, tracker = load_settings(PlannerSettings), load_settings(TrackerServiceSettings)
    assert (planner.max_batch, planner.dip_weights, planner.endpoint) == (
        3, Path("w.safetensors"), "tcp://127.0.0.1:5601",
    )  # fmt: skip
    assert tracker.max_characters == 8
    assert load_settings(OrchestratorSettings).planner == "tcp://planner:5601"


def test_lists_are_written_with_commas_and_empty_is_not_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MOTIONLOOP_PLANNER_PLUGINS", "stand, clip,")
    monkeypatch.setenv("MOTIONLOOP_TRACKER_TRACKERS", "pd")
    monkeypatch.setenv("MOTIONLOOP_TRACKER_WEIGHTS", "")
    assert load_settings(PlannerSettings).plugins == ("stand", "clip")
    for name in ("allowed_hosts", "swap_endpoints", "spare_trackers"):
        assert getattr(load_settings(OrchestratorSettings, {name: "tcp://a:1,tcp://b:2"}), name) == (
            "tcp://a:1",
            "tcp://b:2",
        )
    assert load_settings(PlannerSettings, {"plugins": "dip"}).plugins == ("dip",)
    tracker = load_settings(TrackerServiceSettings)
    assert (tracker.trackers, tracker.weights) == (("pd",), None)


def test_keys_are_found_by_the_name_that_all_share_or_by_the_services_own(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("MOTIONLOOP_CURVE_DIR", str(tmp_path))
    with pytest.raises(InvalidInputError, match=f"no CURVE keys for the server in {tmp_path}"):
        load_settings(PlannerSettings)
    assert load_settings(OrchestratorSettings).curve_dir == tmp_path
    monkeypatch.setenv("MOTIONLOOP_PLANNER_CURVE_DIR", str(tmp_path / "own"))
    with pytest.raises(InvalidInputError, match="own"):
        load_settings(PlannerSettings)


def test_a_name_that_is_no_setting_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="max_bach"):
        load_settings(PlannerSettings, {"max_bach": "3"})
