"""A whisker: geometry, material and the scales that follow from them."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import resources
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from . import domain
from ._util.checks import finite, one_of, positive, positive_number, shown
from ._util.refusals import Refusal, argument, named
from ._util.values import Array, Value

__all__ = [
    "DENSITY", "MATERIALS", "SPECIES", "YOUNGS_MODULUS", "Assumed", "Whisker", "identities",
    "is_wire", "rest_shape", "usual_curvature", "usual_turn",
]  # fmt: skip

#: Young's modulus of rat whiskers, Pa: 3.34 ± 1.48 GPa (Quist, Faruqi & Hartmann 2011).
YOUNGS_MODULUS = 3.34e9
#: Density at the base, kg/m³; it rises to about 1690 at the tip.
DENSITY = 1260.0
SPECIES = ("rat", "mouse")
#: Nominal Young's modulus (Pa) and density (kg/m³) of what robots' whiskers are made of; sources
#: and ranges are in `Whisker.shaft`.
MATERIALS = {
    "steel": (200e9, 7850.0),
    "nitinol": (75e9, 6450.0),
    "polycarbonate": (2.4e9, 1200.0),
    "nylon": (2.8e9, 1140.0),
}


class Assumed(float):
    """A number that nobody gave. It is that number, and copies of a whisker keep it as it is."""


class _Identity(NamedTuple):
    """Whose whisker it is, its curvature at rest (1/m), and what makes it so: length and radii."""

    species: str
    follicle: str
    bow: float
    shape: tuple[float, float, float]


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Whisker(Value):
    """A linearly tapered (or cylindrical) whisker, in SI units.

    Every field but the hinge may be an array; fields broadcast against each other and against the
    contacts they are used with.

    Parameters
    ----------
    length : float or array
        Arc length from base to tip, m.
    base_radius, tip_radius : float or array
        Radius at base and tip, m. Equal radii make a cylinder, ``tip_radius=0`` a perfect cone.
    youngs_modulus : float or array
        Pa. Default 3.34 GPa (Quist et al. 2011); single whiskers scatter by ± 1.48 GPa.
    curvature : float or array
        Intrinsic curvature at rest, constant along the arc, 1/m; positive bends away from
        the object. Default straight, which observers say where it matters; 0 says that it is.
        A cylinder (radii equal to within 5 %) is a wire: straight unless a curvature is given.
    density : float or array
        kg/m³.
    hinge_stiffness : float, optional
        Of a rotational spring in series at the base (a follicle, a rubber mount), N m/rad; by
        default the base is clamped. Observers whose cues are `ForceMap`, `Compliance`,
        `BalanceOfMoments` or made of them take it, all else refuses it. The base turns by the
        moment over this stiffness; angles are those of what carries the spring, up to half a turn;
        moment and forces those at the whisker's own base, along and across it. `calibrate` finds
        h = 3EI₀/hinge_stiffness, in m.

    Raises
    ------
    ValueError
        For a length, radius, modulus, density or hinge that is not positive and finite, for a tip
        wider than the base, and for what can only be a slip of units (a whisker of 41 m).

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6, youngs_modulus=3e9)
    >>> float(w.radius_ratio), round(float(w.apex_distance) * 1e3, 4)
    (20.0, 52.6316)
    >>> print(f"{w.stiffness:.4e}")
    2.3562e-07
    """

    # Typed as one whisker's; of several they are arrays.
    length: float
    base_radius: float
    tip_radius: float
    youngs_modulus: float
    curvature: float
    density: float
    hinge_stiffness: float | None
    #: A whisker with the same numbers is the same whisker, whoever's it is.
    _identity: _Identity | None = field(default=None, repr=False, compare=False)

    def __init__(
        self,
        length: ArrayLike,
        base_radius: ArrayLike,
        tip_radius: ArrayLike,
        youngs_modulus: ArrayLike = YOUNGS_MODULUS,
        curvature: ArrayLike = Assumed(0.0),  # noqa: B008
        density: ArrayLike = DENSITY,
        hinge_stiffness: float | None = None,
        _identity: _Identity | None = None,
    ) -> None:
        checked = {
            "length": positive("length", length, "give metres, such as 50e-3"),
            "base_radius": positive("base_radius", base_radius, "give metres, such as 1e-4"),
            "tip_radius": finite("tip_radius", tip_radius, "give metres, such as 5e-6"),
            "youngs_modulus": positive(
                "youngs_modulus", youngs_modulus, "give pascals, such as 3e9"
            ),
            "curvature": finite("curvature", curvature, "give 1/m, 0 for a straight whisker"),
            "density": positive("density", density, "give kg/m³, such as 1260"),
        }
        if hinge_stiffness is not None:
            hint = "give N m/rad, such as 1e-5, or None for a clamped base"
            hinge_stiffness = positive_number("hinge_stiffness", hinge_stiffness, hint)
        tip, base = checked["tip_radius"], checked["base_radius"]
        if np.any(tip < 0):
            raise Refusal(
                "tip_radius must not be negative",
                f"{np.min(tip):g}",
                "give metres, 0 for a perfect cone",
            )
        try:
            np.broadcast_shapes(*(a.shape for a in checked.values()))
        except ValueError:
            shapes = ", ".join(f"{n} {a.shape}" for n, a in checked.items() if a.ndim)
            raise Refusal(
                "The whisker's fields must broadcast together", shapes, "give arrays of one shape"
            ) from None
        if np.any(tip > base):
            raise Refusal(
                "The tip must not be wider than the base",
                f"tip_radius {np.max(tip):g} m and base_radius {np.min(base):g} m",
                "swap them or correct the unit",
            )
        domain.refuse_length(checked["length"], base)
        domain.hint_at_curvature(checked["curvature"], checked["length"])
        values = {n: array if array.ndim else float(array) for n, array in checked.items()}
        if isinstance(curvature, Assumed):
            values["curvature"] = curvature
        if _identity is not None:  # of a whisker that this one is made from
            shape = [values[name] for name in ("length", "base_radius", "tip_radius")]
            same = all(map(np.array_equal, shape, _identity.shape))
            if not (same and np.all(np.isin(np.abs(values["curvature"]), (0.0, _identity.bow)))):
                _identity = None
        self._set(**values, hinge_stiffness=hinge_stiffness, _identity=_identity)

    @classmethod
    def from_identity(
        cls,
        identity: str,
        *,
        species: str = "rat",
        seed: int | np.random.SeedSequence | np.random.Generator | None = None,
        youngs_modulus: ArrayLike = YOUNGS_MODULUS,
        curved: bool = False,
        hinge_stiffness: float | None = None,
    ) -> Whisker:
        """The mean whisker of a named follicle, or one drawn from the spread of that follicle.

        Parameters
        ----------
        identity : str
            Row and column, such as ``"C2"``; see `identities`.
        species : {"rat", "mouse"}
            Of mice lengths are measured (Luo & Hartmann 2022), and thickness, which is not
            published, is the rat's in proportion to length with a radius ratio of 31.5: forces of
            mice are rough, what Weber's law makes of them is not, as it depends on shape alone.
        seed : int, SeedSequence or Generator, optional
            Without a seed the mean morphology; with one, length and base diameter are drawn
            from normal distributions of the measured mean and sd, cut at ± 2.5 sd and at a tenth
            of the mean. The tip keeps the median, or the base's width where that is smaller.
        youngs_modulus : float
            Pa; the table has none.
        curved : bool
            With the curvature at rest of this follicle: constant, with the same turn from base to
            tip as the measured law, `rest_shape`; positive, so that it is touched on the convex
            side. By default straight, as the paper's whiskers are; observers then say in `note`
            where that moves the distance by more than a JND.
        hinge_stiffness : float, optional
            As of any whisker. `dataclasses.replace` makes one of the same identity, but for
            another length, radius or curvature (its own, either way, or 0).

        Raises
        ------
        ValueError
            For an identity or a species that the tables do not have, a seed with a mouse's, and a
            `curved` that is not True or False.

        Notes
        -----
        Summary of the 519 whiskers of Belli, Yang, Bresee & Hartmann (2017, J Neurophysiol
        117:1807). Where no tip was measured (C5), the tip's is the median over the table.

        Examples
        --------
        >>> print(round(Whisker.from_identity("C2").length, 4))
        0.0336
        >>> print(round(Whisker.from_identity("C2", seed=1).length, 4))
        0.0345
        """
        one_of("species", species, SPECIES)
        table = _morphology()
        if species == "mouse":
            one_of("whisker", identity, identities("mouse"))
            if seed is not None:
                raise Refusal(
                    "The spread of mouse whiskers is not known",
                    f"seed {seed!r}",
                    "leave seed out for the median whisker",
                )
        row = table[one_of("whisker", identity, table)]
        if not isinstance(curved, bool | np.bool_):
            raise Refusal(
                named("curved") + " must be True or False",
                shown(curved),
                "write "
                + argument("curved", True)
                + " for this follicle's measured curvature, or give Whisker a curvature in 1/m",
            )
        length, base = row["length_mm"], row["base_diameter_um"]
        if seed is not None:
            draws = np.clip(np.random.default_rng(seed).standard_normal(2), -2.5, 2.5)
            length = max(length + draws[0] * row["length_sd_mm"], length / 10)
            base = max(base + draws[1] * row["base_diameter_sd_um"], base / 10)
        tip = min(row["tip_diameter_median_um"], base)
        if species == "mouse":
            mouse = _rest_shapes()[species, identity][2] * 1e3
            base, length = base / length * mouse, mouse
            tip = base / 31.5
        radii = base * 0.5e-6, tip * 0.5e-6
        made = cls(length * 1e-3, *radii, youngs_modulus, hinge_stiffness=hinge_stiffness)
        bow = made._named(species, identity)
        if not curved:
            return made
        return replace(made, curvature=bow)

    def _named(self, species: str, identity: str) -> float:
        """Remember whose whisker this is, and return its curvature at rest, 1/m."""
        at_base, rate = rest_shape(identity, species)
        bow = abs(float(at_base + rate * self.length / 2))  # the mouse's C6 turns back
        shape = self.length, self.base_radius, self.tip_radius
        object.__setattr__(self, "_identity", _Identity(species, identity, bow, shape))
        return bow

    @classmethod
    def shaft(cls, length: float, diameter: float, material: str | float, **fields: Any) -> Whisker:
        """The uniform shaft of a robot's whisker, of a named material.

        Parameters
        ----------
        length, diameter : float
            m.
        material : str or float
            ``"steel"``, ``"nitinol"``, ``"polycarbonate"``, ``"nylon"``, or Young's modulus, Pa.
        **fields
            Further fields of the whisker, such as ``curvature`` or ``hinge_stiffness``.

        Raises
        ------
        ValueError
            For a material that is not known, and as any whisker.

        Notes
        -----
        Moduli are nominal: steel 200 GPa (193 to 207), polycarbonate 2.4 (2.38), nylon 6,6 2.8
        (1.59 to 3.79, less in damp air), in brackets those of Callister & Rethwisch (2008,
        Fundamentals of Materials Science and Engineering, 3rd ed., table B.2); nitinol 75, which
        makers' data sheets give as 75 to 83 in austenite below its plateau, and 28 to 41 in
        martensite. Composites and printed plastics differ too much for a name: measure theirs. On a
        uniform shaft moment and axial force alone do not locate (see `ForceMap`).

        Examples
        --------
        >>> shaft = Whisker.shaft(100e-3, 0.5e-3, "nitinol")
        >>> print(shaft.radius_ratio, f"{shaft.stiffness:.2g} N m²")
        1.0 0.00023 N m²
        """
        if isinstance(material, str):
            modulus, density = MATERIALS[one_of("material", material, MATERIALS)]
            fields.setdefault("density", density)
        else:
            modulus = material
        radius = positive("diameter", diameter, "give metres, such as 5e-4") / 2
        fields.setdefault("curvature", 0.0)
        return cls(length, radius, radius, modulus, **fields)

    @property
    def identity(self) -> tuple[str, str, float] | None:
        """Species, follicle and curvature at rest (1/m) of a whisker `from_identity`, else none."""
        return None if self._identity is None else self._identity[:3]

    @property
    def radius_ratio(self) -> Array:
        """Base radius over tip radius: 1 for a cylinder, infinite for a perfect cone."""
        with np.errstate(divide="ignore"):
            return np.divide(self.base_radius, self.tip_radius)

    @property
    def taper(self) -> Array:
        """Length over apex distance, 1 − 1/R: 0 for a cylinder, 1 for a perfect cone."""
        return 1.0 - np.divide(self.tip_radius, self.base_radius)

    @property
    def apex_distance(self) -> Array:
        """Distance A from the base at which the taper would reach zero width, m."""
        with np.errstate(divide="ignore"):
            return np.divide(self.length, self.taper)

    @property
    def stiffness(self) -> Array:
        """Bending stiffness at the base EI₀ = E π/4 · base_radius⁴, N m²."""
        return self.youngs_modulus * np.pi / 4 * np.power(self.base_radius, 4)

    @property
    def moment_scale(self) -> Array:
        """EI₀/L, N m: the paper's unit of moment."""
        return self.stiffness / self.length

    @property
    def force_scale(self) -> Array:
        """EI₀/L², N: the paper's unit of force."""
        return self.stiffness / self.length**2

    @property
    def compliance_constant(self) -> Array:
        """C = 3EI₀ of equations (2.1) and (2.3), N m²."""
        return 3 * self.stiffness

    def cylinder(self) -> Whisker:
        """The cylindrical whisker of the same length, base radius, material and curvature.

        Examples
        --------
        >>> Whisker.from_identity("C2").cylinder().radius_ratio
        np.float64(1.0)
        """
        return replace(self, tip_radius=self.base_radius)


def identities(species: str = "rat") -> tuple[str, ...]:
    """The whisker identities that `Whisker.from_identity` knows, row by row.

    Parameters
    ----------
    species : {"rat", "mouse"}

    Raises
    ------
    ValueError
        For another species.

    Examples
    --------
    >>> identities()[:3]
    ('A0', 'A1', 'A2')
    """
    if one_of("species", species, SPECIES) == "rat":
        return tuple(_morphology())
    return tuple(name for kind, name in _rest_shapes() if kind == species)


def rest_shape(identity: str, species: str = "rat") -> tuple[float, float]:
    """Curvature at rest of a follicle's whisker: at the base (1/m), and its rate (1/m²).

    Medians of κ(s) = B + A s over the whiskers of Luo & Hartmann (2022, PLoS ONE), for
    ``Profile.of(whisker).curved(Spiral(*rest_shape("C2")))``; mirrored for the concave side.

    Parameters
    ----------
    identity : str
        Row and column, the Greek arc being column 0, such as ``"C2"``.
    species : {"rat", "mouse"}

    Raises
    ------
    ValueError
        For an identity or a species that the table does not have.

    Examples
    --------
    >>> rest_shape("C2")
    (7.325, 552.0)
    """
    one_of("species", species, SPECIES)
    table = _rest_shapes()
    names = [name for kind, name in table if kind == species]
    return table[species, one_of("whisker", identity, names)][:2]


def is_wire(whisker: Whisker) -> bool:
    """Whether the radius is the same all along, to within 5 % as a calliper may be off.

    Whiskers taper, to a third of the base radius or less; what does not is a wire or a rod.
    """
    return bool(np.all(whisker.taper <= 0.05))


def usual_curvature(whisker: Whisker) -> float | None:
    """Size of the curvature at rest that is usual of a whisker's kind, 1/m.

    None where its curvature was given, and of a wire, which is straight unless it was bent.

    Examples
    --------
    >>> round(usual_curvature(Whisker(50e-3, 100e-6, 5e-6)), 1)
    8.1
    >>> usual_curvature(Whisker(50e-3, 100e-6, 100e-6)) is None
    True
    """
    if not isinstance(whisker.curvature, Assumed) or is_wire(whisker):
        return None
    named = whisker.identity
    return float(usual_turn() / whisker.length if named is None else named[2])


@cache
def usual_turn() -> float:
    """Turn from base to tip at rest of the middle one of the rat's follicles, rad."""
    rats = [row for (species, _), row in _rest_shapes().items() if species == "rat"]
    return float(np.median([length * (base + rate * length / 2) for base, rate, length in rats]))


@cache
def _rest_shapes() -> dict[tuple[str, str], tuple[float, float, float]]:
    """Curvature at the base (1/m), its rate (1/m²) and median length (m)."""
    text = resources.files("weberwhisk").joinpath("data/whisker_curvature.csv").read_text("utf-8")
    return {
        (row["species"].lower(), f"{'ABCDE'[int(row['row']) - 1]}{int(row['column']) - 1}"): (
            round(float(row["B_per_mm"]) * 1e3, 9),
            round(float(row["A_per_mm2"]) * 1e6, 9),
            round(float(row["arc_length_mm"]) * 1e-3, 9),
        )
        for row in csv.DictReader(text.splitlines())
    }


@cache
def _morphology() -> dict[str, dict[str, float]]:
    numbers = (
        "length_mm",
        "length_sd_mm",
        "base_diameter_um",
        "base_diameter_sd_um",
        "tip_diameter_median_um",
    )
    text = resources.files("weberwhisk").joinpath("data/whisker_morphology.csv").read_text("utf-8")
    by_whisker = {row["whisker"]: row for row in csv.DictReader(text.splitlines())}
    tips: Array = np.array(
        [
            float(r["tip_diameter_median_um"])
            for r in by_whisker.values()
            if r["tip_diameter_median_um"]
        ]
    )
    unmeasured = float(np.median(tips))
    return {
        name: {key: float(row[key]) if row[key] else unmeasured for key in numbers}
        for name, row in by_whisker.items()
    }
