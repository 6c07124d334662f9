"""What a model of the mechanics leaves out, in JNDs of the distance, and which model will do.

The bias of the contact under a model is (JᵀWJ)⁻¹JᵀWδ to first order, with δ what its signals are
off by, and JᵀWJ the information. Below, `observer` is an `Observer`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .cues.protocol import Felt
from .mechanics.contact import Outcome

Array = NDArray[np.float64]


class Chosen(str):
    """The name of a model that an observer chose: whoever is made from it chooses again."""


def chosen(observer: Any) -> Chosen:
    """The cheapest model that will do."""
    forward = observer.forward
    if forward.is_plain:
        return Chosen("elastica")
    best = "profile" if forward.azimuth is None else "rod"
    if not forward.is_smooth:
        return Chosen(best)
    return Chosen("elastica" if of_model(observer, "elastica") < observer.tolerance else best)


def why(observer: Any) -> str:
    """Which model of the mechanics serves an observer, and why."""
    if not isinstance(observer.model, Chosen):
        return f"{observer.model} was asked for"
    forward = observer.forward
    if forward.is_plain:
        return (
            "the elastica models all there is; the closed form is off by up to "
            f"{of_model(observer, 'closed_form'):.2g} JND, {observer.tolerance:g} allowed"
        )
    whole = "the rod" if forward.azimuth is not None else "the curved planar beam"
    if not forward.is_smooth:
        return f"{whole} models all there is, and nothing cheaper does"
    off = f"the straight elastica is off by up to {of_model(observer, 'elastica'):.2g} JND"
    start = "" if observer.model == "elastica" else f"{whole} models all there is; "
    return f"{start}{off}, {observer.tolerance:g} allowed"


def note(observer: Any) -> str:
    """A named whisker's shape that is taken as straight, an untold roll, and an imprecise table."""
    return "; ".join(filter(None, (_shape_at_rest(observer), _roll(observer), _table(observer))))


def _roll(observer: Any) -> str:
    straight = observer.forward.is_plain or observer.solver == "elastica"
    if "roll" not in observer.unknowns or not straight:
        return ""
    return (
        "Of a whisker that is taken as straight nothing tells the roll: it is as its prior has it"
    )


def _table(observer: Any) -> str:
    cue, forward = observer.cue, observer.forward
    fractions = observer.noise.weber_fractions(len(cue.signal_names))
    least = float(np.min(fractions, where=fractions > 0, initial=1.0))
    if not cue.takes_curved or observer.solver is not None or forward.error <= 0.01 * least:
        return ""
    return (
        f"The table of this whisker is off by up to {forward.error:.1g} of the lateral force, "
        f'{forward.error / least:.1g} of a Weber fraction: write model="{observer.model}"'
    )


def _shape_at_rest(observer: Any) -> str:
    off = of_shape_at_rest(observer)
    if off < 1:
        return ""
    return (
        f"{observer.whisker.identity[1]} is taken as straight; its shape at rest moves r by up to "
        f"{off:.2g} JND: write curved=True"
    )


def of_shape_at_rest(observer: Any) -> float:
    """Largest bias, at 16 contacts, of taking a named whisker as straight, JNDs; of others 0."""
    cue, whisker = observer.cue, observer.whisker
    of = getattr(whisker, "identity", None)
    if of is None or np.any(whisker.curvature) or not cue.takes_curved:
        return 0.0
    contact = observer.contact(observer.space.spread(np.linspace(0.15, 0.85, 4)))[0]
    model = "rod" if "azimuth" in cue.unknowns else "profile"
    exact = cue.signals(replace(whisker, curvature=of[2]), contact, model=model)
    return between(observer, contact, cue.signals(whisker, contact), exact)


def of_model(observer: Any, model: str) -> float:
    """Largest bias that a model brings at 36 contacts in the reach, JNDs."""
    contact = observer.contact(observer.space.spread(np.linspace(0.1, 0.9, 6)))[0]
    exact = observer.cue.signals(observer.whisker, contact)
    rough = observer.cue.signals(observer.whisker, contact, model=model)
    return between(observer, contact, exact, rough)


def between(observer: Any, contact: Array, one: Felt, other: Felt) -> float:
    """Largest bias between two sets of signals of contacts, JNDs."""
    (exact, outcome), (rough, held) = one, other
    known = (outcome == Outcome.HELD) & (held == Outcome.HELD)
    contact, exact, off = contact[known], exact[known], (rough - exact)[known]
    unit = np.maximum(np.abs(contact), 1e-12)
    slope = observer.cue.jacobian(observer.whisker, contact) * unit[:, None]
    weight = np.swapaxes(slope, -1, -2) @ observer.noise.fisher(exact)
    prior = observer.prior_information(contact) * unit[:, None] * unit[..., None]
    inverse = np.linalg.pinv(weight @ slope + prior, rcond=1e-12, hermitian=True)
    bias = (inverse @ weight @ off[..., None])[:, 0, 0] / np.sqrt(inverse[:, 0, 0])
    return float(np.max(np.abs(bias), initial=0.0))
