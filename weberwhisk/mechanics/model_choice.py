"""The cheapest model whose bias in the inferred radial distance is a small part of its JND.

The bias to first order is derived in ``docs/theory/models.md``. Each scene is solved with every
model up to the one that leaves nothing out. For an `Observer` the model is chosen by the largest
bias over contacts throughout the reach.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._util.checks import finite, positive
from .._util.refusals import Advice, Refusal, argument
from .._util.values import Array, Codes, Line, member
from ..whisker import Whisker, rest_shape, usual_curvature, usual_turn
from .contact import Model, Outcome, friction, signals_of
from .equilibrium import common_shape
from .ladder import press_by, signal_jacobian
from .profile import rest_angle
from .shape import Profile, Spiral

__all__ = ["Choice", "Chosen", "choose_model", "chosen", "note", "of_shape_at_rest", "why"]

#: The row of the base signals with the relative error of each signal of a cue.
_SENSED = {"moment": 0, "axial_force": 1, "transverse_force": 2, "moment_rate": 0}
_UNKNOWNS = (("radial_distance",), ("radial_distance", "deflection_angle"))


@dataclass(frozen=True, eq=False, repr=False)
class Choice(Line):
    """The model that each scene needs, and why: what `choose_model` returns.

    Attributes
    ----------
    model : Model or array of int
        The cheapest model whose bias is within the tolerance.
    error : array (..., 4)
        Largest relative error of the moment and the two forces, by model. Infinite where a model
        finds no contact, 0 from the first model on that leaves nothing out.
    bias : array (..., 4)
        Shift of the inferred radial distance by that error, in JNDs, by model; the error itself
        where no Weber fraction was given.
    tolerance : float or array
        The largest bias allowed.
    unit : str
        Unit of bias and tolerance.
    """

    model: Model | Codes
    error: Array
    bias: Array
    tolerance: ArrayLike
    unit: str = "JND"

    def _line(self) -> str:
        models, counts = np.unique(self.model, return_counts=True)
        if np.ndim(self.model) == 0:
            return str(self.why)
        return ", ".join(f"{Model(m).message} for {n}" for m, n in zip(models, counts, strict=True))

    @property
    def why(self) -> str | NDArray[np.object_]:
        """The reason in words: one sentence, or an array of them."""
        tolerance = np.broadcast_to(self.tolerance, np.shape(self.model))
        why = np.empty(np.shape(self.model), dtype=object)
        for at in np.ndindex(why.shape):
            model = Model(int(np.asarray(self.model)[at]))
            why[at] = _reason(model, self.bias[at], float(tolerance[at]), self.unit)
        return str(why[()]) if why.ndim == 0 else why


def _reason(model: Model, bias: Array, allowed: float, unit: str) -> str:
    here = f"{model.message} is off by {_shown(bias[model], allowed)} {unit}"
    if bias[model] == 0:
        here = f"{model.message} models all there is in this scene"
    if model == Model.CLOSED_FORM:
        return f"{here}, {allowed:g} allowed, and nothing is cheaper"
    below = Model(model - 1)
    if np.isinf(bias[below]):
        return f"{here}; {below.message} finds no contact here"
    there = f"{below.message} is off by {_shown(bias[below], allowed)} {unit}"
    return f"{here}; {there}, {allowed:g} allowed"


def _shown(bias: float, allowed: float) -> str:
    """A bias in two digits, or in as many as distinguish it from the bias that is allowed."""
    for digits in range(2, 17):
        text = f"{bias:.{digits}g}"
        if np.sign(float(text) - float(f"{allowed:g}")) == np.sign(bias - allowed):
            break
    return text


def choose_model(
    whisker: Whisker | Profile,
    radial_distance: ArrayLike,
    deflection_angle: ArrayLike,
    friction_angle: ArrayLike = 0.0,
    *,
    roll: ArrayLike = 0.0,
    cue: Any = None,
    weber_fraction: ArrayLike | None = 0.1,
    tolerance: ArrayLike = 0.1,
) -> Choice:
    """The cheapest model that each scene needs, and why.

    Parameters
    ----------
    whisker : Whisker or Profile
    radial_distance, deflection_angle, friction_angle, roll : float or array
        The scenes, as for `press`.
    cue : object with `signal_names` and `unknowns`, optional
        The signals that inform of the distance, such as ``cues.ForceMap()``; by default the moment
        at a known deflection angle, as in ``cues.Compliance()``.
    weber_fraction : float or array, or None
        k of each signal's noise. None: the model is chosen by the error of the signals.
    tolerance : float or array
        Largest bias of the inferred radial distance, as a fraction of its JND; without a Weber
        fraction the largest relative error of the moment and the two forces.

    Returns
    -------
    Choice
        With arrays of the broadcast shape.

    Raises
    ------
    ValueError
        As for `press`, for a Weber fraction or a tolerance that is not positive, and for a cue of
        signals that are not among moment, axial and transverse force.

    Notes
    -----
    To first order in the error. Each scene is solved with every model that it may need.

    Examples
    --------
    >>> w = Whisker(50e-3, 100e-6, 5e-6, curvature=0.5)
    >>> choice = choose_model(w, 25e-3, np.radians([1.0, 20.0]), weber_fraction=0.1)
    >>> choice.model
    array([0, 1], dtype=int8)
    >>> print(choice.why[1])
    the straight elastica is off by 0.039 JND; the closed form is off by 1 JND, 0.1 allowed
    """
    names, unknowns = _spec(cue)
    hint = "give a fraction, such as 0.1"
    noise = 1.0 if weber_fraction is None else weber_fraction
    k, allowed = positive("weber_fraction", noise, hint), positive("tolerance", tolerance, hint)
    r = positive("radial_distance", radial_distance, "give metres, such as 35e-3")
    theta = finite("deflection_angle", deflection_angle, "give radians, such as 0.35")
    tilt = friction(friction_angle)
    turn = finite("roll", roll, "give radians, 0 for contact in the plane of curvature")
    given = {"radial_distance": r, "deflection_angle": theta, "friction_angle": tilt, "roll": turn,
             "weber_fraction": k, "tolerance": allowed}  # fmt: skip
    shape = common_shape(Profile.of(whisker), given)
    theta = np.broadcast_to(_pushed(whisker, r, theta, turn), shape)
    top = np.broadcast_to(_top(whisker, tilt, turn), shape)
    scene = whisker, r, theta, tilt, turn
    error, off = _biases(scene, top, [_SENSED[name] for name in names], unknowns)
    bias = error if weber_fraction is None else off / k
    model = member(Model, np.argmax(bias <= allowed, axis=0).astype(np.int8))
    unit = "of a signal" if weber_fraction is None else "JND"
    return Choice(model, np.moveaxis(error, 0, -1), np.moveaxis(bias, 0, -1), tolerance, unit)


def _spec(cue: Any) -> tuple[tuple[str, ...], bool]:
    """The names of the signals, and whether the deflection angle is unknown."""
    if cue is None:
        return ("moment",), False
    names, unknowns = tuple(cue.signal_names), tuple(cue.unknowns)
    if not set(names) <= set(_SENSED) or unknowns not in _UNKNOWNS or len(names) < len(unknowns):
        raise Refusal(
            f"A model is chosen for cues of {', '.join(_SENSED)} with no more unknowns "
            "(radial_distance, deflection_angle) than signals",
            f"{', '.join(names)} for {', '.join(unknowns)}",
            "write cue=ww.cues.ForceMap()",
        )
    return names, unknowns == _UNKNOWNS[1]


def _pushed(whisker: Whisker | Profile, r: Array, theta: Array, roll: Array) -> Array:
    """Angles with pushes of at least 1e-6 rad: signals are proportional to smaller ones."""
    rest = rest_angle(whisker, r)
    push = theta - np.arctan2(np.sin(rest) * np.cos(roll), np.cos(rest))
    nudge = np.where(push < 0, -1e-6, 1e-6) - push
    return theta + np.where(np.abs(push) < 1e-6, nudge, 0.0)


def _top(whisker: Whisker | Profile, tilt: Array, roll: Array) -> Codes:
    """The lowest model that leaves nothing out, (...)."""
    whole = Profile.of(whisker)
    taper = len(whole.arc) == 2 and not np.any(whole.core)
    laws = np.broadcast_arrays(*[value != 0 for value in vars(whole.law).values()])
    curved = np.any(laws, axis=0)
    planar = curved | (tilt != 0) | (not taper)
    model = np.where(planar, Model.PROFILE, Model.ELASTICA)
    return np.where(curved & (np.sin(roll) != 0), Model.ROD, model).astype(np.int8)


def _biases(
    scene: tuple[Any, Any, Any, Any, Any], top: Codes, sensed: list[int], angle_unknown: bool
) -> tuple[Array, Array]:
    """Largest relative error of any signal, and that along the direction of r, (4, ...) each."""
    last = int(top.max(initial=0))
    signals = np.full((4, 3, *top.shape), np.nan)
    for model in range(last + 1):
        bent = press_by(*scene, Model(model))
        signals[model] = np.where(bent.held, np.moveaxis(signals_of(bent), -1, 0), np.nan)
    true = np.take_along_axis(signals, top[None, None].astype(np.intp), axis=0)[0]
    with np.errstate(all="ignore"):
        off = signals / true - 1
        above = np.arange(4).reshape(-1, *(1,) * (off.ndim - 1)) >= top
        relative = np.where(above, 0.0, np.nan_to_num(np.abs(off), nan=np.inf, posinf=np.inf))
        worst = relative.max(axis=1)
        if len(sensed) == 1:
            return worst, relative[:, sensed[0]]
        slopes = np.moveaxis(signal_jacobian(*scene[:4], roll=scene[4]), (-2, -1), (0, 1))
        slopes = slopes[sensed] / true[sensed][:, None]
        signed = np.where(relative > 0, off, 0.0)[:, sensed]
        along = np.abs((_direction(slopes, angle_unknown) * signed).sum(axis=1))
    # Where slopes are missing, as at a fold, the largest error of any signal stands in.
    return worst, np.where(np.isfinite(along), along, worst)


def _direction(slopes: Array, angle_unknown: bool) -> Array:
    """The unit vector of relative signals (S, ...) that informs of r, from ∂ln s/∂(r, θ_d)."""
    to_r, to_angle = slopes[:, 0], slopes[:, 1]
    if angle_unknown and len(to_r) == 2:  # also where the two columns are parallel: a ridge
        to_r = np.stack([to_angle[1], -to_angle[0]])
    elif angle_unknown:
        to_r = to_r - to_angle * (to_angle * to_r).sum(axis=0) / (to_angle**2).sum(axis=0)
    return np.asarray(to_r / np.sqrt((to_r**2).sum(axis=0)))


# -- for observers --------------------------------------------------------------------------------


class Chosen(str):
    """The name of a model that an observer chose; observers made from that one choose again."""


def chosen(observer: Any) -> Chosen:
    """The cheapest model whose bias is below the observer's tolerance."""
    forward = observer.forward
    if forward.is_plain:
        return Chosen("elastica")
    best = "profile" if forward.azimuth is None else "rod"
    if not forward.is_smooth:
        return Chosen(best)
    return Chosen("elastica" if of_model(observer, "elastica") < observer.tolerance else best)


def why(observer: Any) -> str:
    """Why an observer uses its model of the mechanics, in words."""
    if not isinstance(observer.model, Chosen):
        return f"{observer.model} was requested"
    forward = observer.forward
    if forward.is_plain:
        return (
            "the elastica models all there is; the closed form is off by up to "
            f"{of_model(observer, 'closed_form'):.2g} JND, {observer.tolerance:g} allowed"
        )
    whole = "the rod" if forward.azimuth is not None else "the curved planar beam"
    if not forward.is_smooth:
        return f"{whole} models all there is, and nothing cheaper does"
    bias = of_model(observer, "elastica")
    if np.isinf(bias):
        return f"{whole} models all there is; the straight elastica has contacts lost that are held"
    off = f"the straight elastica is off by up to {bias:.2g} JND"
    start = "" if observer.model == "elastica" else f"{whole} models all there is; "
    return f"{start}{off}, {observer.tolerance:g} allowed"


def note(observer: Any) -> str:
    """Warnings: shape at rest left out, no information about the roll, imprecise table."""
    given = (_shape_at_rest(observer), _roll(observer), _table(observer))
    return Advice.joined("; ", filter(None, given))


def _roll(observer: Any) -> str:
    straight = observer.forward.is_flat or observer.solver == "elastica"
    if "roll" not in observer.unknowns or not straight:
        return ""
    return "A whisker taken as straight does not inform of the roll: its posterior is its prior"


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
    whisker = getattr(observer.whisker, "whisker", observer.whisker)
    named = whisker.identity
    straight = observer.whisker is whisker and not np.any(whisker.curvature)
    assumed = straight and usual_curvature(whisker) is not None
    if named is not None and assumed and not _takes_curved(observer):
        return (
            f"{named[1]} is taken as straight: what its shape at rest does to this cue is unknown"
        )
    off = of_shape_at_rest(observer)
    if off < 1:
        return ""
    if named is None:
        bow = usual_turn() / whisker.length
        return (
            f"Taken as straight; the usual curvature of rats' whiskers, {bow:.2g} /m, moves r by "
            f"up to {off:.2g} JND: write " + argument("curvature", float(f"{bow:.2g}")) + ", or 0"
        )
    if not np.any(whisker.curvature):
        return (
            f"{named[1]} is taken as straight; its shape at rest moves r by up to {off:.2g} JND: "
            "write " + argument("curved", True)
        )
    mirrored = ".scaled(1, -1)" if _side_of_law(whisker) < 0 else ""
    law = f"ww.mechanics.Spiral(*ww.mechanics.rest_shape({named[1]!r}, {named[0]!r})){mirrored}"
    return (
        f"{named[1]} is taken as an arc; its measured shape at rest moves r by up to {off:.2g} "
        f"JND: write ww.mechanics.Profile.of(whisker).curved({law})"
    )


def _takes_curved(observer: Any) -> bool:
    """Whether it can take the shape at rest into account."""
    if not observer.cue.takes_curved or "azimuth" not in observer.unknowns:
        return bool(observer.cue.takes_curved)
    forward = observer.forward  # in space curved ones take no hinge, and with more unknown seconds
    ends = forward.friction_range, forward.offset_range
    return not (forward.is_hinged or np.ptp(ends, axis=1).any())


def _side_of_law(whisker: Whisker) -> float:
    """1 of a named whisker that is curved as its measured law is, −1 of its mirror image."""
    species, follicle, _ = whisker.identity or ("", "", 0.0)
    turn = Spiral(*rest_shape(follicle, species)).turn(np.array(whisker.length))
    return float(np.sign(turn * whisker.curvature))


def _at_rest(whisker: Whisker | Profile) -> Whisker | Profile | None:
    """The whisker with its shape at rest if that was not given, or as an arc, else None."""
    if isinstance(whisker, Profile):
        plain, straight = whisker.whisker, not np.any(whisker.law(whisker.arc[[0, -1]]))
    else:
        plain, straight = whisker, not np.any(whisker.curvature)
    is_arc = not straight and plain is whisker and plain.hinge_stiffness is None
    if plain.identity is not None and is_arc:
        species, follicle, _ = plain.identity
        law = Spiral(*rest_shape(follicle, species)).scaled(np.ones(()), _side_of_law(plain))
        return Profile.of(plain).curved(law)
    bow = usual_curvature(plain)
    if bow is None or not straight:
        return None
    if isinstance(whisker, Profile):
        return whisker.curved(Spiral(bow))
    return replace(plain, curvature=bow)


def of_shape_at_rest(observer: Any) -> float:
    """Largest bias from replacing the shape at rest, JNDs; 0 where that shape is given.

    Named whiskers taken as straight or as arcs are compared with their measured shape, others
    without a curvature with the rat's usual one. First at 4 distances (by 4 angles) in the middle
    of the reach; if the bias is below 1 JND there, at 36 (6 by 6) over all but a fiftieth at its
    ends, as the bias is largest next to the tip.
    """
    cue, whisker = observer.cue, observer.whisker
    real = _at_rest(whisker) if _takes_curved(observer) else None
    if real is None:
        return 0.0
    model = "rod" if "azimuth" in cue.unknowns else "profile"
    off = 0.0
    for end, each in ((0.15, 4), (0.02, 36 if observer.bounded == 1 else 6)):
        places = observer.space.spread(np.linspace(end, 1 - end, each))
        contact, _ = observer.space.constrain(places)
        exact = cue.signals(real, contact, model=model)
        off = between(observer, contact, cue.signals(whisker, contact), exact)
        if off >= 1:
            break
    return off


def of_model(observer: Any, model: str) -> float:
    """Largest bias of a model at 144 contacts over the reach, less a fiftieth at its ends, JNDs.

    Less a tenth it would be 0.1 JND where 0.8 was found. Infinite where the model loses a contact
    that is stable: it rules that distance out.
    """
    each = 144 if observer.bounded == 1 else 12
    contact = observer.space.constrain(observer.space.spread(np.linspace(0.02, 0.98, each)))[0]
    exact = observer.cue.signals(observer.whisker, contact)
    cheaper = observer.cue.signals(observer.whisker, contact, model=model)
    if ((exact[1] == Outcome.HELD) & (cheaper[1] != Outcome.HELD)).any():
        return np.inf
    return between(observer, contact, exact, cheaper)


def between(
    observer: Any, contact: Array, full: tuple[Array, Codes], cheap: tuple[Array, Codes]
) -> float:
    """Largest bias between two sets of signals of contacts, JNDs."""
    (exact, outcome), (cheaper, cheaper_outcome) = full, cheap
    usable = (outcome == Outcome.HELD) & (cheaper_outcome == Outcome.HELD)
    usable &= np.nan_to_num(observer.noise.sd(exact), nan=1.0).all(axis=-1)  # else known exactly
    slope = np.full((*exact.shape, contact.shape[-1]), np.nan)
    slope[usable] = observer.cue.jacobian(observer.whisker, contact[usable])
    usable &= np.isfinite(slope).all(axis=(-2, -1))  # not so at the edge of what is held
    contact, exact, off = contact[usable], exact[usable], (cheaper - exact)[usable]
    unit = np.maximum(np.abs(contact), 1e-12)
    slope = slope[usable] * unit[:, None]
    weight = np.swapaxes(slope, -1, -2) @ observer.noise.fisher(exact)
    prior = observer.prior_information(contact) * unit[:, None] * unit[..., None]
    inverse = np.linalg.pinv(weight @ slope + prior, rcond=1e-12, hermitian=True)
    bias = (inverse @ weight @ off[..., None])[:, 0, 0] / np.sqrt(inverse[:, 0, 0])
    return float(np.max(np.abs(bias), initial=0.0))
