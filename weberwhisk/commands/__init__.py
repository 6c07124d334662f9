"""The commands by subject; `weberwhisk.cli` puts them together.

Conventions of every command, besides those of `weberwhisk.cli`:

- Lengths are in millimetres, radii in micrometres, angles in degrees, forces in micronewtons, as
  the names of options and columns say. Lists are comma-separated, or the option is repeated.
- ``--out`` names the folder for tables, figures and the record (see `_util.output`),
  ``--json`` prints only the result on standard output, ``--seed`` makes draws repeatable.

This module holds what commands share: options, the whisker and cue that they describe, and the
printing of results. The package's rooms are imported when they are used, so that help is quick.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from functools import wraps
from pathlib import Path
from shlex import quote
from typing import Annotated, Any, NamedTuple, get_args, get_origin

import numpy as np
import typer

import weberwhisk as ww

from .._util import checks
from .._util.output import Run, to_json
from .._util.output import shown as progress_shown
from .._util.refusals import Advice, Call, Named, Refusal, Remedy, Typed, in_code, rendered
from .._util.values import Array, pd

__all__ = [
    "CUES", "NO_SHAPE", "SCENES", "SPELLED", "Number", "Shape", "Text", "Texts", "a_number",
    "a_seed", "as_asked", "as_options", "beliefs", "chosen_trials", "command", "describe",
    "encoding_options", "enough_draws", "finish", "numbers", "one_angle", "option", "pairs",
    "progress", "show", "the_cue", "the_scene", "the_whisker", "values_of", "weber_fractions",
    "whisker_line",
]  # fmt: skip


@contextmanager
def progress(
    description: str, total: float, *, as_json: bool, every: float = 15.0
) -> Iterator[Callable[..., None]]:
    """Progress on standard error by `output.shown`; none where JSON is printed."""
    if as_json:
        yield lambda done=1.0: None
        return
    with progress_shown(description, total, every=every) as advance:
        yield advance


def a_number(text: str | float) -> float:
    """The value of an option that takes one number."""
    try:
        return float(text)
    except ValueError:
        raise typer.BadParameter(f"{text!r} is not a number; write one such as 3.5") from None


def a_seed(text: str | int) -> int:
    """The value of ``--seed``."""
    if not str(text).isdecimal():
        raise typer.BadParameter(f"{text!r} is not a seed; write a whole number such as 1")
    return int(text)


def numbers(option: str, values: Sequence[str]) -> Array:
    """The numbers of a list option, comma-separated or repeated.

    Examples
    --------
    >>> numbers("--deflection-angle-deg", ["5,10", "20"])
    array([ 5., 10., 20.])
    """
    out = []
    for text in (text.strip() for value in values for text in value.split(",")):
        try:
            out.append(float(text))
        except ValueError:
            raise Refusal(f"{option} takes numbers such as 10,20,30", f"{text!r}") from None
    return np.array(out)


Text = str | None
Texts = list[str] | None
Number = float | None


class Shape(NamedTuple):
    """The options that describe a whisker; None for those not given."""

    identity: str | None = None
    length_mm: float | None = None
    base_radius_um: float | None = None
    tip_radius_um: float | None = None
    youngs_modulus_gpa: float | None = None
    curvature_per_m: str | None = None

    @property
    def given(self) -> bool:
        """Whether any option was given."""
        return any(value is not None for value in self)


NO_SHAPE = Shape()


def _of(group: str, **options: Any) -> dict[str, Any]:
    return {"rich_help_panel": group, **options}


_SHAPE: dict[str, Any] = {
    "identity": Annotated[str | None, "A rat's whisker, such as C2.", _of("Whisker")],
    "length_mm": Annotated[Number, "Arc length from base to tip.", _of("Whisker")],
    "base_radius_um": Annotated[Number, "Radius at the base.", _of("Whisker")],
    "tip_radius_um": Annotated[Number, "Radius at the tip, 0 for a perfect cone.", _of("Whisker")],
    "youngs_modulus_gpa": Annotated[Number, "Young's modulus.  [default: 3.34]", _of("Whisker")],
    "curvature_per_m": Annotated[
        str | None,
        "Curvature at rest, above 0 where touched on the convex side; own for that of the "
        "--identity.  [default: 0]",
        _of("Whisker", metavar="NUMBER"),
    ],
}
#: Parameters of these names in every command that does not annotate them otherwise.
_SHARED: dict[str, Any] = {
    "cue": Annotated[
        str | None,
        "What distance is inferred from: compliance, force-map, three-forces (transverse too), "
        "moment (at a known angle), vibration, space-map, balance-of-moments, "
        "felt-effort, unknown-stiffness, fused (tap and force map), angle-side-angle, "
        "two-whiskers, contact-and-detachment, vibrissa-length or comparative-length. Choices "
        "are by the first four.  [default: compliance]",
        _of("Cue and receptors"),
    ],
    "deflection_angle_deg": Annotated[
        Texts,
        "Deflection of the contact.  [default: 10 where forces are encoded; for compliance 0, "
        "the lightest tap]",
        _of("Cue and receptors"),
    ],
    "standard_mm": Annotated[Texts, "Radial distances, where there is a whisker."],
    "radial_distance_mm": Annotated[Texts, "Straight line to the contact."],
    "column": Annotated[Texts, "The table's name of a quantity.", {"metavar": "NAME=COLUMN"}],
    "unit": Annotated[Texts, "Unit of a quantity, such as mN or uN m/s.", {"metavar": "NAME=UNIT"}],
    "workers": Annotated[int | None, "Processes.  [default: one a core]", _of("Workers")],
    "scheduler": Annotated[
        str | None, "A dask.distributed scheduler, tcp://… (extra: cluster).", _of("Workers")
    ],
    "prior": Annotated[
        Texts,
        "Belief about weber_fraction, lapse_low, lapse_high, bias or criterion, or an effect: a "
        "distribution as scipy.stats has it, bias='norm(0, 2)', or a number that is known; may "
        "be repeated.  [default: those that the report names]",
        {"metavar": "NAME=BELIEF"},
    ],
    "only": Annotated[
        Texts,
        "Trials whose column has this value, or one of several (block=test,probe), and no others; "
        "may be repeated, for trials that have all.",
        {"metavar": "COLUMN=VALUES"},
    ],
    "without": Annotated[
        Texts,
        "Trials to leave out: block=practice; may be repeated.",
        {"metavar": "COLUMN=VALUES"},
    ],
    "seed": Annotated[int, "Seed of the draws.", _of("Results", parser=a_seed, metavar="NUMBER")],
    "out": Annotated[
        Path | None, "Folder for the tables, figures and record.", _of("Results", metavar="FOLDER")
    ],
    "as_json": Annotated[bool, "Print only the result, as JSON.", _of("Results")],
}


def _plain(value: Any) -> str:
    """The value of an option; none where only the user knows it, or where it is a flag."""
    if isinstance(value, list | tuple):
        return quote(",".join(f"{one:g}" if isinstance(one, float) else str(one) for one in value))
    return "" if value is ... or value is True else quote(str(value))


def _pairs(value: Mapping[str, Any]) -> list[str]:
    return [f"{name}={quote('<its name>' if v is ... else str(v))}" for name, v in value.items()]


def _beliefs(priors: Mapping[str, Any]) -> list[str]:
    """Each belief as `--prior` takes it."""
    texts = {
        name: prior if isinstance(prior, str) else in_code(prior).removeprefix("scipy.stats.")
        for name, prior in priors.items()
    }
    return [f"{name}={quote(text)}" for name, text in texts.items()]


class Spelled(NamedTuple):
    """How the command line spells a parameter of the package.

    `option` is the parameter of the command; `values` makes the value of the package one of the
    command line, or several, or None where it cannot.
    """

    option: str
    values: Callable[[Any], str | list[str] | None] = _plain


def _effects(effects: Any) -> list[str]:
    """Effects by their names, formulas as they are, each once."""
    return [*dict.fromkeys(quote(getattr(effect, "by_name", effect)) for effect in effects)]


#: Parameters of the package whose options have another name, or other values.
SPELLED = {
    "columns": Spelled("column", _pairs),
    "units": Spelled("unit", _pairs),
    "choice_labels": Spelled("label", _pairs),
    "effects": Spelled("effect", _effects),
    "priors": Spelled("prior", _beliefs),
    "curvature": Spelled("curvature_per_m"),
    "curved": Spelled("curvature_per_m", lambda curved: "own" if curved else "0"),
    "together": Spelled("apart", lambda together: None if together else ""),
    "tracked_signals.identity": Spelled("label"),
    "locate.noise": Spelled("weber_fraction"),
}
#: The parameters of the command that runs; None outside of any.
_here: ContextVar[frozenset[str] | None] = ContextVar("parameters of the command", default=None)


def as_options(text: str) -> str:
    """A text of the package, with its arguments as options of the command that runs."""
    return rendered(text, _as_typed)


def _as_typed(piece: Typed) -> str:
    """What can be typed as options; what is none of the command that runs stays Python."""
    typed = _options(piece)
    return str(piece) if typed is None else " ".join(typed)


def _options(piece: Typed) -> list[str] | None:
    """The options of a piece of advice, None where it has none."""
    if isinstance(piece, Call):
        inner = [p for text in piece.arguments if isinstance(text, Advice) for p in text.pieces]
        options = [_options(p) for p in inner if not isinstance(p, str | Remedy)]
        return None if None in options else [o for each in options if each for o in each] or None
    of = getattr(piece, "of", "")
    spelled = SPELLED.get(f"{of}.{piece.name}" if of else piece.name, Spelled(piece.name))
    here = _here.get()
    if here is not None and spelled.option not in here:
        return None
    if isinstance(piece, Named):
        return [option(spelled.option)]
    values = spelled.values(piece.value)
    if values is None:
        return None
    if piece.value is False and spelled.values is _plain:
        return [option(f"no_{spelled.option}")]
    each = [values] if isinstance(values, str) else values
    return [f"{option(spelled.option)} {value}".rstrip() for value in each]


def command(function: Callable[..., None]) -> Callable[..., None]:
    """A Typer command made from a function with plain parameters.

    A parameter is annotated with its type, its line of help and further options of Typer:
    ``Annotated[float, "Sd of ln k.", {"metavar": "SD"}]``. With only a type it is the shared
    parameter of its name. Without a default, or with ``{"argument": True}``, it is an argument.
    The parameter `shape` stands for all options of a whisker;
    ``Annotated[Shape, {"identity": "..."}]`` gives some of them other help.
    """
    given = dict(inspect.signature(function, eval_str=True).parameters)
    shape = given.pop("shape", None)
    shaped = shape is not None
    helps = dict(*getattr(shape.annotation, "__metadata__", ())) if shape else {}
    kinds = {name: None for name in _SHAPE} if shaped else {}
    kinds |= {name: p.default for name, p in given.items()}
    parameters = []
    for name, default in kinds.items():
        kind = _SHAPE[name] if name not in given else given[name].annotation
        kind = kind if get_origin(kind) is Annotated else _SHARED[name]
        type_of, line, *more = get_args(kind)
        parameters.append(
            inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, default=default,
                annotation=_with_typer(
                    name, default is inspect.Parameter.empty, type_of, helps.get(name, line), *more
                ),
            )
        )  # fmt: skip

    @wraps(function)
    def run(**options: Any) -> None:
        if shaped:
            options["shape"] = Shape(*(options.pop(name) for name in _SHAPE))
        before = _here.set(frozenset(kinds))
        try:
            function(**options)
        except Refusal as error:
            raise error.rendered(_as_typed) from error
        finally:
            _here.reset(before)

    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {p.name: p.annotation for p in parameters}
    return run


def _with_typer(
    name: str, is_argument: bool, kind: Any, words: str, more: Mapping[str, Any] = {}
) -> Any:
    options = {"help": words, **more}
    also = options.pop("also", ())
    if options.pop("argument", is_argument):
        return Annotated[kind, typer.Argument(**options)]
    if kind in (float, Number):
        options = {"parser": a_number, "metavar": "NUMBER", **options}
    elif kind == Texts:
        options = {"metavar": "LIST", **options}
    either = f"{option(name)}/{option(f'no_{name}')}" if kind == bool | None else option(name)
    return Annotated[kind, typer.Option(either, *also, **options)]


def as_asked(options: Mapping[str, Any], *without: str) -> dict[str, Any]:
    """A command's options for its record, with the whisker's, without those of the output."""
    left_out = {"out", "as_json", "seed", "workers", "scheduler", *without}
    kept = {name: value for name, value in options.items() if name not in left_out}
    return (kept.pop("shape")._asdict() if "shape" in kept else {}) | kept


def enough_draws(draws: int) -> None:
    """Refuse fewer readings than an sd needs."""
    if draws < 2:
        raise Refusal("--draws needs at least two noisy readings", draws, "write 200, say")


#: Cues of forces with Weber noise, the only ones for choices.
CUES = ("compliance", "force-map", "three-forces", "moment")


def _array(whisker: ww.Whisker) -> ww.cues.ComparativeLength:
    """Comparative length, with a longer and a shorter neighbour as in a row of whiskers."""
    lengths = np.array([1.25, 0.8]) * whisker.length
    return ww.cues.ComparativeLength(lengths, [[-2e-3, 0.0], [2e-3, 0.0]])


#: Other cues, with the defaults of their parameters.
SCENES: dict[str, Callable[[ww.Whisker], ww.cues.Cue]] = {
    "vibrissa-length": lambda whisker: ww.cues.VibrissaLength(),
    "comparative-length": _array,
    "angle-side-angle": lambda whisker: ww.cues.AngleSideAngle(),
    "two-whiskers": lambda whisker: ww.cues.TwoWhiskers(),
    "contact-and-detachment": lambda whisker: ww.cues.ContactAndDetachment(),
    "vibration": lambda whisker: ww.cues.Vibration(),
    "space-map": lambda whisker: ww.cues.SpaceMap(),
    "balance-of-moments": lambda whisker: ww.cues.BalanceOfMoments(),
    "felt-effort": lambda whisker: ww.cues.BalanceOfMoments(effort=None),
    "unknown-stiffness": lambda whisker: ww.cues.UnknownStiffness(ww.cues.ForceMap()),
    "fused": lambda whisker: ww.cues.Fused(ww.cues.Compliance(), ww.cues.ForceMap()),
}


def the_scene(
    cue: str | None, angles_deg: Texts, weber_fraction: Texts, whisker: ww.Whisker
) -> tuple[ww.Observer, Array]:
    """The observer of any cue, and the deflection angles (rad) of its contacts."""
    if cue not in SCENES:
        name = None if cue is None else checks.one_of("cue", cue, (*CUES, *SCENES))
        made, angles = the_cue(name, angles_deg)
        k = weber_fractions(weber_fraction, len(made.signal_names))
        return ww.Observer(whisker, made, ww.inference.default_noise(whisker, made, k)), angles
    made = SCENES[cue](whisker)
    deflected = "deflection_angle" in made.unknowns
    useless = [(weber_fraction, "--weber-fraction")]
    useless += [] if deflected else [(angles_deg, "--deflection-angle-deg")]
    for given, what in useless:
        if given:
            raise Refusal(
                f"The cue {cue} has no use for {what}",
                ", ".join(given),
                "leave it out, or write --cue force-map",
            )
    return ww.Observer(whisker, made), _angles(angles_deg) if deflected else np.array([])


def the_cue(cue: str | None, angles_deg: Texts) -> tuple[ww.cues.Cue, Array]:
    """The cue, and the deflection angles (rad) of contacts; none where the cue fixes them."""
    name = checks.one_of("cue", cue or CUES[0], CUES)
    angles = numbers("--deflection-angle-deg", angles_deg or [])
    if name == "compliance":
        tap = one_angle(angles, "The compliance cue has one angle of tap") or 0.0
        checks.non_negative("--deflection-angle-deg", tap, "give degrees, 0 say")
        return ww.cues.Compliance(tap_angle=float(np.radians(tap))), np.array([])
    deflections = _angles(angles_deg)
    if name == "moment":
        fixed = one_angle(deflections, "The moment is encoded at one known angle")
        return ww.cues.ForceMap("moment", deflection_angle=fixed), np.array([])
    third = ("transverse_force",) * (name == "three-forces")
    return ww.cues.ForceMap(("moment", "axial_force", *third)), deflections


def one_angle(angles: Array, why: str = "Choices are made at one deflection angle") -> float | None:
    """The only deflection angle; None where the cue fixes it."""
    if angles.size > 1:
        raise Refusal(why, f"{angles.size} values of --deflection-angle-deg", "give one")
    return float(angles[0]) if angles.size else None


def _angles(texts: Texts) -> Array:
    """Deflection angles in rad, by default 10°."""
    given = numbers("--deflection-angle-deg", texts or ["10"])
    return np.radians(checks.positive("--deflection-angle-deg", given, "give degrees, 10 say"))


def weber_fractions(texts: Texts, signals: int | None = None) -> Array | float:
    """The value of ``--weber-fraction``: one for all signals, or one each."""
    fractions = numbers("--weber-fraction", texts or ["0.1"])
    checks.positive("--weber-fraction", fractions, "write 0.1, say")
    if signals is not None and fractions.size not in (1, signals):
        raise Refusal(
            f"--weber-fraction takes one number, or one for each signal of the cue ({signals})",
            fractions.size,
            "write 0.1, say",
        )
    return fractions if fractions.size > 1 else float(fractions[0])


def the_whisker(shape: Shape, seed: int | None = None) -> ww.Whisker:
    """The whisker of the shared options; with `seed`, a draw from the spread of its identity."""
    identity, length_mm, base_radius_um, tip_radius_um, youngs_modulus_gpa, bow = shape
    modulus: dict[str, Any] = {}
    curved: dict[str, Any] = {}
    if bow is not None and not (bow == "own" and identity is not None):
        hint = "give 1/m, such as -8" + (", or own" if identity is not None else "")
        curved["curvature"] = float(checks.finite("--curvature-per-m", bow, hint))
    if youngs_modulus_gpa is not None:
        checks.positive("--youngs-modulus-gpa", youngs_modulus_gpa, "give GPa, such as 3.34")
        modulus["youngs_modulus"] = youngs_modulus_gpa * 1e9
    names = [option(name) for name in Shape._fields[1:4]]
    given = [n for n, value in zip(names, shape[1:4], strict=True) if value is not None]
    if identity is not None:
        if given:
            raise Refusal(
                "A whisker has an identity or a shape",
                f"--identity and {given[0]}",
                "leave one of them out",
            )
        made = ww.Whisker.from_identity(identity, seed=seed, curved=bow == "own", **modulus)
        return replace(made, **curved) if curved else made
    if not given:
        raise Refusal(
            "No whisker is given",
            remedy=(
                "write --identity C2, or its shape with --length-mm, --base-radius-um and "
                "--tip-radius-um"
            ),
        )
    if length_mm is None or base_radius_um is None or tip_radius_um is None:
        missing = [name for name in names if name not in given]
        raise Refusal(
            "The whisker's shape is incomplete",
            " and ".join(given),
            f"write {' and '.join(missing)} as well",
        )
    if seed is not None:
        raise Refusal(
            "--seed draws a whisker of an --identity",
            f"a shape and --seed {seed}",
            "leave --seed out",
        )
    checks.positive("--length-mm", length_mm, "give millimetres, such as 50")
    checks.positive("--base-radius-um", base_radius_um, "give micrometres, such as 100")
    checks.non_negative("--tip-radius-um", tip_radius_um, "give micrometres, such as 5")
    made = ww.Whisker(length_mm * 1e-3, base_radius_um * 1e-6, tip_radius_um * 1e-6, **modulus)
    return replace(made, **curved) if curved else made


def describe(whisker: ww.Whisker) -> dict[str, float]:
    """A whisker in the units of the command line."""
    values = {
        "length_mm": whisker.length * 1e3, "base_radius_um": whisker.base_radius * 1e6,
        "tip_radius_um": whisker.tip_radius * 1e6,
        "youngs_modulus_gpa": whisker.youngs_modulus / 1e9,
    }  # fmt: skip
    values |= {"curvature_per_m": whisker.curvature} if whisker.curvature else {}
    return {name: float(f"{value:.12g}") for name, value in values.items()}


def encoding_options(encoding: Any) -> str | None:
    """The options by which `fit` has an encoding: none of a magnitude itself, the whisker and cue
    of a distance; None where it has not."""
    kind = type(encoding).__name__
    if kind in ("IdentityEncoding", "LogEncoding"):
        return ""
    observer: Any = getattr(encoding, "observer", None)
    if kind != "CueEncoding" or type(observer.cue).__name__ != "Compliance":
        return None
    if observer.cue.tap_angle:
        return None
    said = (f" {option(name)} {value:g}" for name, value in describe(observer.whisker).items())
    return "".join(said)


def finish(run: Run, as_json: bool, answer: Any, *lines: str) -> None:
    """Print a result: either as JSON, or in words with the names of the files."""
    if as_json:
        print(to_json(answer))
        return
    for line in lines:
        print(as_options(line))
    if run.out_dir is not None:
        print(f"Written to {run.out_dir}: {', '.join(run.files)}.")


def show(
    table: pd.DataFrame, run: Run, whisker: ww.Whisker, as_json: bool, notes: Iterable[str]
) -> None:
    """Print a whisker, a table and notes."""
    answer = {"whisker": describe(whisker), "rows": table.to_dict("records")}
    words = table.to_string(index=False, float_format="{:.6g}".format, na_rep="-")
    finish(run, as_json, answer, whisker_line(whisker), words, *notes)


def whisker_line(whisker: ww.Whisker) -> str:
    """A whisker in one sentence."""
    bow = f", curvature {whisker.curvature:+g} /m" if whisker.curvature else ""
    return (
        "Whisker: {length_mm:g} mm long, radius {base_radius_um:g} µm at the base and "
        "{tip_radius_um:g} µm at the tip, {youngs_modulus_gpa:g} GPa{bow}."
    ).format(**describe(whisker), bow=bow)


def pairs(name: str, texts: Sequence[str] | None, example: str) -> dict[str, str]:
    """The values of an option, each `left=right`, as a mapping."""
    out = {}
    for text in texts or ():
        left, sign, right = text.partition("=")
        if not (left and sign and right):
            raise Refusal(f"{name} takes a pair such as {example}", f"{text!r}")
        out[left.strip()] = right.strip()
    return out


def chosen_trials(
    trials: ww.Trials, only: Sequence[str] | None, without: Sequence[str] | None
) -> ww.Trials:
    """The trials with the values that `--only` gives, but those that `--without` does."""
    example = "block=practice"
    for name, texts in (("--only", only), ("--without", without)):
        for one in texts or ():
            ((column, text),) = pairs(name, [one], example).items()
            there = (
                trials.frame[column].dropna().unique() if column in trials.frame else np.array([])
            )
            values = {column: values_of(text, there.tolist())}
            trials = trials.select(**values) if name == "--only" else trials.without(**values)
    return trials


def values_of(text: str, there: list[Any]) -> list[Any]:
    """The value of that name, or several with commas between, or in ranges of numbers.

    Examples
    --------
    >>> values_of("1,3-5", [1, 2, 3, 4, 5]), values_of("10-03", ["10-03", "11-03"])
    ([1, 3, 4, 5], ['10-03'])
    """
    names = {_as_number(value): value for value in there} | {str(value): value for value in there}
    if text.strip() in names:
        return [names[text.strip()]]
    chosen: list[Any] = []
    for part in map(str.strip, text.split(",")):
        ends = re.fullmatch(r"(\d{1,6})-(\d{1,6})", part)
        if ends and part not in names:
            numbers = map(str, range(int(ends[1]), int(ends[2]) + 1))
            chosen.extend(names.get(number, number) for number in numbers)
        else:
            chosen.append(names.get(part, part))
    return chosen


def _as_number(value: Any) -> str:
    """A value of a table as one would type it: whole numbers without a point, texts too."""
    try:
        number = float(value)
    except ValueError:
        return str(value)
    return f"{number:.0f}" if number.is_integer() else str(value)


def beliefs(texts: Texts, example: str = "bias='norm(0, 2)'") -> dict[str, Any]:
    """The values of ``--prior`` by parameter; `levels` alone is that of the Weber fraction."""
    from ..behaviour.priors import belief_named

    texts = ["weber_fraction=levels" if text == "levels" else text for text in texts or ()]
    said = pairs("--prior", texts, example)
    return {name: t if t == "levels" else belief_named(t) for name, t in said.items()}


def option(parameter: str) -> str:
    """The option of a parameter."""
    return f"--{'json' if parameter == 'as_json' else parameter.replace('_', '-')}"
