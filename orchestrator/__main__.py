"""`python -m orchestrator --planner ENDPOINT --tracker ENDPOINT [--port N]`: the HTTP server alone."""

from __future__ import annotations

import argparse
import sys

from shared.ending import Ending


def main() -> int:
    """Serve until SIGTERM or Ctrl-C. Exit code 2 when the settings are refused, or it cannot start."""
    from orchestrator.api.server import serve
    from orchestrator.api.settings import OrchestratorSettings
    from shared.console import EXPECTED, as_ours
    from shared.settings import add_arguments, load_settings

    parser = argparse.ArgumentParser(prog="orchestrator", description="motionloop's HTTP server")
    add_arguments(parser, OrchestratorSettings)
    try:
        settings = load_settings(OrchestratorSettings, vars(parser.parse_args()))
        serve(settings)
    except EXPECTED as error:
        told = as_ours(error)
        allowed = f" (allowed: {told.allowed})" if told.allowed else ""
        sys.stderr.write(f"{told.message}{allowed}\n")
        return 2
    return 0


if __name__ == "__main__":
    ending = Ending()  # until `serve` takes the signals itself
    ending.leave(main())
