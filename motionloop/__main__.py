"""`python -m motionloop`: the command line."""

from __future__ import annotations

from motionloop.cli import main

if __name__ == "__main__":
    main()
