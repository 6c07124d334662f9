"""`weberwhisk figure`, `paper` and `chart`: what every cue tells, the paper's figures, speed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

import weberwhisk as ww

from .. import _checks, along_whisk, surveys
from .._values import pd
from ..behaviour import CueEncoding, Encoding, PooledEncoding, response_probability, task_named
from ..cli import progress
from ..design import Hypothesis, Scheme, taper
from ..inference import default_noise
from ..mechanics.muscle import MuscleCurve
from ..output import Run, atomic_write
from . import NO_SHAPE, Shape, Text, as_asked, command, describe, finish, the_whisker
from .whiskers import curve_in_steps


class Made(NamedTuple):
    """A chart, and the tables behind it by name."""

    tables: dict[str, pd.DataFrame]
    chart: Any


class Asked(NamedTuple):
    """What a chart is made of: a whisker, its identity if it has one, and how."""

    whisker: ww.Whisker = surveys.WHISKER
    short: bool = False
    seed: int = surveys.SEED
    identity: str | None = None

    def readings(self, times: int = 1) -> int:
        """Posteriors at each distance, few where it is to be quick."""
        return 16 if self.short else 200 * times


def _made(name: str, table: pd.DataFrame, chart: Any) -> Made:
    return Made({name: table}, chart)


def _of(asked: Asked) -> dict[str, Any]:
    return {"whisker": asked.whisker, "identity": asked.identity, "seed": asked.seed}


def cues(asked: Asked) -> Made:
    """JND of each cue against distance, posteriors over closed forms, where each works"""
    table = surveys.curves(8 if asked.short else 30, asked.readings(), **_of(asked))
    return _made("cues", table, ww.figures.cue_jnds(table))


def outcomes(asked: Asked) -> Made:
    """where each cue finds a distance, and what fails elsewhere or by chance"""
    table = surveys.outcomes(25 if asked.short else 100, asked.readings(2), **_of(asked))
    return _made("outcomes", table, ww.figures.cue_outcomes(table))


def best_cue(asked: Asked) -> Made:
    """the best cue at every contact, over distance and deflection"""
    table = surveys.best(40 if asked.short else 90, whisker=asked.whisker)
    return _made("best-cue", table, ww.figures.best_cue(table, surveys.MAPPED))


def ridge(asked: Asked) -> Made:
    """pair plot of the posterior of one reading: a taper's, and a cylinder's ridge"""
    table = surveys.ridge(400 if asked.short else 8000, whisker=asked.whisker, seed=asked.seed)
    contact = surveys.RIDGE[0] * asked.whisker.length, surveys.RIDGE[1]
    return _made("ridge", table, ww.figures.ridge(table, contact))


def information(asked: Asked) -> Made:
    """bits about distance that each cue tells alone and adds to the others"""
    table = surveys.bits(40 if asked.short else 400, whisker=asked.whisker, seed=asked.seed)
    return _made("information", table, ww.figures.cue_information(table))


def weber_2d(asked: Asked) -> Made:
    """Weber's law in two dimensions: either limit, between them, and the false zero"""
    surfaces = {
        name: surveys.surface(*noise, 40 if asked.short else 80, whisker=asked.whisker)
        for name, noise in surveys.FAMILY.items()
    }
    zero = surveys.false_zero(asked.readings(), whisker=asked.whisker, seed=asked.seed)
    between = surveys.linear_between(whisker=asked.whisker)
    chart = ww.figures.weber_2d(
        surfaces, zero, between, length=asked.whisker.length, weber_fraction=surveys.K
    )
    return Made({"weber-2d": zero, "weber-2d-gain": surveys.gain()}, chart)


def figure_4a(asked: Asked) -> Made:
    """the paper's figure 4a: JND by compliance, tapered and cylindrical, with posteriors"""
    found = light_taps(asked.whisker, surveys.K, "emcee", asked.readings(2), asked.seed)
    drawn = ww.figures.jnd_lines(found, length=asked.whisker.length, weber_fraction=surveys.K)
    return _made("figure-4a", tapered_and_not(found), drawn)


def light_taps(
    whisker: ww.Whisker, k: float, method: str, draws: int, seed: int, as_json: bool = False
) -> dict[str, ww.JNDCurve]:
    """Figure 4a's posteriors, of a whisker and of a cylinder as long, at ten places."""
    places, found = np.linspace(0.05, 0.95, 10) * whisker.length, {}
    for name, shape in (("tapered", whisker), ("cylinder", whisker.cylinder())):
        observer = ww.Observer(shape, ww.cues.Compliance(), ww.receptors.Weber(k))
        options = (np.array([]), method, "d'=1", draws, seed, as_json, f"{method}, {name}")
        found[name] = curve_in_steps(observer, places, *options)
    return found


def tapered_and_not(curves: dict[str, ww.JNDCurve]) -> pd.DataFrame:
    """The tables of some whiskers under one another."""
    tables = {name: curve.table for name, curve in curves.items()}
    return pd.concat(tables, names=["whisker"]).reset_index()


def figure_4b(asked: Asked) -> Made:
    """the paper's figure 4b: JND by the force map, with noise in the moment alone"""
    table = surveys.surface(surveys.K, surveys.NONE, whisker=asked.whisker)
    drawn = ww.figures.jnd_surface(table, length=asked.whisker.length, weber_fraction=surveys.K)
    return _made("figure-4b", table, drawn)


def jnd_surface(asked: Asked) -> Made:
    """figure 4b's surface by full posteriors, with noise in both signals (10 s)"""
    points, draws = 10 if asked.short else 30, min(asked.readings(), 100)
    table = surveys.posterior_surface(points, draws, whisker=asked.whisker, seed=asked.seed)
    drawn = ww.figures.jnd_surface(table, length=asked.whisker.length, weber_fraction=surveys.K)
    return _made("jnd-surface", table, drawn)


def curvature(asked: Asked) -> Made:
    """JND of curved and rubbing whiskers, and what taking the rat's as straight costs"""
    how: Any = {"whisker": asked.whisker, "seed": asked.seed}
    jnds = surveys.curvatures(5 if asked.short else 13, min(asked.readings(), 12), **how)
    biases = surveys.taken_as_straight("C" if asked.short else "ABCDE")
    drawn = ww.figures.curvature(jnds, biases)
    return Made({"curvature": jnds, "curvature-ignored": biases}, drawn)


def along_push(asked: Asked) -> Made:
    """JND of distance against push, for pegs, cylinders and a wall: it depends on slip (§3c)"""
    push = np.radians(np.arange(2.0, 31.0, 7.0 if asked.short else 0.5))
    table = along_whisk.resolution_along_push(asked.whisker, 0.5 * asked.whisker.length, push)
    return _made("along-push", table, ww.figures.along_push(table))


def lateral_sweep(asked: Asked) -> Made:
    """the distance of a peg and of a cylinder, followed along a sweep by the moment (§2g)"""
    push = np.radians(np.arange(1.0, 31.0, 5.0 if asked.short else 1.0))
    middle = 0.5 * asked.whisker.length
    table = along_whisk.lateral_sweep(asked.whisker, middle, push, seed=asked.seed)
    return _made("lateral-sweep", table, ww.figures.lateral_sweep(table))


def touches(asked: Asked) -> Made:
    """JND of distance against the number of touches, beside 1/√n and what mice do (§4)"""
    from ..jnd_curves import touches_jnd

    whisker, tables = asked.whisker, []
    if whisker is surveys.WHISKER:  # what it is beside was found with mice
        whisker = ww.Whisker.from_identity("C2", species="mouse")
    known = ww.cues.ForceMap()
    for k, cue in ((0.3, known), (0.1, known), (0.1, ww.cues.UnknownStiffness(known))):
        observer = ww.Observer(whisker, cue, default_noise(whisker, cue, k))
        r = 0.6 * whisker.length
        angle = observer.angle_range(np.array([r]))[1]  # as likely anywhere in it, as the prior
        name = f"k = {k:g}" if cue is known else "the same, stiffness unknown"
        table = touches_jnd(
            observer,
            r,
            angle * np.array([0.45, 0.15, 0.75, 0.25, 0.55, 0.95, 0.05, 0.35, 0.65, 0.85]),
            (1, 4, 17) if asked.short else (1, 2, 3, 5, 8, 12, 17, 30, 50),
            n_readings=asked.readings() if cue is known else min(asked.readings(), 20),
            seed=asked.seed,
        )
        tables.append(table.assign(receptors=name))
    joined = pd.concat(tables, ignore_index=True)
    return _made("touches", joined, ww.figures.touches(joined))


def behaviour(asked: Asked) -> Made:
    """choices and power with curved whiskers, several touches or whiskers, at a pole (minutes)"""
    choices, powers = _choices(asked), _powers(asked)
    drawn = ww.figures.decisions(choices, powers)
    return Made({"behaviour": choices, "behaviour-power": powers}, drawn)


def _two(whisker: ww.Whisker) -> tuple[ww.Whisker, ww.Whisker]:
    """A whisker that is touched on its concave side, and a smaller one whose base is as far off."""
    bowed = replace(whisker, curvature=-0.6 / whisker.length)
    sizes = {name: 0.7 * getattr(whisker, name) for name in ("length", "base_radius", "tip_radius")}
    return bowed, replace(bowed, **sizes)


def _choices(asked: Asked) -> pd.DataFrame:
    """Shares of answers about a pole and one at 0.4 of the length, by moment and axial force."""
    whisker, (bowed, smaller) = asked.whisker, _two(asked.whisker)
    convex = replace(whisker, curvature=0.6 / whisker.length)
    straight, concave, other, far = (
        CueEncoding(ww.Observer(w, ww.cues.ForceMap()), surveys.ANGLE)
        for w in (whisker, bowed, smaller, convex)
    )
    decisions: dict[str, tuple[Encoding, str]] = {
        "straight": (straight, "2AFC"),
        "concave side": (concave, "2AFC"),
        "convex side": (far, "2AFC"),
        "concave, 5 touches": (PooledEncoding((concave,) * 5), "2AFC"),
        "concave, 2 whiskers": (PooledEncoding((concave, other)), "2AFC"),
        "concave, go/no-go": (concave, "go/no-go"),
    }
    standard = 0.4 * whisker.length
    r, tables = standard * np.linspace(0.7, 1.3, 13 if asked.short else 61), []
    for name, (encoding, task) in decisions.items():
        chance = response_probability(
            task_named(task), encoding, standard + 0 * r, r, weber_fraction=surveys.K
        )
        right = np.where(r < standard, 1 - chance, chance)
        tables.append(
            pd.DataFrame(
                {"decision": name, "task": task, "standard_mm": 1e3 * standard,
                 "radial_distance_mm": 1e3 * r, "farther": chance, "correct": right}
            )
        )  # fmt: skip
    return pd.concat(tables, ignore_index=True)


def _powers(asked: Asked) -> pd.DataFrame:
    """How often each question is decided, by taps on a pole, by trials of each comparison."""
    bowed, smaller = _two(asked.whisker)
    one, other = (CueEncoding(ww.Observer(w, ww.cues.Compliance())) for w in (bowed, smaller))
    questions = {"taper, straight": taper(asked.whisker), "taper, concave": taper(bowed)}
    for task in ("2AFC", "go/no-go"):
        questions[f"one whisker or two, {task}"] = (
            Hypothesis("one whisker", one, task=task),
            Hypothesis("two whiskers", PooledEncoding((one, other)), task=task),
        )
    trials = (10, 40) if asked.short else (10, 20, 40, 80, 160, 320)
    tables = []
    for name, hypotheses in questions.items():
        # Of the two whiskers both reach the nearer pole, one the farther.
        at = np.array([0.3, 0.8]) * asked.whisker.length
        scheme = Scheme.spaced(hypotheses[0].encoding, at, weber_fraction=surveys.K)
        runs = 16 if asked.short else 256
        found = ww.power(scheme, hypotheses, trials=trials, runs=runs, seed=asked.seed)
        tables.append(found.table.assign(question=name, goal=found.goal.share))
    return pd.concat(tables, ignore_index=True)


def jnd_limits(asked: Asked) -> Made:
    """limits of torque, threshold and saturation on one JND curve (§3b)"""
    places = np.linspace(0.04, 0.98, 25 if asked.short else 190) * asked.whisker.length
    table = along_whisk.limits(asked.whisker, places)
    drawn = ww.figures.jnd_limits(table, asked.whisker.length)
    return _made("jnd-limits", table, drawn)


def reversal(asked: Asked) -> Made:
    """objects pressed and let go with friction, by a base that turns and one that translates"""
    push = np.radians(np.linspace(2.0, 25.0, 4 if asked.short else 47))
    table = along_whisk.reversal(asked.whisker, 0.5 * asked.whisker.length, push)
    return _made("reversal", table, ww.figures.reversal(table))


def whisking_speed(asked: Asked) -> Made:
    """up to which whisking frequency quasi-static mechanics hold, along the whisker"""
    places = np.linspace(0.05, 0.99, 9 if asked.short else 95) * asked.whisker.length
    table = along_whisk.speed(asked.whisker, places)
    drawn = ww.figures.whisking_speed(table, asked.whisker.length)
    return _made("whisking-speed", table, drawn)


def array_resolution(asked: Asked) -> Made:
    """how well the rat's whiskers (rows C to E) resolve a pole's place, over all places"""
    array = _level_array(asked, np.radians(40.0))
    step = 2e-3 if asked.short else 0.4e-3
    x, y = np.arange(4e-3, 58e-3, step), np.arange(-24e-3, 14e-3, step)
    table = ww.array_resolution(ww.ArrayObserver(array), x, y)
    return _made("array-resolution", table, ww.figures.array_map(table, array))


def array_counts(asked: Asked) -> Made:
    """apertures discriminated by the number of whiskers left intact, by an ideal observer"""
    array, tables = _level_array(asked, np.radians(40.0)), []
    places = np.linspace(-10e-3, 10e-3, 11 if asked.short else 41)
    for k, degrees in ((0.1, 1.0), (0.3, 3.0), (0.6, 6.0)):
        noise = ww.receptors.Weber(k)
        observer = ww.ArrayObserver(array, noise=noise, angle_sd=np.radians(degrees))
        table = ww.array_by_count(observer, 25e-3, places, range(1, 21), seed=asked.seed)
        tables.append(table.assign(receptors=f"k = {k:g}, azimuths ± {degrees:g}°"))
    joined = pd.concat(tables, ignore_index=True)
    return _made("array-counts", joined, ww.figures.array_counts(joined))


def _level_array(asked: Asked, protraction: float) -> ww.WhiskerArray:
    """The rows of a rat's right side that stay within 30° of the horizontal."""
    if asked.whisker is not surveys.WHISKER:
        raise ValueError("This figure is of a whole array, got one whisker; leave it out.")
    array = ww.WhiskerArray("rat", "right")
    level = [name for name in array.identities if name[0] in "CDE"]
    return array.only(level).protract(protraction)


#: The charts by name.
CHARTS: dict[str, Callable[[Asked], Made]] = {
    make.__name__.replace("_", "-"): make
    for make in (
        cues, outcomes, best_cue, ridge, information, figure_4a, figure_4b, jnd_surface, weber_2d,
        curvature, along_push, lateral_sweep, touches, behaviour, jnd_limits, reversal,
        whisking_speed, array_resolution, array_counts,
    )
}  # fmt: skip


@command
def figure(
    name: Annotated[Text, "Which chart; without it, a list of them.", {"argument": True}] = None,
    shape: Shape = NO_SHAPE,
    short: Annotated[bool, "Few posteriors: seconds."] = False,
    seed: int = surveys.SEED,
    out: Path | None = None,
    as_json: bool = False,
) -> None:
    """Charts of what every cue tells of distance; each with its table.

    Without a whisker, of one 50 mm long with radii of 100 and 5 µm; k = 0.1 throughout.
    """
    inputs = as_asked(locals())
    if name is None:
        for key, make in CHARTS.items():
            print(f"{key:16} {make.__doc__}")
        return
    make = CHARTS[_checks.one_of("figure", name, CHARTS)]
    if out is None:
        raise ValueError(
            f"The figure {name} needs a folder to be written to, got none; write --out {name}."
        )
    whisker = the_whisker(shape) if shape.given else surveys.WHISKER
    # A record for each figure, so that several stand side by side in one folder.
    with Run(out, f"figure-{name}", inputs | {"whisker": describe(whisker)}, seed) as run:
        made = make(Asked(whisker, short, seed, shape.identity))
        for key, table in made.tables.items():
            run.table(key, table)
        run.figure(name, made.chart)
    answer = {key: table.to_dict("records") for key, table in made.tables.items()}
    note = ww.Observer(whisker, ww.cues.ForceMap()).note if shape.identity else ""
    finish(run, as_json, answer, *[f"By the force map {note}"] * bool(note))


@command
def paper(
    short: Annotated[bool, "Few posteriors: seconds."] = False,
    seed: int = surveys.SEED,
    out: Annotated[Path, "Folder for figures and paper.md.", {"metavar": "FOLDER"}] = Path("paper"),
    as_json: bool = False,
) -> None:
    """Every figure of Solomon & Hartmann (2011), and every claim with what we find.

    Writes figures 1d, 2a-f, 3a-c, 4a and 4b with their tables, and paper.md: each equation and
    claim, the numbers found now, the test that shows it, and where the sentence ends.
    """
    from .. import paper as remade
    from ..paper import claims

    inputs = {"radius_ratio": float(surveys.WHISKER.radius_ratio), "short": short}
    with Run(out, "paper", inputs, seed) as run:
        with progress("The paper's figures", len(claims.PANELS) + 1, as_json=as_json) as advance:
            made: dict[str, tuple[dict[str, pd.DataFrame], Any]] = {}
            rates = remade.moment_rates()
            drawn = ww.figures.paper_1d(rates)
            made["figure-1d"] = {"figure-1d": rates}, drawn
            advance()
            arcs, degrees = (remade.ARCS, remade.DEGREES)
            table = remade.contacts(arcs, degrees[::3] if short else degrees)
            chart = ww.figures.paper_2(remade.examples(), remade.lines(), table)
            made["figure-2"] = {"figure-2": table}, chart
            advance()
            step = slice(None, None, 5 if short else 1)
            place, impact = remade.DISTANCES[step], remade.IMPACTS[step]
            a, b = remade.moments(), remade.balance_angles()
            c = remade.surface(MuscleCurve.NORMALISED, place, impact)
            line, angle = remade.dashed_line()
            edge = (line[step], angle[step])
            chart = ww.figures.paper_3(a, remade.muscle(), b, c, edge)
            made["figure-3"] = {"figure-3a": a, "figure-3b": b, "figure-3c": c}, chart
            advance()
            for name, make in (("figure-4a", figure_4a), ("figure-4b", figure_4b)):
                made[name] = make(Asked(short=short, seed=seed))
                advance()
            rows = list(claims.rows())
            advance()
        for name, (tables, chart) in made.items():
            for key, each in tables.items():
                run.table(key, each)
            run.figure(name, chart)
        atomic_write(run.path("paper.md"), claims.as_markdown(rows))
    finish(run, as_json, {"claims": rows, "files": run.files})


@command
def chart(
    full: Annotated[bool, "Every setting and more data: some ten minutes."] = False,
    out: Path = Path("chart"),
    as_json: bool = False,
) -> None:
    """Chart error against CPU time: beams, posteriors, JND curves and fits, and how each grows.

    Takes about half a minute; with --full ten. Every method is swept over its own knob; time and
    error are of the same run. What needs other packages (PyElastica, dynesty, psignifit and so on)
    is added by analyses/speed_accuracy.py.
    """
    from .. import charts, figures

    foot = charts.machine()
    tables = {}
    with Run(out, "chart", {"full": full, "machine": foot}) as run:
        with progress("Charting", len(charts.PARTS), as_json=as_json) as advance:
            for name, measure in charts.PARTS.items():
                tables[name] = measure(full=full)
                run.table(name, tables[name])
                advance()
        table = pd.concat(tables.values(), ignore_index=True)
        run.figure("speed_accuracy", figures.speed_accuracy(table, foot=foot))
        run.figure("fits_and_growth", figures.fits_and_growth(table, foot=foot))
    lines = [foot]
    for name, rows in tables.items():
        shown = rows.drop(columns="part").dropna(axis="columns", how="all")
        lines.append(f"\n{name}\n{shown.to_string(index=False, float_format='{:.3g}'.format)}")
    finish(run, as_json, {"machine": foot, "rows": table.to_dict("records")}, *lines)
