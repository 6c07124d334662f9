"""The paper's methods of radial distance determination (§2a–h), behind one protocol."""

from .compliance import Compliance
from .force_map import ForceMap
from .protocol import Cue
from .vibrissa_length import VibrissaLength

__all__ = ["Compliance", "Cue", "ForceMap", "VibrissaLength"]
