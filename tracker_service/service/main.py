"""The tracker service as a process: `python -m tracker_service --endpoint tcp://127.0.0.1:5602`."""

from __future__ import annotations

import argparse
import os
import sys

from shared.ending import Ending
from shared.errors import MotionLoopError
from shared.garbage import spare_what_stays
from shared.settings import add_arguments, load_settings
from shared.spans import recorder_of, recording
from shared.tracing import configure_logging
from tracker_service.service.settings import TrackerServiceSettings


def main(ending: Ending, argv: list[str] | None = None) -> int:
    """Serve until SIGTERM or Ctrl-C; exit code 2 for settings that cannot be used."""
    # One thread for each linear algebra call: several busy processes on few cores are far slower with more.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    parser = argparse.ArgumentParser("tracker_service", description=__doc__)
    add_arguments(parser, TrackerServiceSettings)
    try:
        settings = load_settings(TrackerServiceSettings, vars(parser.parse_args(argv)))
        configure_logging("tracker", settings.log_level, settings.log_format)
        return serve(settings, ending)
    except MotionLoopError as error:
        allowed = f" (allowed: {error.allowed})" if error.allowed else ""
        print(f"tracker_service: {error.field or 'error'}: {error.message}{allowed}", file=sys.stderr)
        return 2


def serve(settings: TrackerServiceSettings, ending: Ending) -> int:
    """Run the service, print one line when it is ready, end cleanly on a signal."""
    from tracker_service.service.service import TrackerService

    # A tick gives up the interpreter's lock in every call into MuJoCo; the default of 5 ms would have it wait that long
    # to go on each time another thread computes.
    sys.setswitchinterval(0.0005)
    ending.serve()  # from here on there are files to remove
    with recording(recorder_of("tracker")), TrackerService(settings) as service:
        spare_what_stays()
        if service.metrics.endpoint.url is not None:
            print(f"tracker_service metrics at {service.metrics.endpoint.url}", flush=True)
        print(f"tracker_service ready endpoint={service.endpoint} state={service.state_endpoint}", flush=True)
        ending.wait()
    print("tracker_service ended", flush=True)
    return 0
