"""Bounds of what the tables of an experiment say."""

from typing import Annotated

import msgspec

Seed = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]
Seconds = Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)]
Size = Annotated[float, msgspec.Meta(ge=0.0, le=100.0)]
