"""Are populations right, and how quick are they?

Four parts, each a table of `populations.md`:

- `coverage`: how often the interval of a population's median Weber fraction holds it, and how far
  medians are off, where lapses are rare, usual and frequent (40 people with 200 trials each, ten
  comparisons, ln k normal with a spread of 0.35). The same with each person's lapses believed to be
  about 3 %, whatever the others do, is what was done before.
- `law`: whether populations in which noise grows as the stimulus to the power 1.5 are told from
  those of Weber's law, and the exponent's interval (64 people, 216 trials each, three standards an
  octave apart).
- `speed`: CPU seconds and memory, of the 64 people of Barretto-Garcia et al. (2023) as they come
  with the package, and of simulated ones.
- `bauer`: the same people's population beside that of bauer (github.com/ruffgroup/bauer), by NUTS.

``python analyses/populations.py`` makes all of it; `--short` makes few of each and keeps nothing.
`populations.csv` and `populations_law.csv` have a row a population, and are resumed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import ndtr

sys.path.insert(0, str(Path(__file__).parent))
from command import markdown_table, resumed

import weberwhisk as ww
from weberwhisk.behaviour.effects import Contraction, Exponent, NoiseByOrder

HERE = Path(__file__).parent
LAPSES = (0.005, 0.02, 0.05)
TRUTH, SPREAD, PEOPLE, EACH = 0.15, 0.35, 40, 20
COMPARISONS = np.array([0.6, 0.7, 0.8, 0.88, 0.94, 1.06, 1.14, 1.25, 1.4, 1.6])
#: bauer, 2026-05, NumPyro, two chains of 500 draws after 500, on the 64 people: means and sds of
#: the group, and CPU seconds.
BAUER = {
    "plain": ("noise of ln n 0.218 ± 0.007", 67),
    "lapses": ("noise of ln n 0.168 ± 0.007, lapses 3.1 %", 118),
    "prior and noise by order": ("first 0.288 ± 0.018, second 0.103 ± 0.021", 330),
}


def people(count: int, lapse: float, seed: int) -> tuple[ww.Trials, np.ndarray]:
    """Choices of people with that lapse rate at either end, and their Weber fractions."""
    rng = np.random.default_rng([seed, round(1e4 * lapse)])
    k = TRUTH * np.exp(SPREAD * rng.normal(size=count))
    d = (COMPARISONS - 1) / np.hypot(COMPARISONS, 1)
    p = lapse + (1 - 2 * lapse) * ndtr(d / k[:, None])
    frame = pd.DataFrame({
        "subject": np.repeat(np.arange(count), COMPARISONS.size), "standard": 1.0,
        "comparison": np.tile(COMPARISONS, count), "n": EACH,
        "n_greater": rng.binomial(EACH, p).ravel(),
    })  # fmt: skip
    return ww.read_trials(frame), k


def covered(lapse: float, seed: int) -> dict[str, Any]:
    """One population: its interval, and what animals alone would have for a median."""
    trials, k = people(PEOPLE, lapse, seed)
    start = time.process_time()
    fit = ww.fit_population(trials, check=False)
    seconds = time.process_time() - start
    low, high = fit.interval()
    alone = float(np.exp(np.log(fit.subjects["alone"]).mean()))
    return {
        "lapse": lapse, "seed": seed, "median": fit.weber_fraction, "lower": low, "upper": high,
        "of_these": float(np.exp(np.log(k).mean())), "alone": alone, "status": fit.status.name,
        "lapse_low": float(fit.quantile("lapse_low", 0.5)),
        "error": 0.0 if fit.population is None else fit.population.error, "seconds": seconds,
    }  # fmt: skip


def coverage(rows: pd.DataFrame) -> pd.DataFrame:
    """A row a lapse rate."""
    out = []
    for lapse, group in rows.groupby("lapse"):
        held = (group["lower"] < TRUTH) & (group["upper"] > TRUTH)
        of_these = (group["lower"] < group["of_these"]) & (group["upper"] > group["of_these"])
        off = np.log(group["median"] / group["of_these"])
        alone = np.log(group["alone"] / group["of_these"])
        out.append({
            "lapses": f"{100 * float(lapse):g} %", "populations": len(group),  # type: ignore[arg-type]
            "hold 0.15": int(held.sum()), "hold the median of these people": int(of_these.sum()),
            "median off by": f"{100 * np.expm1(off.mean()):+.1f} %",
            "geometric mean of fits alone off by": f"{100 * np.expm1(alone.mean()):+.1f} %",
            "DETERMINED": int((group["status"] == "DETERMINED").sum()),
            "largest error (sd)": f"{group['error'].max():.2f}",
            "CPU s": f"{group['seconds'].median():.1f}",
        })  # fmt: skip
    return pd.DataFrame(out)


def against_law(seed: int) -> dict[str, Any]:
    """One population of exponent 1.5: the evidence for an exponent, and its interval."""
    rng = np.random.default_rng(seed)
    k = TRUTH * np.exp(SPREAD * rng.normal(size=64))
    pairs = np.array([(s, s * c) for s in (1.0, 2.0, 4.0) for c in (0.6, 0.8, 0.9, 1.1, 1.2, 1.4)])
    sd = pairs**1.5 / np.sqrt(np.exp(np.log(pairs).mean()))
    d = (pairs[:, 1] - pairs[:, 0]) / np.hypot(*sd.T)
    p = 0.02 + 0.96 * ndtr(d / k[:, None] + 0.2 * rng.normal(size=(64, 1)))
    trials = ww.read_trials(pd.DataFrame({
        "subject": np.repeat(np.arange(64), len(pairs)), "standard": np.tile(pairs[:, 0], 64),
        "comparison": np.tile(pairs[:, 1], 64), "n": 12, "n_greater": rng.binomial(12, p).ravel(),
    }))  # fmt: skip
    plain = ww.fit_population(trials, check=False)
    with_it = ww.fit_population(trials, check=False, effects=[Exponent()])
    low, middle, high = with_it.quantile("exponent", [0.025, 0.5, 0.975])
    return {
        "seed": seed, "log_bayes_factor": with_it.log_evidence - plain.log_evidence,
        "lower": low, "exponent": middle, "upper": high, "status": with_it.status.name,
    }  # fmt: skip


def law(rows: pd.DataFrame) -> pd.DataFrame:
    """In one row; evidence is decisive from ln 100."""
    factor = rows["log_bayes_factor"]
    held = (rows["lower"] < 1.5) & (rows["upper"] > 1.5)
    return pd.DataFrame([{
        "populations": len(rows), "decisive evidence for an exponent": int((factor > 4.6).sum()),
        "least log Bayes factor": f"{factor.min():.0f}", "hold 1.5": int(held.sum()),
        "exponents": f"{rows['exponent'].min():.2f} to {rows['exponent'].max():.2f}",
        "DETERMINED with it": int((rows["status"] == "DETERMINED").sum()),
    }])  # fmt: skip


def numerosity() -> ww.Trials:
    """The 64 people."""
    return ww.read_trials(Path(ww.__file__).parent / "data" / "numrisk_2afc.csv.gz")


#: What is timed, by name.
TIMED: dict[str, Any] = {
    "64 people, plain with lapses": lambda: (numerosity(), {"check": False}),
    "64 people, contraction and noise by order": lambda: (
        numerosity(), {"check": False, "effects": [Contraction(), NoiseByOrder()]}),
    "109 people × 320 trials, with checks": lambda: (_many(109, 32), {}),
    "1000 people × 300 trials": lambda: (_many(1000, 30), {"check": False}),
}  # fmt: skip


def _many(count: int, per_level: int) -> ww.Trials:
    trials, _ = ww.simulate_population(
        count, weber_fraction=TRUTH, trials_per_level=per_level, order="random", seed=1,
        offsets=(COMPARISONS - 1).tolist(),
    )  # fmt: skip
    return trials


def timed(name: str) -> dict[str, Any]:
    """CPU seconds, highest memory and the population of one of `TIMED`."""
    import resource

    trials, options = TIMED[name]()
    start = time.process_time()
    fit = ww.fit_population(trials, progress=lambda done: None, **options)
    seconds = time.process_time() - start
    scale = 2**20 if sys.platform == "darwin" else 2**10
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / scale
    summary = fit.summary()
    said = {n: f"{r['median']:.3g} ± {r['sd']:.2g}" for n, r in summary.iterrows()}
    return {"what": name, "CPU s": round(seconds, 1), "MB": round(memory),
            "status": fit.status.name, "said": said}  # fmt: skip


def table(rows: pd.DataFrame) -> str:
    """As Markdown."""
    return markdown_table(rows.columns, rows.astype(str).to_numpy())


def page(rows: pd.DataFrame, of_law: pd.DataFrame, times: list[dict[str, Any]]) -> str:
    """`populations.md`."""
    speed = pd.DataFrame([{k: v for k, v in one.items() if k != "said"} for one in times])
    ours = {one["what"]: one["said"] for one in times}
    bauer = pd.DataFrame([
        {"model": name, "bauer": said, "its CPU s": seconds,
         "weberwhisk": "; ".join(f"{k} {v}" for k, v in ours.get(of, {}).items())}
        for (name, (said, seconds)), of in zip(
            BAUER.items(), ("", *list(TIMED)[:2]), strict=True)
    ])  # fmt: skip
    return f"""# Populations

{__doc__}
## Coverage

{table(coverage(rows))}

## Weber's law

{table(law(of_law))}

## Speed

{table(speed)}

## Beside bauer

{table(bauer)}

bauer's noise is that of the logarithm of a number, the same at all, and the difference of two such
has √2 times it; k here is that of a signal with sd k times its mean, so that near equality they are
the same number, and apart for comparisons of several times the standard. Its prior draws both
signals, contraction here the first alone; its lapses are answered at chance (half right) with one
rate, here there is one at either end. Its spreads have priors of their own.
"""


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--populations", type=int, default=20)
    parser.add_argument("--only", choices=("coverage", "law", "speed"))
    parser.add_argument("--time", choices=TIMED, help="print one line of JSON of this alone")
    parser.add_argument("--out", type=Path, default=HERE)
    options = parser.parse_args(arguments)
    if options.time:
        print(json.dumps(timed(options.time)))
        return
    seeds = range(1 if options.short else options.populations)
    designs = {"coverage": [{"lapse": lapse, "seed": seed} for seed in seeds for lapse in LAPSES],
               "law": [{"seed": seed} for seed in seeds]}  # fmt: skip
    parts = {"coverage": ("populations.csv", covered, coverage),
             "law": ("populations_law.csv", against_law, law)}  # fmt: skip
    made = {}
    with TemporaryDirectory() as nowhere:
        folder = Path(nowhere) if options.short else options.out
        for name, (file, one, summarised) in parts.items():
            wanted = designs[name] if options.only in (None, name) else []
            made[name] = resumed(folder / file, one, wanted)
            if len(made[name]):
                print(summarised(made[name]).to_string(index=False))
    if options.only in designs:
        return
    times = []
    for name in list(TIMED)[:1] if options.short else TIMED:
        command = [sys.executable, str(Path(__file__).resolve()), "--time", name]
        said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        times.append(json.loads(said.splitlines()[-1]))
        print(times[-1])
    text = page(made["coverage"], made["law"], times)
    if options.short:
        print(text)
    else:
        (options.out / "populations.md").write_text(text)


if __name__ == "__main__":
    main()
