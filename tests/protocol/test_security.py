"""Who may listen where, and CURVE with real sockets."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest

from shared.errors import InvalidInputError, UnavailableError
from shared.protocol.control import Health, HealthReport, Hello, Welcome
from shared.protocol.security import CurveKeys, check_bind, create_curve_keys, is_local, load_curve_keys
from shared.protocol.transport import ServiceClient, ServiceServer
from shared.settings import ServiceSettings, load_settings


@pytest.mark.parametrize(
    ("endpoint", "local"),
    [
        ("tcp://127.0.0.1:5601", True),
        ("tcp://localhost:5601", True),
        ("tcp://[::1]:5601", True),
        ("ipc:///tmp/x", True),
        ("inproc://x", True),
        ("tcp://0.0.0.0:5601", False),
        ("tcp://*:5601", False),
        ("tcp://192.168.1.4:5601", False),
        ("tcp://planner:5601", False),
    ],
)
def test_loopback(endpoint: str, local: bool) -> None:
    assert is_local(endpoint) is local


def test_listening_beyond_the_machine_needs_keys() -> None:
    with pytest.raises(InvalidInputError) as caught:
        load_settings(ServiceSettings, {"endpoint": "tcp://0.0.0.0:5601"})
    assert caught.value.field == "endpoint"
    assert "MOTIONLOOP_CURVE_DIR" in (caught.value.allowed or "")
    check_bind("tcp://0.0.0.0:5601", CurveKeys("a" * 40, "b" * 40, ()))


def test_an_unknown_scheme_is_refused() -> None:
    with pytest.raises(InvalidInputError):
        check_bind("http://127.0.0.1:80", None)


def serve(keys: CurveKeys) -> ServiceServer:
    def welcome(hello: Hello) -> Welcome:
        return Welcome(service="planner", version="1", instance_id="x", default_plugin="stand", plugins=[])

    return ServiceServer(
        "tcp://127.0.0.1:0",
        {Health: lambda e, m: HealthReport(status="ok", uptime_s=0.0)},
        welcome,
        curve=keys,
    )


def test_curve_lets_in_whom_it_knows_only(tmp_path: Path) -> None:
    create_curve_keys(tmp_path / "ours")
    create_curve_keys(tmp_path / "theirs")
    assert stat.S_IMODE((tmp_path / "ours" / "server.key_secret").stat().st_mode) == 0o600
    ours, theirs = (load_curve_keys(tmp_path / name, "client") for name in ("ours", "theirs"))
    stranger = CurveKeys(theirs.public, theirs.secret, ours.peers)
    with serve(load_curve_keys(tmp_path / "ours", "server")) as server:
        with ServiceClient(server.endpoint, "planner", curve=ours) as client:
            assert client.connect().service == "planner"
        for keys in (stranger, None):
            with ServiceClient(server.endpoint, "planner", curve=keys) as client, pytest.raises(UnavailableError):
                client.connect(0.3)


def test_missing_keys_are_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError) as caught:
        load_curve_keys(tmp_path, "server")
    assert caught.value.field == "curve_dir"
