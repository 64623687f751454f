"""The process of the planner service."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from planner_service.service.service import PlannerService
from planner_service.service.settings import PlannerSettings
from shared.ending import Ending
from shared.errors import MotionLoopError
from shared.garbage import spare_what_stays
from shared.settings import add_arguments, load_settings
from shared.spans import recorder_of, recording
from shared.tracing import configure_logging


def run(arguments: Sequence[str], ending: Ending) -> int:
    """Serve until SIGTERM or SIGINT. Exit code: 0 after a signal, 2 when the service cannot start."""
    parser = argparse.ArgumentParser(prog="planner_service", description="Serve planners over ZeroMQ.")
    add_arguments(parser, PlannerSettings)
    try:
        settings = load_settings(PlannerSettings, vars(parser.parse_args(arguments)))
        configure_logging("planner", settings.log_level, settings.log_format)
        recorder = recorder_of("planner")
        service = ending.start(PlannerService(settings).start)
    except MotionLoopError as error:
        hint = f" (allowed: {error.allowed})" if error.allowed else ""
        print(f"planner service cannot start: {error.field or 'error'}: {error.message}{hint}", file=sys.stderr)
        return 2
    ending.serve()
    spare_what_stays()
    if service.metrics.endpoint.url is not None:
        print(f"planner metrics at {service.metrics.endpoint.url}", flush=True)
    print(f"planner ready at {service.endpoint} with {', '.join(service.plugins)}", flush=True)
    with recording(recorder):
        ending.wait()
        service.stop()
    return 0
