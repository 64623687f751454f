"""The planners this service brings along."""

from __future__ import annotations

from collections.abc import Callable

from planner_service.builtin.clip import ClipPlanner
from planner_service.builtin.library import ClipLibrary
from planner_service.builtin.rise import RisePlanner
from planner_service.builtin.stand import StandPlanner
from planner_service.service.settings import PlannerSettings
from shared.errors import InvalidInputError, UnavailableError
from shared.plugins.conformance import sample_request
from shared.plugins.interfaces import Planner
from shared.plugins.registry import PLANNERS, PluginRegistry

FIRST_TEXTS = ("a person is standing still.", "a person waves with the right hand.")
"""Planned for before anyone asks, once and several times: the first plan of a process takes up to six times as long."""


def planner_registry(settings: PlannerSettings) -> PluginRegistry[Planner]:
    """Built-ins and installed planners that the settings allow."""
    builtin: dict[str, Callable[[], Planner]] = {
        "dip": lambda: _dip(settings),
        "clip": lambda: _clip(settings),
        "stand": StandPlanner,
        "rise": lambda: _rise(settings),
    }
    return PluginRegistry(PLANNERS, builtin, settings.plugins)


def _clip(settings: PlannerSettings) -> Planner:
    try:
        return ClipPlanner(ClipLibrary.load(settings.clip_library))
    except InvalidInputError as error:
        raise UnavailableError(error.message, field=error.field, allowed=error.allowed) from error


def _rise(settings: PlannerSettings) -> Planner:
    try:
        return RisePlanner.load(settings.rise_library)
    except InvalidInputError as error:
        raise UnavailableError(error.message, field=error.field, allowed=error.allowed) from error


def _dip(settings: PlannerSettings) -> Planner:
    """The diffusion planner; torch is imported only here, so that the others run without it."""
    try:
        import torch

        from planner_service.dip.planner import DipPlanner, DipSettings
    except ImportError as error:
        raise UnavailableError(f"its libraries are not installed: {error}") from error
    torch.set_num_threads(settings.threads)
    try:
        planner: Planner = DipPlanner.load(
            settings.dip_weights, DipSettings(runtime=settings.runtime, steps=settings.steps, threads=settings.threads)
        )
    except (FileNotFoundError, InvalidInputError) as error:
        raise UnavailableError(f"its weights do not load: {error}") from error
    planner.plan([sample_request(planner.spec, text=text) for text in FIRST_TEXTS])
    return planner
