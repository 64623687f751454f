"""What every message is made of."""

from __future__ import annotations

import re
from typing import Annotated, Any, ClassVar, Final

import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, model_validator

from shared.protocol.arrays import check_letters

PROTOCOL_VERSION: Final = 2

Array = npt.NDArray[Any]
Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9_.\-]+$")]


def is_name(text: str) -> bool:
    """Whether a text is a `Name`."""
    return re.fullmatch(r"[A-Za-z0-9_.\-]{1,64}", text) is not None


class Message(BaseModel):
    """Base: immutable, no unknown fields, numpy arrays as declared."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True, ser_json_inf_nan="constants")
    type: ClassVar[str] = "Message"

    @model_validator(mode="after")
    def _letters_agree(self) -> Message:
        check_letters(self)
        return self
