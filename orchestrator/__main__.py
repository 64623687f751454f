"""`python -m orchestrator --planner ENDPOINT --tracker ENDPOINT [--port N]`: the HTTP server alone."""

from __future__ import annotations

import argparse
import sys

from orchestrator.api.server import serve
from orchestrator.api.settings import OrchestratorSettings
from shared.errors import InvalidInputError
from shared.settings import add_arguments, load_settings


def main() -> int:
    """Serve until SIGTERM or Ctrl-C. Exit code 2 when the settings are refused."""
    parser = argparse.ArgumentParser(prog="orchestrator", description="motionloop's HTTP server")
    add_arguments(parser, OrchestratorSettings)
    try:
        settings = load_settings(OrchestratorSettings, vars(parser.parse_args()))
    except InvalidInputError as error:
        allowed = f" (allowed: {error.allowed})" if error.allowed else ""
        sys.stderr.write(f"{error.message}{allowed}\n")
        return 2
    serve(settings)
    return 0


if __name__ == "__main__":
    sys.exit(main())
