"""The paper's methods of radial distance determination (§2a–h), behind one protocol."""

from .angle_side_angle import AngleSideAngle, ContactAndDetachment, TwoWhiskers
from .balance_of_moments import BalanceOfMoments, MuscleCurve
from .force_map import ForceMap, SpaceMap
from .protocol import Cue, Fused
from .taps import Compliance, Vibration
from .unknowns import Friction, UnknownCurvature, UnknownHinge, UnknownRoll, UnknownStiffness
from .vibrissa_length import ComparativeLength, VibrissaLength

__all__ = [
    "AngleSideAngle", "BalanceOfMoments", "ComparativeLength", "Compliance", "ContactAndDetachment",
    "Cue", "ForceMap", "Friction", "Fused", "MuscleCurve", "SpaceMap", "TwoWhiskers",
    "UnknownCurvature", "UnknownHinge", "UnknownRoll", "UnknownStiffness", "Vibration",
    "VibrissaLength",
]  # fmt: skip
