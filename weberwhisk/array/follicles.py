"""Where whiskers stand on the face, and where they point: the array of the rat and of the mouse."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .._util.checks import angle, number, one_of, one_or_more
from .._util.values import Array, Shown, Value, counted, pd
from ..mechanics.shape import Profile, Spiral
from ..whisker import SPECIES, Whisker, rest_shape
from ..whisker import identities as known_identities

__all__ = ["TURNS", "Follicle", "Published", "WhiskerArray", "published"]

_RADIANS = "give radians, such as 0.5"
#: Degrees of elevation and of roll that come with each degree of protraction, row by row (Knutsen,
#: Biess & Ahissar 2008, Neuron 59:35, as Hobbs et al. 2016, PLoS Comput Biol 12:e1004109, print
#: them): sd over whiskers ± 0.05 to 0.3. The rotations of a public simulator differ by up to 0.3.
TURNS = {
    "A": (0.12, -0.76), "B": (0.30, -0.25), "C": (0.30, 0.22), "D": (0.14, 0.43), "E": (0.02, 0.73),
}  # fmt: skip


class Published(NamedTuple):
    """The published equations' values for one follicle, in mm and degrees.

    Base point (`theta`, `phi`, `radius`: spherical), arc length, the coefficient a (1/mm) of
    z = a x², and the angles of emergence.
    """

    theta: float
    phi: float
    radius: float
    arc_length: float
    coefficient: float
    azimuth: float
    elevation: float
    roll: float


def published(identity: str, species: str = "rat") -> Published:
    """The published equations of the array, by identity.

    Rat: Belli, Bresee, Graff & Hartmann (2018, PLoS ONE 13:e0194981). Mouse: Bresee, Belli, Luo &
    Hartmann (2023, J Exp Biol 226:jeb245597). They count the Greek arc as column 1, this package as
    column 0.

    Parameters
    ----------
    identity : str
        Row and column, such as ``"C2"``.
    species : {"rat", "mouse"}

    Raises
    ------
    ValueError
        For an unknown species or identity.

    Notes
    -----
    Against the 225 and 323 whiskers of Luo & Hartmann (2022): arc lengths are right in the median
    (−1 % and −7 %) and scatter by 20 and 18 %; the rat's row A is shorter than published and row D
    longer. The coefficients are *twice* those of the measured shapes (medians of the ratio 0.47 and
    0.54), as though they were 2a, the curvature at the base. So `WhiskerArray` takes lengths and
    curvature from the measured tables, and only base points and angles from here.
    Azimuths at rest of the rat's row C are 2 to 16° less than those of Hobbs et al. (2016), and
    elevations of rows C to E are 13 to 23° more than theirs. Single mouse whiskers scatter about
    base points by 9° and 7°, about azimuths by 22° and elevations by 13°.

    Examples
    --------
    >>> c2 = published("C2")
    >>> round(c2.theta, 1), round(c2.arc_length, 1), round(c2.azimuth, 1)
    (-8.4, 27.8, 61.6)
    """
    one_of("whisker", identity, known_identities(species))
    r, c = "ABCDE".index(identity[0]) + 1, int(identity[1:]) + 1
    if species == "rat":
        theta, phi = 13.4 * c - 48.6, 1.49 * r**2 - 26.3 * r + 68.0
        return Published(
            theta,
            phi,
            0.000511 * theta**2 - 0.0295 * theta - 0.0162 * phi + 6.5,
            float(np.exp(-0.0246 * theta + 3.12)),
            0.000240 * theta + 0.0148,
            0.598 * theta - 0.314 * phi + 67.4,
            1.04 * phi + 6.68,
            0.876 * theta + 0.845 * phi + 37.9,
        )
    theta, phi = 11.7 * c - 41.2, -16.8 * r + 56.3
    return Published(
        theta,
        phi,
        -0.0152 * theta - 0.0165 * phi + 4.44,
        11.7 * float(np.exp(-0.018 * theta)),
        0.00037 * theta + 0.017,
        0.922 * theta + 85.1,
        1.00 * phi + 10.2,
        0.620 * theta + 1.00 * phi + 43.0,
    )


@dataclass(frozen=True, eq=False, repr=False)
class Follicle(Value):
    """One whisker with its base point and direction.

    Attributes
    ----------
    identity : str
    side : {"left", "right"}
    whisker : Whisker or Profile
    base : array, shape (3,)
        Base point, m.
    azimuth, elevation, roll : float
        Of the base tangent, and of the plane of curvature about it, rad.
    swept : float
        Azimuth from rest, rad.
    """

    identity: str
    side: str
    whisker: Whisker  # or its profile
    base: Array
    azimuth: float
    elevation: float
    roll: float
    swept: float = 0.0

    def __post_init__(self) -> None:
        self._set(base=np.asarray(self.base, dtype=float))

    @property
    def mirror(self) -> float:
        """1 on the right, −1 on the left."""
        return 1.0 if self.side == "right" else -1.0

    @property
    def direction(self) -> Array:
        """Unit vector of the base tangent, (3,)."""
        flat, angle = np.cos(self.elevation), self.azimuth
        side = self.mirror * np.sin(angle) * flat
        return np.array([side, -np.cos(angle) * flat, np.sin(self.elevation)])

    def in_plane(self, place: ArrayLike) -> tuple[Array, Array]:
        """Where a vertical pole meets the plane of whisking: distance and angle from the tangent.

        The plane holds the base tangent and the horizontal line across it. The angle is positive
        where the whisker has gone past the pole, so that the pole deflects it.

        Parameters
        ----------
        place : array, shape (..., 2)
            x and y of the pole, m.

        Returns
        -------
        radial_distance, angle : array, shape (...)
            m and rad.

        Examples
        --------
        >>> c2 = WhiskerArray("rat", "right").whiskers["C2"]
        >>> tip = c2.base + 20e-3 * c2.direction
        >>> r, angle = c2.in_plane(tip[:2])
        >>> print(round(float(r), 6), round(float(angle), 6))
        0.02 0.0
        """
        offset = np.asarray(place, dtype=float) - self.base[:2]
        bearing = np.arctan2(self.mirror * offset[..., 0], -offset[..., 1])
        ahead = self.azimuth - bearing
        flat = np.hypot(offset[..., 0], offset[..., 1])
        along, across = flat * np.cos(ahead) / np.cos(self.elevation), flat * np.sin(ahead)
        return np.hypot(along, across), np.arctan2(across, along)

    def place(self, radial_distance: ArrayLike, angle: ArrayLike) -> Array:
        """The pole (..., 2) at distances (m) and angles (rad): the inverse of `in_plane`."""
        r, angle = np.asarray(radial_distance, dtype=float), np.asarray(angle, dtype=float)
        along, across = r * np.cos(angle) * np.cos(self.elevation), r * np.sin(angle)
        bearing = self.azimuth - np.arctan2(across, along)
        flat = np.hypot(along, across)
        x, y = self.mirror * flat * np.sin(bearing), -flat * np.cos(bearing)
        return np.asarray(np.stack([x, y], axis=-1) + self.base[:2])

    @property
    def swept_in_plane(self) -> float:
        """Angle from rest in the plane of whisking, rad."""
        return float(np.arctan2(np.sin(self.swept) * np.cos(self.elevation), np.cos(self.swept)))


@dataclass(frozen=True, eq=False, repr=False, init=False)
class WhiskerArray(Shown, Value):
    """The whiskers of a head.

    Parameters
    ----------
    species : {"rat", "mouse"}
    sides : {"both", "left", "right"}
    curved : bool
        With the curvature at rest that lies in the plane of whisking. By default straight.
    identities : sequence of str, optional
        Whiskers that are intact; by default all.

    Attributes
    ----------
    protraction : float
        Azimuth from rest, rad.

    Raises
    ------
    ValueError
        For an unknown species, side or identity.

    Notes
    -----
    Base points and angles are those of `published`, mirrored for the other side. A rat's whisker is
    that of `Whisker.from_identity`. Mouse lengths are measured (Luo & Hartmann 2022). Mouse
    thickness is not published: it is the rat's in proportion to length, with a radius ratio of
    31.5. Forces of mice are therefore approximate; results under Weber's law, which depend on the
    shape alone, are not affected.

    The sources do not say which way a whisker bows at a roll of 0: it is taken to bow in the plane
    of whisking, the tip rostrally, and at 90° ventrally, so that protraction meets objects on the
    concave side, with the cosine of the roll of the curvature.

    Examples
    --------
    >>> array = WhiskerArray("rat")
    >>> array
    <WhiskerArray: rat, 30 straight whiskers on either side, at rest>
    >>> c2 = array.protract(np.radians(20)).whiskers["left C2"]
    >>> (1e3 * c2.base).round(1), round(float(np.degrees(c2.azimuth)), 1)
    (array([-6.7, -1. ,  0.3]), 81.6)
    """

    species: str
    sides: str
    curved: bool
    identities: tuple[str, ...]
    protraction: float
    _figure = "whisker_array"

    def __init__(
        self,
        species: str = "rat",
        sides: str = "both",
        *,
        curved: bool = False,
        identities: Iterable[str] | None = None,
        protraction: float = 0.0,
    ) -> None:
        names = known_identities(one_of("species", species, SPECIES))
        intact = names if identities is None else one_or_more("identities", identities, names)
        turned = angle("protraction", protraction, _RADIANS)
        self._set(
            species=species,
            sides=one_of("sides", sides, ("both", "left", "right")),
            curved=bool(curved),
            identities=tuple(intact),
            protraction=number("protraction", turned, _RADIANS),
        )

    @cached_property
    def whiskers(self) -> dict[str, Follicle]:
        """Every whisker by name: ``"C2"``, or ``"left C2"`` where the array has both sides."""
        return {
            f"{side} {name}" if self.sides == "both" else name: self._follicle(name, side)
            for side in (("left", "right") if self.sides == "both" else (self.sides,))
            for name in self.identities
        }

    def protract(self, angle: float) -> WhiskerArray:
        """The array protracted from where it is, by an azimuth in rad.

        Elevation and roll follow row by row, as measured in rats. Base points stay.
        """
        return replace(self, protraction=self.protraction + angle)

    def only(self, names: Iterable[str]) -> WhiskerArray:
        """The array with these identities alone left intact."""
        return replace(self, identities=tuple(names))

    def table(self) -> pd.DataFrame:
        """One row a whisker: name, base point and length in mm, angles in degrees."""
        records = []
        for name, f in self.whiskers.items():
            whisker = getattr(f.whisker, "whisker", f.whisker)
            angles = np.degrees([f.azimuth, f.elevation, f.roll])
            records.append((name, f.side, *1e3 * f.base, 1e3 * whisker.length, *angles))
        columns = "whisker side x_mm y_mm z_mm length_mm azimuth_deg elevation_deg roll_deg"
        return pd.DataFrame(records, columns=columns.split())

    _table = table

    def _line(self) -> str:
        where = "either side" if self.sides == "both" else f"the {self.sides}"
        angle = f"{np.degrees(self.protraction):.3g}°"
        pose = f"protracted by {angle}" if self.protraction else "at rest"
        shape = "curved" if self.curved else "straight"
        many = counted(len(self.identities), f"{shape} whisker")
        return f"{self.species}, {many} on {where}, {pose}"

    def _follicle(self, identity: str, side: str) -> Follicle:
        at, (rise, turn) = published(identity, self.species), TURNS[identity[0]]
        theta, phi = np.radians([at.theta, at.phi])
        base = np.array([np.cos(phi) * np.cos(theta), np.cos(phi) * np.sin(theta), np.sin(phi)])
        base *= at.radius * 1e-3 * np.array([1.0 if side == "right" else -1.0, 1.0, 1.0])
        roll = np.radians(at.roll) + turn * self.protraction
        whisker: Any = Whisker.from_identity(identity, species=self.species)
        if self.curved:
            bow, rate = (-v * np.cos(roll) for v in rest_shape(identity, self.species))
            whisker = Profile.of(whisker).curved(Spiral(bow, rate))
        azimuth = float(np.radians(at.azimuth) + self.protraction)
        elevation = float(np.radians(at.elevation) + rise * self.protraction)
        place = base, azimuth, elevation, float(roll)
        return Follicle(identity, side, whisker, *place, self.protraction)
