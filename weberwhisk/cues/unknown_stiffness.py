"""Any cue of forces, on a whisker whose stiffness is known up to a factor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._checks import one_or_more, positive_number, refuse_hinge
from ..mechanics.forward import ForwardModel
from ..receptors import ReceptorNoise
from ..whisker import Whisker
from .protocol import Array, Cue, Felt, a_cue

#: Sd of ln E that goes with 3.34 ± 1.48 GPa (Quist, Faruqi & Hartmann 2011).
MODULUS_SPREAD = 0.42


#: Signals that are proportional to EI₀.
FORCES = ("moment", "axial_force", "transverse_force", "moment_rate")


@dataclass(frozen=True, eq=False, repr=False, init=False)
class UnknownStiffness(Cue):
    """A cue of one more unknown, ``"stiffness"``: EI₀ over what the whisker says it is.

    Forces and moments are proportional to EI₀ at a given contact, so any cue of them can be
    wrapped, fusions too. Signals of several cues made soft this way share the unknown.

    Parameters
    ----------
    cue : Cue
    spread : float
        Sd of the log-normal prior's ln; its median is 1. By default that of measured moduli.
    signals : sequence of str, optional
        The cue's signals that are proportional to EI₀; by default its forces, moments and rates of
        moments, and not its angles, ratios or chances.

    Raises
    ------
    ValueError
        For a spread that is not positive, a signal that the cue has not, a cue whose stiffness is
        unknown already or that feels no force.

    Examples
    --------
    >>> from weberwhisk.cues import ForceMap
    >>> cue = UnknownStiffness(ForceMap())
    >>> cue.unknowns
    ('radial_distance', 'deflection_angle', 'stiffness')
    >>> w = Whisker(50e-3, 100e-6, 5e-6)
    >>> plain, _ = ForceMap().signals(w, np.array([30e-3, 0.2]))
    >>> soft, _ = cue.signals(w, np.array([30e-3, 0.2, 0.5]))
    >>> soft / plain
    array([0.5, 0.5])
    """

    cue: Cue
    spread: float
    soft: tuple[str, ...]

    def __init__(
        self, cue: Cue, spread: float = MODULUS_SPREAD, signals: Sequence[str] | None = None
    ) -> None:
        names = a_cue(cue).signal_names
        spread = positive_number("spread", spread, "give the sd of ln EI₀, such as 0.42")
        if "stiffness" in cue.unknowns:
            raise ValueError(f"The stiffness is unknown in {cue!r} already; leave it as it is.")
        if signals is None:
            # The signals of a fusion are numbered where a name comes twice.
            signals = [name for name in names if name.rstrip("_0123456789") in FORCES]
            if not signals:
                raise ValueError(
                    f"Of the signals of {cue!r} ({', '.join(names)}) none is a force or a "
                    "moment that goes with the stiffness; use the cue as it is."
                )
        self._set(cue=cue, spread=spread, soft=one_or_more("signals", signals, names))

    def __repr__(self) -> str:
        return f"UnknownStiffness({self.cue!r}, {self.spread:g})"

    @property
    def signal_names(self) -> tuple[str, ...]:
        """Those of the cue."""
        return self.cue.signal_names

    @property
    def unknowns(self) -> tuple[str, ...]:
        """Those of the cue, and the stiffness."""
        return (*self.cue.unknowns, "stiffness")

    @property
    def takes_curved(self) -> bool:  # type: ignore[override]
        """As the cue does."""
        return self.cue.takes_curved

    def forward(self, whisker: Any, contact: Array) -> ForwardModel:
        """The cue's."""
        return self.cue.forward(whisker, contact[..., :-1])

    @cached_property
    def _soft(self) -> NDArray[np.bool_]:
        return np.isin(self.cue.signal_names, self.soft)

    @property
    def is_scale(self) -> bool:
        """Whether every signal is proportional to the stiffness."""
        return bool(self._soft.all())

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Felt:
        """The cue's signals (..., S), those of force times the stiffness, and the outcome."""
        refuse_hinge(whisker, "UnknownStiffness, under which forces grow with EI₀ alone,")
        contact = np.asarray(contact, dtype=float)
        signals, outcome = self.cue.signals(whisker, contact[..., :-1], model=model)
        return signals * np.where(self._soft, contact[..., -1:], 1.0), outcome

    def given(
        self, whisker: Whisker, contact: Array, *, model: str | None = None
    ) -> Callable[[Array], Felt]:
        """The signals as a function of the stiffness (...), the rest of the contact given."""
        signals, outcome = self.cue.signals(whisker, contact, model=model)
        return lambda factor: (
            signals * np.where(self._soft, factor[..., None], 1.0)
            if not self.is_scale
            else signals * factor[..., None],
            outcome,
        )

    def jacobian(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Array:
        """Derivatives of the signals to the cue's unknowns and the stiffness, (..., S, U)."""
        contact = np.asarray(contact, dtype=float)
        inner = contact[..., :-1]
        factor = np.where(self._soft, contact[..., -1:], 1.0)
        slope = self.cue.jacobian(whisker, inner, model=model) * factor[..., None]
        signals, _ = self.cue.signals(whisker, inner, model=model)
        return np.concatenate([slope, np.where(self._soft, signals, 0.0)[..., None]], axis=-1)

    def priors(self, whisker: Whisker) -> dict[str, Any]:
        """The cue's, and log-normal of the stiffness."""
        refuse_hinge(whisker, "UnknownStiffness, under which forces grow with EI₀ alone,")
        from scipy.stats import lognorm

        return {**self.cue.priors(whisker), "stiffness": lognorm(self.spread)}

    def default_noise(self) -> ReceptorNoise:
        """The cue's."""
        return self.cue.default_noise()

    def farthest(self, whisker: Whisker) -> float:
        """As far as the cue works, m."""
        return self.cue.farthest(whisker)
