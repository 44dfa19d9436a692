"""What all sections of a rig description have in common."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Channel = Annotated[int, Field(ge=1, le=1024)]


class Section(BaseModel):
    """A part of the description: immutable, unknown keys refused, no silent NaN."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
