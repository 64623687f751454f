"""What a service is made of is not gone through by the garbage collector again, and what comes later is."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

REPO = Path(__file__).resolve().parent.parent
SPARED = """
import gc
from shared.garbage import spare_what_stays

class Ring:
    def __init__(self):
        self.itself = self

stays = Ring()
gc.disable()
Ring()
spare_what_stays()
spared = gc.get_freeze_count()
assert spared > 1000, spared
assert not any(each is stays for each in gc.get_objects())
Ring()
print(gc.collect() > 0, gc.get_freeze_count() == spared)
"""


def test_what_stays_is_spared_and_what_is_thrown_away_later_is_collected() -> None:
    done = subprocess.run([sys.executable, "-c", SPARED], cwd=REPO, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "True"]
