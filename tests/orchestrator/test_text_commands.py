"""What `eval text` asks for: built-in kinds, files of sentences, and a run of a file over real services."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from orchestrator.evaluation.commands import ALL, Asked, choose, judged, read_sentences, shares
from orchestrator.evaluation.text import TextPlan
from shared.errors import InvalidInputError
from shared.motion.ik import standing_clip
from shared.tasks.interface import Trace
from shared.tasks.kinds import KINDS


def test_all_kinds_come_in_equal_shares_and_have_rules() -> None:
    asked = choose(66, 1, "all")
    assert {group: sum(one.group == group for one in asked) for group in ALL} == dict.fromkeys(ALL, 6)
    assert {one.rule for one in asked} <= set(KINDS)
    assert all(one.group != other.group for one, other in zip(asked, asked[1:], strict=False))
    assert choose(66, 1, "all") == asked != choose(66, 2, "all")


def test_lines_of_kind_tab_sentence_are_read(tmp_path: Path) -> None:
    path = tmp_path / "list.tsv"
    path.write_text("# unseen\nwalk\tamble along\n\nkick_left\tlash out with the left foot\n")
    asked = read_sentences(path)
    assert asked == [
        Asked("walk", "walk", "amble along"),
        Asked("kick_left", "kick_left", "lash out with the left foot"),
    ]
    assert TextPlan(sentences=tuple(asked)).streams(4, 1) == shares(asked, 2, 1)
    for bad, named in (
        ("walk amble\n", "line 1"),
        ("walk\t \n", "line 1"),
        ("fly\tgo up\n", "fly"),
        ("#\n", "no sentence"),
    ):
        path.write_text(bad)
        with pytest.raises(InvalidInputError, match=named) as caught:
            read_sentences(path)
        assert caught.value.field == "sentences"


def test_every_sentence_of_a_list_is_asked_once() -> None:
    asked = [Asked("walk", "walk", str(number)) for number in range(11)]
    dealt = shares(asked, 4, 3)
    assert [len(stream) for stream in dealt] == [3, 3, 3, 2]
    assert sorted((one for stream in dealt for one in stream), key=lambda one: int(one.text)) == asked
    assert dealt != shares(asked, 4, 4)


def test_going_down_is_no_fall_where_it_is_asked_for() -> None:
    low = np.repeat(standing_clip(1, 30).positions_w_m, 90, 0)
    low[30:] -= [0, 0, 0.8]
    trace = Trace(0, low, np.zeros(90, np.bool_))
    down = judged(Asked("squat", "squat", "sit down on the floor"), trace)
    assert (down.obeyed, down.fell) == (True, False)
    jump = judged(Asked("stand", "stand", "stand"), trace)
    assert (jump.obeyed, jump.fell) == (False, True)
    tripped = judged(Asked("squat", "squat", "squat"), Trace(0, low, np.ones(90, np.bool_)))
    assert (tripped.obeyed, tripped.fell) == (False, True)
    lying = judged(Asked("squat", "squat", "squat"), Trace(0, low - [0, 0, 0.4], np.zeros(90, np.bool_)))
    assert (lying.obeyed, lying.fell) == (False, True)
