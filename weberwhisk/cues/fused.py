"""Several cues on one contact (§2: "none of the methods exclude any others")."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..mechanics.contact import Outcome
from ..mechanics.forward import ForwardModel, forward_of
from ..receptors import Joint, ReceptorNoise
from ..whisker import Whisker
from .protocol import Array, Cue, Felt, a_cue


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Fused(Cue):
    """Cues that are felt of one contact at once: a cue itself.

    What several cues do not know by the same name is one unknown, shared. Signals stand one after
    the other, each cue's receptors with their own noise. A contact is held where it is for every
    cue.

    Parameters
    ----------
    *cues : Cue
        Two or more, other fusions among them. Two of one kind are two looks at one contact.

    Raises
    ------
    ValueError
        For fewer than two cues, and anything that is no cue.

    Examples
    --------
    >>> from weberwhisk import Observer, Whisker
    >>> from weberwhisk.cues import Compliance, ForceMap
    >>> from weberwhisk.jnd import fisher_jnd
    >>> both = Fused(Compliance(), ForceMap())
    >>> both.signal_names, both.unknowns
    (('moment_rate', 'moment', 'axial_force'), ('radial_distance', 'deflection_angle'))
    >>> w = Whisker(50e-3, 100e-6, 5e-6)
    >>> jnds = [fisher_jnd(Observer(w, cue), both.part(cue, np.array([30e-3, 0.2])))
    ...         for cue in (*both.cues, both)]
    >>> print("%.2f and %.2f mm alone, %.2f mm together" % tuple(1e3 * d for d in jnds))
    1.28 and 2.75 mm alone, 1.16 mm together
    """

    cues: tuple[Cue, ...]

    def __init__(self, *cues: Cue) -> None:
        if len(cues) < 2:
            raise ValueError(
                f"A fusion takes two cues or more, got {len(cues)}; "
                "write Fused(Compliance(), ForceMap()), say."
            )
        self._set(cues=tuple(map(a_cue, cues)))

    @cached_property
    def signal_names(self) -> tuple[str, ...]:
        """Those of all cues; one that several have, with the cue's number behind it."""
        return _distinct([c.signal_names for c in self.cues])

    @property
    def circular(self) -> tuple[bool, ...]:
        """Those of all cues."""
        return tuple(turns for cue in self.cues for turns in cue.circular)

    @cached_property
    def unknowns(self) -> tuple[str, ...]:
        """All that any cue does not know; those that the whisker bounds come first."""
        named = dict.fromkeys(name for cue in self.cues for name in cue.unknowns)
        return tuple(sorted(named, key=lambda n: _FIRST.index(n) if n in _FIRST else len(_FIRST)))

    def __repr__(self) -> str:
        return f"Fused({', '.join(map(repr, self.cues))})"

    @property
    def takes_curved(self) -> bool:  # type: ignore[override]
        """Where all cues do, in one plane."""
        return all(cue.takes_curved and "azimuth" not in cue.unknowns for cue in self.cues)

    def forward(self, whisker: Any, contact: Array) -> ForwardModel:
        """With all that any of the cues does not know."""
        out = forward_of(whisker)
        for cue in self.cues:
            out = cue.forward(out, self.part(cue, contact))
        return out

    def part(self, cue: Cue, contact: Array) -> Array:
        """What one cue does not know of a contact (..., U): (..., its own unknowns)."""
        return np.asarray(contact, dtype=float)[
            ..., [self.unknowns.index(name) for name in cue.unknowns]
        ]

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Felt:
        """Signals of all cues (..., S); the outcome is that of the first cue that fails."""
        felt = [c.signals(whisker, self.part(c, contact), model=model) for c in self.cues]
        return self._together(felt)

    def given(
        self, whisker: Whisker, contact: Array, *, model: str | None = None
    ) -> Callable[[Array], Felt]:
        """The signals as a function of the last unknown (...): cues that know it feel the same."""
        *known, last = self.unknowns
        parts: list[Callable[[Array], Felt]] = []
        for cue in self.cues:
            place = contact[..., [known.index(name) for name in cue.unknowns if name != last]]
            if last not in cue.unknowns:
                parts.append(partial(_same, cue.signals(whisker, place, model=model)))
            elif cue.unknowns[-1] == last:
                parts.append(cue.given(whisker, place, model=model))
            else:
                parts.append(
                    partial(_inserted, cue, cue.unknowns.index(last), whisker, place, model)
                )
        return lambda value: self._together([part(value) for part in parts])

    def _together(self, felt: Sequence[Felt]) -> Felt:
        """All signals, and the outcome of the first cue that fails."""
        outcome = felt[0][1]
        for _, other in felt[1:]:
            outcome = np.where(outcome == Outcome.HELD, other, outcome)
        signals = np.concatenate([s for s, _ in felt], axis=-1)
        lost = outcome != Outcome.HELD
        if lost.any():
            signals[lost] = np.nan
        return signals, np.asarray(outcome, dtype=np.int8)

    def jacobian(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Array:
        """Derivatives of all signals to all unknowns, (..., S, U)."""
        contact = np.asarray(contact, dtype=float)
        out = np.zeros((*contact.shape[:-1], len(self.signal_names), len(self.unknowns)))
        row = 0
        for cue in self.cues:
            columns = [self.unknowns.index(name) for name in cue.unknowns]
            slope = cue.jacobian(whisker, self.part(cue, contact), model=model)
            out[..., row : row + slope.shape[-2], columns] = slope
            row += slope.shape[-2]
        return out

    def reading_outcome(self, whisker: Whisker, reading: Array) -> NDArray[np.int8]:
        """That of the first cue to which its part of the readings (..., R) gives no contact."""
        outcome = np.zeros(reading.shape[:-1], dtype=np.int8)
        start = 0
        for cue in self.cues:
            stop = start + cue.default_noise().reading_size(len(cue.signal_names))
            own = cue.reading_outcome(whisker, reading[..., start:stop])
            outcome = np.where(outcome == Outcome.HELD, own, outcome)
            start = stop
        return outcome

    def priors(self, whisker: Whisker) -> dict[str, Any]:
        """Those of the cues; of an unknown that is shared, the first cue's."""
        out: dict[str, Any] = {}
        for cue in self.cues:
            out = {**cue.priors(whisker), **out}
        return out

    def joint(self, *noises: ReceptorNoise) -> Joint:
        """One noise model for each cue's signals, put together.

        Raises
        ------
        ValueError
            For other than one for each cue.
        """
        if len(noises) != len(self.cues):
            raise ValueError(
                f"Each of the {len(self.cues)} cues needs one noise model, got {len(noises)}; "
                "write fused.joint(Weber(0.1), Weber(0.05)), say."
            )
        return Joint(noises, [len(cue.signal_names) for cue in self.cues])

    def default_noise(self) -> Joint:
        """The cues' own."""
        return self.joint(*(cue.default_noise() for cue in self.cues))

    def farthest(self, whisker: Whisker) -> float:
        """As far as all cues work, m."""
        return min(cue.farthest(whisker) for cue in self.cues)

    def largest_angle(self, whisker: Whisker, radial_distance: Array) -> Array:
        """The least of the cues' largest deflections (...), rad; infinite where none has one."""
        least = np.full(np.shape(radial_distance), np.inf)
        for cue in self.cues:
            least = np.minimum(least, cue.largest_angle(whisker, radial_distance))
        return least


#: The unknowns that the whisker bounds, in the order of the protocol.
_FIRST = ("radial_distance", "deflection_angle")


def _distinct(groups: list[tuple[str, ...]]) -> tuple[str, ...]:
    """All names; one that several groups have, with the group's number behind it."""
    every = [name for group in groups for name in group]
    return tuple(
        name if every.count(name) == 1 else f"{name}_{i}"
        for i, group in enumerate(groups, start=1)
        for name in group
    )


def _same(felt: Felt, last: Array) -> Felt:
    """What is felt whatever the last unknown is."""
    return felt


def _inserted(
    cue: Cue, index: int, whisker: Whisker, contact: Array, model: str | None, last: Array
) -> Felt:
    """What a cue feels to which the fusion's last unknown is one in between."""
    return cue.signals(whisker, np.insert(contact, index, last, axis=-1), model=model)
