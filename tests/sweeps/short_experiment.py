"""A second of the linear loop on two tissues, as a spec's file has it, for tests."""

from typing import Any

EXPERIMENT: dict[str, Any] = {
    "published": "table-1",
    "duration": 1.0,
    "settle": 0.3,
    "stiffness": [375.0, 1900.0],
    "reference": {"z": -5.0},
}
