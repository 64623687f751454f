"""The Helm chart, rendered by Helm: checked against Kubernetes' schemas and the services' settings."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from orchestrator.api.settings import OrchestratorSettings
from planner_service.service.settings import PlannerSettings
from shared.protocol.security import create_curve_keys
from shared.settings import Settings, load_settings
from tracker_service.service.settings import TrackerServiceSettings

helm = pytest.importorskip("helm_python", reason="Helm's engine comes with helm-python-sdk")
kubernetes_validate = pytest.importorskip("kubernetes_validate", reason="Kubernetes' schemas")

CHART = Path(__file__).resolve().parents[2] / "deploy" / "helm" / "motionloop"
VERSIONS = ("1.27", "1.31", "1.35")
TOKENS = {"secrets": {"tokens": {"admin": "a" * 16, "metrics": "m" * 16}}}
EVERYTHING = {
    "secrets": {"tokens": {name: name[0] * 20 for name in ("admin", "command", "watch", "metrics")}},
    "image": {"registry": "registry.example.org/walks/", "tag": "7"},
    "imagePullSecrets": [{"name": "pull"}],
    "otel": {"OTEL_EXPORTER_OTLP_ENDPOINT": "http://collector:4318"},
    "planner": {"autoscaling": {"enabled": True, "maxReplicas": 5}, "plugin": "dip"},
    "tracker": {"replicas": 3, "plugin": "learned"},
    "orchestrator": {"shards": 4, "allowedHosts": ["walks.example.org"], "storageClass": "fast"},
    "networkPolicy": {"collector": [{"to": [{"podSelector": {}}], "ports": [{"protocol": "TCP", "port": 4318}]}]},
}
SERVICES: dict[str, type[Settings]] = {
    "planner": PlannerSettings,
    "tracker": TrackerServiceSettings,
    "orchestrator": OrchestratorSettings,
}


def rendered(values: dict[str, Any]) -> list[dict[str, Any]]:
    """All objects, as a release named `ours`."""
    with helm.Chart.load(str(CHART)) as chart:
        files = chart.render(values, name="ours", namespace="walks")
    return [each for text in files.values() for each in yaml.safe_load_all(text) if each]


def of_kind(objects: list[dict[str, Any]], *kinds: str) -> dict[str, dict[str, Any]]:
    return {each["metadata"]["name"]: each for each in objects if each["kind"] in kinds}


def workloads(objects: list[dict[str, Any]]) -> Iterator[tuple[str, dict[str, Any], dict[str, Any]]]:
    """Part, pod specification and container of each workload."""
    for each in of_kind(objects, "Deployment", "StatefulSet").values():
        pod = each["spec"]["template"]["spec"]
        (container,) = pod["containers"]
        yield container["name"], pod, container


@pytest.mark.parametrize("values", [TOKENS, EVERYTHING], ids=["few", "all"])
def test_helm_and_kubernetes_find_nothing_wrong(values: dict[str, Any]) -> None:
    assert helm.lint(str(CHART), values, strict=True)["errors"] == []
    objects = rendered(values)
    kinds = {each["kind"] for each in objects}
    assert {"Deployment", "StatefulSet", "Service", "Secret", "NetworkPolicy"} <= kinds
    assert ("HorizontalPodAutoscaler" in kinds) == (values is EVERYTHING)
    for each in objects:
        for version in VERSIONS:
            kubernetes_validate.validate(each, version, strict=True)


def test_the_schemas_would_tell() -> None:
    (planner,) = of_kind(rendered(TOKENS), "Deployment").values()
    planner["spec"]["template"]["spec"]["containers"][0]["ports"][0]["containerPort"] = "many"
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(planner, VERSIONS[-1], strict=True)


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({}, "secrets.tokens.admin"),
        ({"secrets": {"tokens": {"admin": "short", "metrics": "m" * 16}}}, "admin"),
        ({**TOKENS, "planner": {"replica": 3}}, "replica"),
        ({**TOKENS, "otel": {"ENDPOINT": "x"}}, "ENDPOINT"),
    ],
)
def test_values_that_make_no_sense_are_refused_by_name(values: dict[str, Any], told: str) -> None:
    with pytest.raises(helm.HelmError, match=told):
        rendered(values)


def test_pods_have_no_rights_and_write_only_where_a_volume_is() -> None:
    seen = set()
    for part, pod, container in workloads(rendered(EVERYTHING)):
        seen.add(part)
        assert pod["automountServiceAccountToken"] is False
        assert pod["securityContext"]["runAsNonRoot"] is True and pod["securityContext"]["runAsUser"] == 10001
        assert container["securityContext"] == {
            "allowPrivilegeEscalation": False,
            "readOnlyRootFilesystem": True,
            "capabilities": {"drop": ["ALL"]},
        }
        mounts = {mount["mountPath"]: mount.get("readOnly", False) for mount in container["volumeMounts"]}
        assert mounts == {"/keys": True, "/tmp": False, "/data": False}
        ports = {port["name"] for port in container["ports"]}
        for probe in ("startupProbe", "readinessProbe", "livenessProbe"):
            asked = container[probe].get("tcpSocket") or container[probe]["httpGet"]
            assert asked["port"] in ports
        assert container["image"] == f"registry.example.org/walks/motionloop-{part}:7"
        assert container["resources"]["requests"]["cpu"] and container["resources"]["limits"]["memory"]
    assert seen == set(SERVICES)


@pytest.mark.parametrize("values", [TOKENS, EVERYTHING], ids=["few", "all"])
def test_every_service_starts_with_the_variables_it_is_given(
    values: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The settings are those of a container: what is misspelt would leave a default, which the last lines see."""
    create_curve_keys(tmp_path)
    objects = rendered(values)
    (secret,) = of_kind(objects, "Secret").values()
    for part, _, container in workloads(objects):
        settings = SERVICES[part]
        prefix = str(settings.model_config["env_prefix"])
        with monkeypatch.context() as patch:
            for each in container["env"]:
                name = each["name"]
                assert (
                    name.startswith("OTEL_")
                    or name == "MOTIONLOOP_CURVE_DIR"
                    or (name.removeprefix(prefix).lower() in settings.model_fields)
                ), f"{part} has no setting for {name}"
                reference = each.get("valueFrom", {}).get("secretKeyRef")
                if reference is None:
                    patch.setenv(name, str(tmp_path) if name == "MOTIONLOOP_CURVE_DIR" else each["value"])
                elif reference["key"] in secret["stringData"] or not reference.get("optional"):
                    assert reference["name"] == secret["metadata"]["name"]
                    patch.setenv(name, secret["stringData"][reference["key"]])
            beyond = {"host": "0.0.0.0"} if part == "orchestrator" else {"endpoint": "tcp://0.0.0.0:5600"}
            made: Any = load_settings(settings, beyond)
        if part == "orchestrator":
            replicas = values.get("tracker", {}).get("replicas", 2)
            assert made.planner == "tcp://ours-planner:5601"
            trackers = [made.tracker, *made.spare_trackers]
            assert trackers == [f"tcp://ours-tracker-{n}.ours-tracker:5602" for n in range(replicas)]
            assert (made.watch_token is None) == (values is TOKENS)
        else:
            assert made.metrics_token.get_secret_value() == secret["stringData"]["metrics"]
            assert made.metrics_host == "0.0.0.0" and made.metrics_port in (9101, 9102)


def test_only_the_orchestrator_reaches_planner_and_tracker() -> None:
    objects = rendered(EVERYTHING)
    labels = {part: {"app.kubernetes.io/component": part} for part in SERVICES}
    policies = of_kind(objects, "NetworkPolicy")
    assert set(policies) == {f"ours-{part}" for part in SERVICES}
    for part, port in (("planner", 5601), ("tracker", 5602)):
        rules = policies[f"ours-{part}"]["spec"]["ingress"]
        (served,) = [rule for rule in rules if {"protocol": "TCP", "port": port} in rule["ports"]]
        (who,) = served["from"]
        assert labels["orchestrator"].items() <= who["podSelector"]["matchLabels"].items()
        services = of_kind(objects, "Service")
        assert port in {each["port"] for each in services[f"ours-{part}"]["spec"]["ports"]}
    for part, policy in policies.items():
        assert policy["spec"]["policyTypes"] == ["Ingress", "Egress"], part
    selected = {
        policy["spec"]["podSelector"]["matchLabels"]["app.kubernetes.io/component"] for policy in policies.values()
    }
    assert selected == set(SERVICES)


def test_the_planner_scales_on_a_number_that_it_serves() -> None:
    objects = rendered(EVERYTHING)
    (scaler,) = of_kind(objects, "HorizontalPodAutoscaler").values()
    (metric,) = scaler["spec"]["metrics"]
    name = metric["pods"]["metric"]["name"]
    assert f"`{name}`" in (CHART.parents[2] / "docs" / "operations.md").read_text()
    (planner,) = of_kind(objects, "Deployment").values()
    assert scaler["spec"]["scaleTargetRef"]["name"] == planner["metadata"]["name"]
    assert "replicas" not in planner["spec"], "an upgrade would undo what the scaler did"
