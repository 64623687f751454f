"""The walk that all spellings of it must come in as."""

from __future__ import annotations

import pytest

from shared.data.importer import load_clip
from shared.motion.body import Array
from tests.data.walks import plain


@pytest.fixture(scope="session")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Array:
    """The base as a clip."""
    path = tmp_path_factory.mktemp("base") / "base.bvh"
    path.write_text(plain())
    return load_clip(path)[0].positions_w_m
