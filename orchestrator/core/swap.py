"""Exchanging a service or plug-in while it is in use: handshake, conformance probe, and only then the slot changes."""

from __future__ import annotations

import asyncio
from typing import Any

from orchestrator.core.services import Services, Slot, connect
from shared.errors import IncompatiblePeerError, InvalidInputError
from shared.motion.skeleton import CANONICAL
from shared.plugins.checks import planner_spec, tracker_spec
from shared.plugins.conformance import check_planner_endpoint, check_tracker_endpoint, require
from shared.plugins.registry import current_name
from shared.protocol.control import Health, HealthReport
from shared.protocol.security import CurveKeys
from shared.protocol.transport import Kind

PROBE_TIMEOUT_S = 20.0


async def probe(slot: Slot, kind: Kind, curve: CurveKeys | None) -> None:
    """Run the conformance suite on a service; raises IncompatiblePeerError naming the checks that failed."""
    check = check_planner_endpoint if kind == "planner" else check_tracker_endpoint
    results = await asyncio.to_thread(check, slot.endpoint, slot.plugin_name, timeout_s=PROBE_TIMEOUT_S, curve=curve)
    require(results)


def check_spec(slot: Slot) -> dict[str, Any]:
    """What the plug-in declared; raises IncompatiblePeerError when it does not fit the loop."""
    spec = slot.spec()
    if not spec:
        offered = ", ".join(str(p.get("name")) for p in slot.welcome.plugins)
        raise IncompatiblePeerError(f"there is no plug-in {slot.plugin_name!r}", field="plugin", allowed=offered)
    if spec.get("skeleton") != CANONICAL.id:
        raise IncompatiblePeerError(
            f"plug-in {slot.plugin_name!r} uses skeleton {spec.get('skeleton')!r}",
            field="skeleton",
            allowed=CANONICAL.id,
        )
    if slot.welcome.service == "planner":
        planner_spec(spec)
    else:
        tracker_spec(slot.welcome, slot.plugin)
    return spec


def check_drives(slot: Slot, tracker: str | None, character: str) -> None:
    """Raise InvalidInputError where the tracker asked for does not drive the character; it names those that do.

    Where none is asked for the service takes one that does.
    """
    wanted = tracker or slot.plugin
    able = [
        spec.name
        for spec in (tracker_spec(slot.present, str(plugin.get("name"))) for plugin in slot.present.plugins)
        if spec.characters is None or character in spec.characters
    ]
    if wanted is not None and current_name(wanted) not in able:
        raise InvalidInputError(
            f"tracker {wanted!r} does not drive {character!r}", field="tracker", allowed=", ".join(able) or "none"
        )


async def swap(
    services: Services,
    kind: Kind,
    endpoint: str | None,
    plugin: str | None,
    curve: CurveKeys | None = None,
) -> Slot:
    """Put another service or plug-in into the slot; an unfit one leaves the old in place and raises.

    Args:
        endpoint: where the new service listens; None for the one in use.
        plugin: what it should use; None for its default.

    Returns:
        The slot that was replaced (its client is still open when the endpoint has not changed).
    """
    if endpoint is None and plugin is None:
        raise InvalidInputError("give an endpoint or a plug-in", field="plugin", allowed="endpoint, plugin or both")
    old = services.planner if kind == "planner" else services.tracker
    if endpoint is None or endpoint == old.endpoint:
        await old.client.ask(Health(), HealthReport, timeout_s=5.0)
        new = Slot(old.client, await old.client.connect(), plugin)
    else:
        new = await connect(endpoint, kind, plugin, curve)
    try:
        check_spec(new)
        await probe(new, kind, curve)
    except BaseException:
        if new.client is not old.client:
            await asyncio.shield(new.client.close())
        raise
    if kind == "planner":
        services.planner = new
    else:
        services.tracker = new
    return old
