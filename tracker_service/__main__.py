"""`python -m tracker_service`."""

from __future__ import annotations

import sys

from tracker_service.service.main import main

if __name__ == "__main__":
    sys.exit(main())
