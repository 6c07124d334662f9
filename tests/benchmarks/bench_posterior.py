"""Speed and error of posteriors, against a plain emcee loop in the same run.

Run ``python tests/benchmarks/bench_posterior.py``. Times are of one core: set OMP_NUM_THREADS=1.
"""

from __future__ import annotations

import time

import emcee
import numpy as np

import weberwhisk as ww
from weberwhisk import Status
from weberwhisk.cues import Compliance, ForceMap, UnknownStiffness
from weberwhisk.receptors import Weber
from weberwhisk.sensitivity import prior_draws

W = ww.Whisker(50e-3, 100e-6, 5e-6)


def timed(observer, readings, method, **options):
    """Posteriors and their number per second of CPU."""
    ww.posterior(observer, readings[:8], method, **options)  # warm: panels are made once
    start = time.process_time()
    result = ww.posterior(observer, readings, method, **options)
    return result, len(readings) / (time.process_time() - start)


def line(name, rate, bar, error, good):
    print(f"{name:44}{rate:12.0f} /s{bar:>12}{error:>14.1e}{good:>11.1%}")


def main() -> None:
    rng = np.random.default_rng(1)
    print(
        "rates per CPU second; error: r.m.s. of sd/exact − 1; good: share with status CONVERGED\n"
    )
    print(f"{'posteriors':44}{'rate':>15}{'bar':>12}{'error of sd':>14}{'good':>11}")
    for k in (0.005, 0.03, 0.1, 0.3, 0.5):
        observer = ww.Observer(W, Compliance(), Weber(k))
        readings = observer.read(rng.uniform(0.1, 0.95, (20_000, 1)) * W.length, seed=2)
        p, rate = timed(observer, readings, "quadrature")
        error = np.max(p.sd_error / p.sd)
        good = np.mean(p.status == Status.CONVERGED)
        line(f"1-D quadrature, k = {k} (error: estimate)", rate, "100000", error, good)
    for k in (0.03, 0.1):
        observer = ww.Observer(W, Compliance(), Weber(k))
        readings = observer.read(rng.uniform(0.2, 0.9, (2048, 1)) * W.length, seed=2)
        exact = ww.posterior(observer, readings)
        p, rate = timed(observer, readings, "emcee", seed=3)
        error = np.sqrt(np.mean((p.sd / exact.sd - 1) ** 2))
        line(
            f"1-D stacked emcee at 2 %, k = {k}",
            rate,
            "400",
            error,
            np.mean(p.status == Status.CONVERGED),
        )
    start, n = time.process_time(), 4
    for y in readings[:n]:
        sampler = emcee.EnsembleSampler(
            32, 1, lambda x, y=y: observer.log_density(x, y), vectorize=True
        )
        x0 = observer.space.unconstrain(np.full((32, 1), 0.5 * W.length))
        sampler.run_mcmc(x0 + 0.1 * rng.standard_normal((32, 1)), 500)
    rate = n / (time.process_time() - start)
    print(f"{'1-D plain emcee loop, 32 walkers × 500 steps':44}{rate:12.1f} /s")

    for k in (0.03, 0.1, 0.2, 0.3):
        observer = ww.Observer(W, ForceMap(), Weber(k))
        r = rng.uniform(0.3, 0.9, 4096) * W.length
        theta = ww.flick_past(W, r).deflection_angle * rng.uniform(0.05, 0.7, 4096)
        readings = observer.read(np.stack([r, theta], axis=-1), seed=2)
        exact = ww.posterior(observer, readings, tolerance=1e-3)
        for method, count, bar, options in (
            ("quadrature", 4096, "500", {}),
            ("emcee", 1024, "100", {"seed": 3}),
            ("laplace", 4096, "", {}),
        ):
            p, rate = timed(observer, readings[:count], method, **options)
            good = (p.status == Status.CONVERGED) & (exact.status[:count] == Status.CONVERGED)
            ratio = p.sd / exact.sd[:count] - 1
            error = np.sqrt(np.mean(ratio[good] ** 2)) if good.any() else np.nan
            line(f"2-D {method}, k = {k}", rate, bar, error, good.mean())
    whole_reach()


def spent(what) -> float:
    """Seconds of CPU."""
    start = time.process_time()
    what()
    return time.process_time() - start


def whole_reach(count: int = 3000) -> None:
    """Force map over the whole reach, and with its stiffness unknown; curve and surface of JNDs.

    Bars: 100 µs (250 at k = 0.3, 300 at a tolerance of 1e-4, 400 with stiffness unknown), a summary
    3 times that; 1 s on two cores for the curve, 15 s for the surface.
    """
    print(f"\n{count} contacts drawn from the prior; µs each, errors beside tolerance=1e-4")
    force, soft = ForceMap(), UnknownStiffness(ForceMap())
    for cue, k in (
        (force, 0.03),
        (force, 0.1),
        (force, 0.3),
        (soft, 0.03),
        (soft, 0.1),
        (soft, 0.3),
    ):
        observer = ww.Observer(W, cue, Weber(k))
        readings = observer.read(prior_draws(observer, count, seed=1), seed=2)
        first = spent(lambda: ww.posterior(observer, readings))  # noqa: B023
        p, rate = timed(observer, readings, "quadrature")
        again = [ww.posterior(observer, readings) for _ in range(3)]
        asked = (
            again[0].interval,
            lambda: again[1].interval(of="deflection_angle"),  # noqa: B023
            again[2].summary,
        )
        interval, angle, summary = (rate / count * spent(one) for one in asked)
        print(
            f"{cue!r}, k = {k}: {1e6 / rate:.0f} ({first:.1f} s the first time); times that: "
            f"interval {interval:.1f}, of the angle {angle:.1f}, summary {summary:.1f}"
        )
        if len(cue.unknowns) == 2:
            fine, fine_rate = timed(observer, readings, "quadrature", tolerance=1e-4)
            off = np.maximum(np.abs(p.mean - fine.mean) / fine.sd, np.abs(p.sd / fine.sd - 1))
            print(
                f"  {1e6 / fine_rate:.0f} at 1e-4; error at most {off.max():.1e}, r.m.s. "
                f"{np.sqrt(np.mean(off**2)):.1e}"
            )
    observer = ww.Observer(W, ForceMap(), Weber(0.1))
    r = np.linspace(5e-3, 45e-3, 40)
    curve = spent(lambda: ww.jnd_curve(observer, r, np.radians(8), seed=1))
    angles = np.radians(np.linspace(1, 25, 30))
    surface = spent(
        lambda: [
            ww.jnd_curve(
                observer, np.linspace(5e-3, 45e-3, 30), angle, n_readings=count // 30, seed=1
            )
            for angle in angles
        ]
    )
    print(f"JND curve, 40 distances of 200 readings: {curve:.2f} s of CPU")
    print(f"JND surface, 30 × 30 contacts of {count // 30} readings: {surface:.1f} s of CPU")


if __name__ == "__main__":
    main()
