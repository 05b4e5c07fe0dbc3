"""Fields that requests are made of: finite numbers, names that read as what they are."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from service.messages.names import plain_text

__all__ = ["Finite", "Integer", "Matrix", "Name", "Number", "Pair", "Positive", "Request", "Title"]


def _number(value: object) -> object:
    """JSON's ``true`` and ``"1"`` are no numbers, its ``1.0`` is an integer."""
    if isinstance(value, (bool, str)):
        raise ValueError("expected a number")
    return value


Finite = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e9, le=1e9)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0, le=1e15)]
Integer = Annotated[int, BeforeValidator(_number)]
Number = Annotated[Integer, Field(ge=0, le=2**31 - 2)]
Name = Annotated[
    str, Field(min_length=1, max_length=100, pattern=r"^[^\x00-\x1f\x7f]+$"), AfterValidator(plain_text)
]
Title = Annotated[str, Field(max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$"), AfterValidator(plain_text)]
Pair = Annotated[list[Finite], Field(fail_fast=True, min_length=2, max_length=2)]
Matrix = Annotated[list[Pair], Field(fail_fast=True, min_length=2, max_length=2)]


class Request(BaseModel):
    """Base: immutable, no unknown fields."""

    model_config = ConfigDict(extra="forbid", frozen=True)
