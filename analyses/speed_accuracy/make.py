"""Speed against accuracy, with the tools of others beside this package's own.

    python analyses/speed_accuracy/make.py [--short] [--sets N] [folder]

This package's methods, each swept over its own knob (`chart.py`, `beams.py`), and beside them a
chain of rigid links on springs and PyElastica on the beams; emcee without this package's help (a
loop over readings, plain and vectorised, its stretch and its differential-evolution move), a
gradient sampler (littlemcmc's NUTS) and a nested one (dynesty) on the posteriors; psignifit and
psychofit on the fits. All but the chain and emcee come with ``pip install weberwhisk[referees]``;
what is not installed is left out, with a note.

Writes beams, posteriors, jnds, fits and growth (CSV) and a figure of each. A run that was stopped
goes on where it was.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import contextlib
import io
import re
import shutil
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import emcee
import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parent.parent))

from command import machine, options
from psignifit_side_by_side import psignifit_answer
from referees import Scene as Loaded
from referees import pyelastica
from scipy.optimize import root
from speed_accuracy import beams, plots
from speed_accuracy import chart as charts
from speed_accuracy.beams import timed

import weberwhisk as ww
from weberwhisk._util.output import Run, atomic_write, csv_text
from weberwhisk.behaviour import Trials
from weberwhisk.mechanics import closed_form

HERE = Path(__file__).parent
Array = np.ndarray
PACKAGES = ("pyelastica", "dynesty", "littlemcmc", "psignifit", "psychofit")


def missing() -> list[str]:
    """The referees that are not installed."""
    modules = {"pyelastica": "elastica"}
    return [name for name in PACKAGES if find_spec(modules.get(name, name)) is None]


# -- beams ---------------------------------------------------------------------------------------


def chain(scene: beams.Scene, links: int) -> float:
    """Rigid links on torsion springs, in balance link by link from the contact to the base.

    Half a link stands at either end; the springs are the bending stiffness over a link's length.
    """
    w = beams.WHISKER
    r, theta = scene.contact
    taper = float(w.taper / w.length)

    def at(arc: float, force: float) -> tuple[float, float, float]:
        h = arc / links
        angle, x, y = 0.0, h / 2, 0.0
        for i in range(links):  # spring i is (i + ½) links from the contact
            stiffness = float(w.stiffness) * (1 - (arc - (i + 0.5) * h) * taper) ** 4
            angle -= force * x / (stiffness / h)
            length = h if i < links - 1 else h / 2
            x, y = x + length * np.cos(angle), y + length * np.sin(angle)
        return force * x, float(np.hypot(x, y)), float(np.arctan2(y, x) - angle)

    def miss(v: Array) -> list[float]:
        _, distance, deflection = at(v[0] * r, np.exp(v[1]))
        return [distance / r - 1, deflection - theta]

    guess = float(closed_form.press(w, r, theta).force)
    solved = root(miss, [1.02, np.log(guess)], tol=1e-12)
    if not np.max(np.abs(solved.fun)) < 1e-9:
        return float("nan")
    return at(solved.x[0] * r, float(np.exp(solved.x[1])))[0]


def other_beams(full: bool) -> pd.DataFrame:
    """Rows of the spring-link chain and of PyElastica."""
    rows = []
    for scene in beams.SCENES:
        for links in (10, 30, 100, 300) if full else (10, 30):
            moment, seconds = timed(lambda: chain(scene, links), repeats=1)  # noqa: B023
            rows.append(beams.beam_row(scene, "chain of links on springs", links, moment, seconds))
        if not full or find_spec("elastica") is None:
            continue
        b = ww.press(beams.WHISKER, *scene.contact)  # it takes a force, and finds the contact
        loaded = Loaded(scene.name, beams.WHISKER, float(b.arc_length), float(b.force))
        for elements in (30, 60):
            moment, seconds = timed(lambda: pyelastica(elements, loaded).moment, repeats=1)  # noqa: B023
            rows.append(beams.beam_row(scene, "PyElastica, force given", elements, moment, seconds))
    return pd.DataFrame(rows)


# -- posteriors ----------------------------------------------------------------------------------


def starts(observer: ww.Observer, row: Array, walkers: int, rng: np.random.Generator) -> Array:
    """Walkers about Laplace's mean, in the observer's coordinates."""
    laplace = ww.posterior(observer, row, method="laplace")
    middle = np.stack([e.mean for e in laplace.estimates.values()])
    spread = 0.1 * rng.standard_normal((walkers, middle.size))
    return np.asarray(observer.space.unconstrain(middle) + spread)


def emcee_loop(observer: ww.Observer, rows: Array, steps: int, move: str, vectorize: bool) -> Array:
    """Sds of r by emcee as it comes, 32 walkers, the first fifth of the steps left out."""
    rng, out = np.random.default_rng(7), []
    moves = {"stretch": emcee.moves.StretchMove, "DE": emcee.moves.DEMove}[move]()
    for row in rows:
        x = starts(observer, row, 32, rng)
        sampler = emcee.EnsembleSampler(
            32, x.shape[1], observer.log_density, args=(row,), vectorize=vectorize, moves=moves
        )
        sampler.random_state = np.random.RandomState(int(rng.integers(2**31))).get_state()
        sampler.run_mcmc(x, steps)
        draws = sampler.get_chain(discard=steps // 5, flat=True)
        out.append(observer.space.constrain(draws)[0][:, 0].std())
    return np.array(out)


def nuts(observer: ww.Observer, rows: Array, draws: int) -> Array:
    """Sds of r by littlemcmc's NUTS, gradients by central differences in one vectorised call."""
    import littlemcmc

    rng, out = np.random.default_rng(8), []
    for row in rows:
        start = starts(observer, row, 1, rng)[0]
        step = 1e-5 * np.concatenate([np.eye(start.size), -np.eye(start.size)])

        def density(x: Array, row: Array = row, step: Array = step) -> tuple[float, Array]:
            values = observer.log_density(np.concatenate([x[None], x + step]), row)
            up, down = values[1 : x.size + 1], values[x.size + 1 :]
            return float(values[0]), (up - down) / 2e-5

        state = np.random.get_state()  # noqa: NPY002 — it draws from the global generator
        try:
            with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
                warnings.simplefilter("ignore")
                trace, _ = littlemcmc.sample(
                    logp_dlogp_func=density, model_ndim=start.size, start=start, draws=draws,
                    tune=300, chains=1, cores=1, progressbar=False,
                    random_seed=int(rng.integers(2**31)),
                )  # fmt: skip
        finally:
            np.random.set_state(state)  # noqa: NPY002
        draws_of = np.reshape(trace[0], (draws, start.size))  # a chain: draws by unknowns
        out.append(observer.space.constrain(draws_of)[0][:, 0].std())
    return np.array(out)


def nested(observer: ww.Observer, rows: Array, live: int) -> Array:
    """Sds of r by dynesty, from a box in the observer's coordinates that holds all of the mass."""
    import dynesty

    out = []
    for row in rows:
        box = np.array([4.0, 30.0 if observer.bounded > 1 else 6.0])[: len(observer.unknowns)]
        if observer.bounded > 1:
            middle = starts(observer, row, 1, np.random.default_rng(9))[0]
            centre = np.array([0.0, middle[1]])
        else:
            centre = np.zeros(box.size)
        sampler = dynesty.NestedSampler(
            lambda x, row=row: float(np.maximum(observer.log_density(x, row), -1e300)),
            lambda u, c=centre, b=box: c + (2 * u - 1) * b,
            len(box), nlive=live, rstate=np.random.default_rng(10),
        )  # fmt: skip
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            sampler.run_nested(print_progress=False)
        found = sampler.results
        weight = np.exp(found.logwt - found.logwt.max())
        weight /= weight.sum()
        r = observer.space.constrain(found.samples)[0][:, 0]
        out.append(np.sqrt(weight @ (r - weight @ r) ** 2))
    return np.array(out)


def other_engines(
    observer: ww.Observer, full: bool
) -> Iterator[tuple[str, float, Callable[[Array], Array]]]:
    """Method, knob, and what to run on readings."""
    for steps in (100, 300, 1000) if full else (100,):
        for move in ("stretch", "DE"):
            name = f"emcee loop, vectorised, {move}"
            yield name, steps, lambda rows, n=steps, m=move: emcee_loop(observer, rows, n, m, True)
    for steps in (100, 300) if full else (100,):
        run = lambda rows, n=steps: emcee_loop(observer, rows, n, "stretch", False)  # noqa: E731
        yield "emcee loop, plain, stretch", steps, run
    if find_spec("littlemcmc"):
        for draws in (100, 1000) if full else (50,):
            yield "NUTS (littlemcmc)", draws, lambda rows, n=draws: nuts(observer, rows, n)
    if find_spec("dynesty"):
        for live in (50, 200) if full else (25,):
            yield "nested (dynesty)", live, lambda rows, n=live: nested(observer, rows, n)


def other_posteriors(full: bool, scenes: Iterable[str]) -> pd.DataFrame:
    """Rows of emcee's loops, NUTS and nested sampling: few readings, as each takes seconds."""
    table = []
    for scene in scenes:
        observer = charts.OBSERVERS[scene]
        rows = charts.readings(observer, 256)[: 3 if full else 1]
        exact, _ = charts.exact_sds(observer, rows, full=full)
        for method, knob, run in other_engines(observer, full):
            start = time.process_time()
            sd = run(rows)
            seconds = time.process_time() - start
            good = np.ones(len(rows), dtype=bool)
            table.append(
                charts.posterior_row(scene, method, knob, sd, good, exact, seconds / len(rows))
            )
    return pd.DataFrame(table)


# -- fits ----------------------------------------------------------------------------------------


def psychofit_answer(trials: Trials) -> charts.Answer:
    """psychofit's spread of an error function of ln ratio, as a Weber fraction; no interval."""
    import psychofit

    c = trials.cells()
    x = np.log(c.stimulus_2 / c.stimulus_1)
    state = np.random.get_state()  # noqa: NPY002 — it draws from the global generator
    try:
        np.random.seed(1)  # noqa: NPY002
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found, _ = psychofit.mle_fit_psycho(
                np.stack([x, c.n, c.count / c.n]), "erf_psycho_2gammas",
                parstart=np.array([0.0, 0.2, 0.05, 0.05]), parmin=np.array([-0.3, 0.01, 0, 0]),
                parmax=np.array([0.3, 2.0, 0.4, 0.4]), nfits=5,
            )  # fmt: skip
    finally:
        np.random.set_state(state)  # noqa: NPY002
    # Its erf((x − b)/t) has sd t/√2, and ln(I2/I1) has √2 k.
    return float(found[1]) / 2, np.nan, np.nan


OTHER_TOOLS = {"psychofit": psychofit_answer, "psignifit": psignifit_answer}


# -- together ------------------------------------------------------------------------------------

Part = Callable[[], pd.DataFrame]


def parts(*, full: bool, sets: int) -> Iterator[tuple[str, str, Part]]:
    """Table, name and making of each part of the five tables, this package's rows first."""
    yield "beams", "own", partial(beams.measure, full=full)
    yield "beams", "others", partial(other_beams, full)
    for scene in charts.OBSERVERS:
        yield "posteriors", scene, partial(charts.measure_posteriors, full=full, scenes=[scene])
    for scene in charts.OBSERVERS:
        yield "posteriors", f"{scene}, others", partial(other_posteriors, full, [scene])
    tools = charts.TOOLS | {n: t for n, t in OTHER_TOOLS.items() if find_spec(n)}
    for name, tool in tools.items():
        for size in charts.sizes(full):
            fit = partial(charts.measure_tool, name, tool, size, sets)
            yield "fits", f"{name}, {size}", lambda fit=fit: pd.DataFrame([fit()])
    for scene, cue in charts.CURVES.items():
        yield "jnds", scene, partial(charts.measure_curve, scene, cue, full=full)
    for what in charts.growing(full):
        yield "growth", what, partial(charts.measure_growing, what, full=full)


def measure(folder: Path, *, full: bool, sets: int) -> dict[str, pd.DataFrame]:
    """The five tables; each part is kept in `folder` once it is made, and read where it is."""
    tables: dict[str, list[pd.DataFrame]] = {}
    for i, (table, name, part) in enumerate(parts(full=full, sets=sets)):
        path = folder / f"{i:02d}-{table}-{re.sub(r'[^a-z0-9]+', '-', name.lower())}.csv"
        if not path.exists():
            made = part()
            folder.mkdir(parents=True, exist_ok=True)
            atomic_write(path, csv_text(made))
            print(f"{table}: {name}", file=sys.stderr)
        tables.setdefault(table, []).append(pd.read_csv(path))
    return {name: pd.concat(made, ignore_index=True) for name, made in tables.items()}


def make(folder: Path, *, full: bool = True, sets: int = 200) -> dict[str, pd.DataFrame]:
    """Tables and figures into `folder`.

    Parts that are made lie in a folder of their own there, by settings and by what is installed, so
    that a run which was stopped goes on; they go when the tables are whole.
    """
    foot = machine(*PACKAGES)
    absent = missing()
    foot += f"; not installed: {', '.join(absent)}" if absent else ""
    kept = folder / "-".join(["parts", "full" if full else "short", str(sets), *absent])
    tables = measure(kept, full=full, sets=sets)
    with Run(folder, "speed_accuracy", {"full": full, "sets": sets, "machine": foot}) as run:
        draw(run, tables, foot)
    shutil.rmtree(kept)
    return tables


def draw(run: Run, tables: dict[str, pd.DataFrame], foot: str) -> None:
    """Keep the tables and the figures of them."""
    for name, table in tables.items():
        run.table(f"speed_accuracy_{name}", table)
    methods = {str(m) for table in tables.values() for m in table["method"].unique()}
    own = ("closed", "elastica", "planar", "rod", "quadrature", "Laplace", "emcee, stacked",
           "exact", "Fisher", "posteriors")  # fmt: skip
    outside = {m for m in methods if not m.startswith(own) and m not in {"emcee", *charts.JOBS}}
    for name, figure in plots.figures(tables, foot=foot, outside=outside).items():
        run.figure(f"speed_accuracy_{name}", figure)


if __name__ == "__main__":
    given = options(__file__, __doc__, short="few settings, little data", sets=200)
    made = make(given.folder, full=not given.short, sets=4 if given.short else given.sets)
    for sentence in charts.conclusions(pd.concat(made.values(), ignore_index=True)):
        print(sentence)
    for name, table in made.items():
        print(f"\n{name}\n{table.to_string(index=False, float_format='{:.3g}'.format)}")
