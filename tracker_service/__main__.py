"""`python -m tracker_service`."""

from __future__ import annotations

from shared.ending import Ending

if __name__ == "__main__":
    ending = Ending()
    from tracker_service.service.main import main  # a signal that comes meanwhile counts too

    ending.leave(main(ending))
