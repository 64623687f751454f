"""`python -m planner_service --endpoint tcp://127.0.0.1:5601`: serve planners until SIGTERM or Ctrl-C."""

from __future__ import annotations

import os
import sys

from shared.ending import Ending


def main() -> None:
    """Ends with exit code 0 after a signal, 2 when the service cannot start."""
    ending = Ending()
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    from planner_service.service.run import run  # after the variables, which numpy reads when it is loaded

    ending.leave(run(sys.argv[1:], ending))


if __name__ == "__main__":
    main()
