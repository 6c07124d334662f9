"""What is compared: a magnitude with its unit, the words of its answers, and its limits.

Everything that a plan says of stimuli in words, in tables and on axes comes from here; a radial
distance, `DISTANCE`, is one magnitude among others.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._util import checks
from .._util.refusals import Refusal, named
from .._util.values import Array, Fields, plain_number
from ..behaviour.encodings import (
    OF_DISTANCE,
    ConstantNoise,
    Encoding,
    IdentityEncoding,
    LogEncoding,
    described,
)

__all__ = ["DISTANCE", "MAGNITUDES", "STIMULUS", "Magnitude", "magnitude_named", "magnitude_of"]

#: Natural-log units in a decibel of amplitude.
DECIBEL = float(np.log(10.0) / 20)
_SIGNS = {"µ": "u", "μ": "u", "°": "deg", "%": "percent", "²": "2", "³": "3", "/": "_per_"}


@dataclass(frozen=True, repr=False)
class Magnitude(Fields):
    """A magnitude that two stimuli differ in, as it is written and spoken of.

    Parameters
    ----------
    name : str
        Such as "duration"; any.
    unit : str
        In which stimuli are written, "" for what is counted.
    greater, less : str
        What a stimulus is beside a smaller and a greater one: "longer", "shorter".
    log_unit : float, optional
        Of a magnitude that is written by its logarithm, such as a sound level: natural-log units in
        one of the unit, ln(10)/20 for decibels of amplitude.
    least, greatest : float
        The stimuli that there can be, in their unit.
    step : float
        The smallest difference that can be made, in their unit: 1 for a number of dots; 0 for any.
    plural : str
        Several; by default of the name.
    per_unit : float
        What is written for a stimulus of 1 in the package: 1000 for metres written in millimetres.

    Examples
    --------
    >>> duration = Magnitude("duration", "ms", "longer", "shorter")
    >>> duration.said(1200.0), duration.question
    ('1200 ms', 'which of two durations is the longer')
    """

    name: str
    unit: str = ""
    greater: str = "greater"
    less: str = "smaller"
    log_unit: float | None = None
    least: float = 0.0
    greatest: float = float("inf")
    step: float = 0.0
    plural: str = ""
    per_unit: float = 1.0

    def __post_init__(self) -> None:
        for field in ("name", "unit", "greater", "less", "plural"):
            if not isinstance(getattr(self, field), str):
                value = checks.shown(getattr(self, field))
                raise Refusal(f"{field} of a magnitude must be text", value, 'write "duration"')
        if not self.name.strip():
            raise Refusal("a magnitude needs a name", repr(self.name), 'write "duration", say')
        if self.log_unit is not None:
            checks.positive_number(
                "log_unit", self.log_unit, "give natural-log units, 0.115 for dB"
            )
        checks.positive_number("per_unit", self.per_unit, "leave it out, say")
        checks.non_negative_number("step", self.step, "write 1, or 0 for any")
        if not self.least < self.greatest:
            raise Refusal(
                "least must lie below greatest", f"{self.least:g} and {self.greatest:g}",
                "exchange them, say",
            )  # fmt: skip
        if not self.plural:
            object.__setattr__(self, "plural", _plural(self.name))

    @property
    def is_log(self) -> bool:
        """Whether stimuli are written by their logarithms."""
        return self.log_unit is not None

    @property
    def is_distance(self) -> bool:
        """Whether stimuli are radial distances along a whisker, kept in metres."""
        return self.name == DISTANCE.name

    @property
    def encoding(self) -> Encoding:
        """The magnitude itself as a signal with Weber noise, by its logarithm where it is so."""
        return IdentityEncoding() if self.log_unit is None else LogEncoding(self.log_unit)

    @property
    def scale(self) -> str:
        """That of a table of trials, "linear" or "log"."""
        return "log" if self.is_log else "linear"

    # -- as numbers ----------------------------------------------------------------------------

    def written(self, stimulus: ArrayLike) -> Array:
        """Stimuli as one would write them in their unit, 20.1 and not 20.100000000000001."""
        at = np.asarray(stimulus, dtype=float) * self.per_unit
        return np.array([float(f"{v:.9g}") for v in at.flat]).reshape(at.shape)

    def number(self, stimulus: float, digits: int = 4) -> str:
        """One in its unit, to so many digits."""
        return plain_number(self.per_unit * float(stimulus), digits)

    def said(self, stimulus: float, digits: int = 4) -> str:
        """One with its unit."""
        return f"{self.number(stimulus, digits)}{self.unit_after}"

    def listed(self, stimuli: Iterable[float], digits: int = 4) -> str:
        """Several with their unit."""
        return ", ".join(self.number(s, digits) for s in stimuli) + self.unit_after

    @property
    def unit_after(self) -> str:
        """The unit as it follows a number: " ms", "%"."""
        tight = self.unit in ("", "%", "°")
        return self.unit if tight else f" {self.unit}"

    # -- as columns and axes -------------------------------------------------------------------

    @property
    def suffix(self) -> str:
        """The ending of a column's name, "_ms"; letters and digits alone, for any program."""
        unit = "".join(_SIGNS.get(c, c) for c in self.unit)
        unit = re.sub(r"[^A-Za-z0-9]+", "_", unit).strip("_")
        return f"_{unit}" if unit else ""

    def column(self, name: str) -> str:
        """The name of a column of stimuli: "standard_ms"."""
        return f"{name}{self.suffix}"

    def axis(self, words: str = "") -> str:
        """The label of an axis of stimuli: "Comparison (ms)"."""
        words = words or self.name
        return f"{words[0].upper()}{words[1:]}" + (f" ({self.unit})" if self.unit else "")

    # -- in words ------------------------------------------------------------------------------

    @property
    def question(self) -> str:
        """What is asked of two."""
        return f"which of two {self.plural} is the {self.greater}"

    @property
    def one_question(self) -> str:
        """What is asked of one."""
        a = "an" if self.name[0] in "aeiou" else "a"
        return f"whether {a} {self.name} is {self.greater} than the standard held in mind"

    @property
    def title(self) -> str:
        """Of an experiment."""
        return f"Discrimination of {self.name}"

    def encoded(self, encoding: Encoding) -> str:
        """How a stimulus becomes a signal, in a clause."""
        base = getattr(encoding, "base", encoding)
        noise = "noise in proportion to it"
        if isinstance(encoding, ConstantNoise):
            noise = "the same noise at all of them"
        noise = getattr(encoding, "noise_in_words", noise)
        if isinstance(base, OF_DISTANCE):
            words = described(encoding)
            return f"{self.name.removeprefix('radial ')} is encoded through {words}"
        if isinstance(base, IdentityEncoding):
            return f"the signal of a stimulus is its {self.name}, with {noise}"
        if type(base) is LogEncoding:
            return (
                f"the signal of a stimulus is its magnitude, exp({base.log_unit:.4g} × {self.name}"
                f"{f' in {self.unit}' * bool(self.unit)}), with {noise}"
            )
        return f"{self.plural} are encoded by {described(encoding)}"


def _plural(name: str) -> str:
    head, of, rest = name.partition(" of ")
    if re.search(r"[^aeiou]y$", head):
        head = f"{head[:-1]}ies"
    else:
        head += "es" if re.search(r"(s|x|ch|sh)$", head) else "s"
    return head + of + rest


#: The default of schemes and plans with a whisker.
DISTANCE = Magnitude("radial distance", "mm", "farther", "nearer", step=0.01, per_unit=1e3)
#: Any other, where nothing is said of it.
STIMULUS = Magnitude("stimulus", plural="stimuli", least=-float("inf"))
#: Magnitudes whose words are known, by name; any other name has "greater" and "smaller".
MAGNITUDES: dict[str, Magnitude] = {
    m.name: m
    for m in (
        Magnitude("duration", "ms", "longer", "shorter"),
        Magnitude("interval", "ms", "longer", "shorter"),
        Magnitude("weight", "g", "heavier", "lighter"),
        Magnitude("mass", "g", "heavier", "lighter"),
        Magnitude("sound level", "dB", "louder", "softer", DECIBEL, -float("inf")),
        Magnitude("loudness", "dB", "louder", "softer", DECIBEL, -float("inf")),
        Magnitude("frequency", "Hz", "higher", "lower"),
        Magnitude("pitch", "Hz", "higher", "lower"),
        Magnitude("number", "", "greater", "smaller", least=0.0, step=1.0),
        Magnitude("numerosity", "", "greater", "smaller", least=0.0, step=1.0),
        Magnitude("length", "cm", "longer", "shorter"),
        Magnitude("size", "cm", "larger", "smaller"),
        Magnitude("area", "cm²", "larger", "smaller"),
        Magnitude("luminance", "cd/m²", "brighter", "dimmer"),
        Magnitude("brightness", "cd/m²", "brighter", "dimmer"),
        Magnitude("contrast", "%", "higher", "lower"),
        Magnitude("speed", "°/s", "faster", "slower"),
        Magnitude("velocity", "°/s", "faster", "slower"),
        Magnitude("force", "N", "stronger", "weaker"),
        Magnitude("pressure", "kPa", "stronger", "weaker"),
        Magnitude("amplitude", "µm", "stronger", "weaker"),
        Magnitude("intensity", "", "stronger", "weaker"),
        Magnitude("concentration", "%", "stronger", "weaker"),
        Magnitude("temperature", "°C", "warmer", "cooler"),
        Magnitude("roughness", "µm", "rougher", "smoother"),
        Magnitude("stiffness", "N/m", "stiffer", "softer"),
        Magnitude("angle", "°", "larger", "smaller"),
    )
}  # fmt: skip
#: Units that are logarithms, with their natural-log units.
LOG_UNITS = {"dB": DECIBEL, "B": 20 * DECIBEL, "Np": 1.0}


def magnitude_named(name: str, unit: str | None = None, **more: Any) -> Magnitude:
    """The magnitude of a name, with the words of its table where the name is or ends with one.

    Parameters
    ----------
    name : str
        "duration", "tone frequency", "number of dots": any. A radial distance needs a whisker.
    unit : str, optional
        By default that of the table.
    **more
        Other fields of `Magnitude`; None leaves one as it is.

    Examples
    --------
    >>> magnitude_named("tone duration", "s").greater, magnitude_named("grit").greater
    ('longer', 'greater')
    """
    if not isinstance(name, str) or not name.strip():
        raise Refusal("a magnitude needs a name", checks.shown(name), 'write "duration", say')
    name = " ".join(name.split())
    plain = name.lower()
    if plain == DISTANCE.name:
        raise Refusal(
            "radial distances are encoded through a whisker", repr(name),
            "leave " + named("magnitude") + " out, and give the whisker",
        )  # fmt: skip
    of_name = [
        m for known, m in MAGNITUDES.items()
        if plain == known or plain.endswith(f" {known}") or plain.startswith(f"{known} of ")
    ]  # fmt: skip
    longest = max(of_name, key=lambda m: len(m.name), default=Magnitude(name))
    fields = {field: value for field, value in more.items() if value is not None}
    if unit is not None:
        fields["unit"] = unit.strip()
        is_log = fields["unit"] in LOG_UNITS
        if "log_unit" not in fields:
            fields["log_unit"] = LOG_UNITS.get(fields["unit"])
        if "least" not in fields:
            fields["least"] = -np.inf if is_log else 0.0
    return replace(longest, name=name, plural=_plural(name), **fields)


def magnitude_of(encoding: Encoding) -> Magnitude:
    """The magnitude that an encoding is of, where nothing is said: radial distance or any."""
    base = getattr(encoding, "base", encoding)
    if isinstance(base, OF_DISTANCE):
        return replace(DISTANCE, per_unit=1e3 * base.unit) if base.unit != 1.0 else DISTANCE
    log_unit = getattr(base, "log_unit", None)
    return STIMULUS if log_unit is None else replace(STIMULUS, log_unit=log_unit)
