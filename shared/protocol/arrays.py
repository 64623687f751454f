"""Array fields of messages: dtype, shape pattern and size limit travel with the type.

`Annotated[Array, ArraySpec("<f4", ("T", 22, 3))]` is a pydantic-checked numpy field. Letters in a shape are sizes
that must agree within one message (every "T" is the same number).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel
from pydantic_core import core_schema

from shared.errors import InvalidInputError

JOINTS = 22
MAX_ARRAY_BYTES = 64 * 2**20


@dataclass(frozen=True)
class ArraySpec:
    """Wire form of one array: little-endian dtype, shape pattern of numbers and letters, largest and least size."""

    dtype: str
    shape: tuple[int | str, ...]
    max_size: int = 20_000
    min_size: int = 0

    def check_shape(self, shape: tuple[int, ...], field: str) -> dict[str, int]:
        """Sizes bound to the letters; raises InvalidInputError naming `field` before anything is allocated."""
        if len(shape) != len(self.shape):
            raise self._unfit(f"{field} has shape {shape}", field)
        bound: dict[str, int] = {}
        for size, want in zip(shape, self.shape, strict=True):
            if isinstance(want, int):
                ok = size == want
            else:
                ok = self.min_size <= size <= self.max_size and bound.setdefault(want, size) == size
            if not ok:
                raise self._unfit(f"{field} has shape {shape}", field)
        if math.prod(shape) * np.dtype(self.dtype).itemsize > MAX_ARRAY_BYTES:
            raise self._unfit(f"{field} of shape {shape} is larger than {MAX_ARRAY_BYTES} bytes", field)
        return bound

    def _unfit(self, message: str, field: str) -> InvalidInputError:
        letters = f"letters <= {self.max_size}" + (f" and >= {self.min_size}" if self.min_size else "")
        allowed = f"{self.dtype} array of shape ({', '.join(map(str, self.shape))}), {letters}"
        return InvalidInputError(message, field=field, allowed=allowed)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> core_schema.CoreSchema:
        def validate(value: Any, info: core_schema.ValidationInfo) -> npt.NDArray[Any]:
            try:
                array = np.ascontiguousarray(value, dtype=np.dtype(self.dtype))
            except TypeError as error:
                raise ValueError(f"not an array of numbers: {error}") from error
            try:
                self.check_shape(array.shape, info.field_name or "array")
            except InvalidInputError as error:
                raise ValueError(f"{error.message}; allowed: {error.allowed}") from error
            if array.dtype.kind == "f" and not np.isfinite(array).all():
                raise ValueError("values must be finite")
            return array

        return core_schema.with_info_plain_validator_function(
            validate,
            serialization=core_schema.plain_serializer_function_ser_schema(lambda a: a.tolist(), when_used="json"),
        )

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        return {"type": "array", "x-dtype": self.dtype, "x-shape": list(self.shape), "description": "raw frame"}


@lru_cache(maxsize=256)
def array_specs(message_type: type[BaseModel]) -> dict[str, ArraySpec]:
    """The array fields of a message type, by field name, in the order of declaration."""
    specs: dict[str, ArraySpec] = {}
    for name, field in message_type.model_fields.items():
        for item in field.metadata:
            if isinstance(item, ArraySpec):
                specs[name] = item
    return specs


def check_letters(message: BaseModel) -> None:
    """Raise InvalidInputError where two array fields of a message disagree about the size of a letter."""
    bound: dict[str, tuple[int, str]] = {}
    for name, spec in array_specs(type(message)).items():
        shape = getattr(message, name).shape
        for letter, size in spec.check_shape(shape, name).items():
            first_size, first_name = bound.setdefault(letter, (size, name))
            if size != first_size:
                raise InvalidInputError(
                    f"{name} has {letter} = {size}, but {first_name} has {letter} = {first_size}",
                    field=name,
                    allowed=f"{letter} = {first_size}, as {first_name}",
                )
