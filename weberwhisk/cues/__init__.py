"""The paper's methods of radial distance determination (§2a–h), behind one protocol."""

from .compliance import Compliance
from .force_map import ForceMap
from .fused import Fused
from .lateral_slip import LateralSlip
from .protocol import Cue
from .space_map import SpaceMap
from .unknown_stiffness import UnknownStiffness
from .vibration import Vibration

__all__ = [
    "Compliance",
    "Cue",
    "ForceMap",
    "Fused",
    "LateralSlip",
    "SpaceMap",
    "UnknownStiffness",
    "Vibration",
]
