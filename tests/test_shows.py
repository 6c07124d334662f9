"""Results show themselves: in a notebook, in a line, to `help`, `dir` and a type checker."""

from __future__ import annotations

import inspect
import io
import operator
import pydoc
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import matplotlib
import nbformat
import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from nbclient import NotebookClient

import weberwhisk as ww
from weberwhisk._util.values import Shown, with_units
from weberwhisk.design import Evidence, Plan, Scheme, taper
from weberwhisk.inference.coordinates import UNITS

matplotlib.use("agg")
ROOT = Path(__file__).parent.parent
W = ww.Whisker(50e-3, 100e-6, 5e-6, curvature=0.0)  # so that nothing is said of it
TAP = ww.Observer(W, ww.cues.Compliance())

CELLS = {
    "fit.plot()": "fit = ww.fit_weber(ww.simulate_trials(weber_fraction=0.1, seed=1))",
    "posterior.plot();": "posterior = ww.posterior(tap, tap.read(30e-3, seed=1))",
    "population.plot()\nNone": "population = ww.fit_population("
    "ww.simulate_population(3, trials_per_level=10, seed=1)[0], bias='none')",
    "ww.plots.psychometrics(fit)": "",
    "fit": "",
}


def test_figures_appear_in_a_notebook(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MPLBACKEND", raising=False)  # a notebook has its own
    setup = "import weberwhisk as ww\ntap = ww.Observer(ww.Whisker.from_identity('C2'), "
    setup += "ww.cues.Compliance())"
    made = [setup, *(code for code in CELLS.values() if code)]
    notebook = nbformat.v4.new_notebook(
        cells=[nbformat.v4.new_code_cell(code) for code in (*made, *CELLS)]
    )
    NotebookClient(notebook, timeout=120, kernel_name="python3").execute()
    shown = [cell.outputs for cell in notebook.cells[len(made) :]]
    for code, outputs in zip(CELLS, shown, strict=True):
        kinds = [kind for output in outputs for kind in output.get("data", {})]
        if code == "fit":
            html = outputs[0]["data"]["text/html"]
            assert "k = 0." in html
            assert "<table" in html
        else:  # once, also where pyplot and the notebook could both show it
            assert kinds.count("image/png") == 1, code


def results() -> dict[str, Any]:
    trials = ww.simulate_trials(weber_fraction=0.1, seed=1)
    fit = ww.fit_weber(trials)
    never = ww.fit_weber(trials, priors={"lapse_low": 0.0, "lapse_high": 0.0})
    cones = ww.Observer(W, ww.cues.ForceMap())
    pair = taper(W)
    scheme = Scheme.spaced(pair[0].encoding, [15e-3, 40e-3], trials=5)
    return {
        "one reading": ww.posterior(TAP, TAP.read(30e-3, seed=1)),
        "many readings": ww.posterior(TAP, TAP.read([[20e-3], [30e-3]], seed=1)),
        "fit": fit,
        "population": ww.fit_population(
            ww.simulate_population(3, trials_per_level=10, seed=1)[0], bias="none"
        ),
        "plan": ww.plan_experiment("C2", standards=[10e-3, 30e-3], trials=10, runs=16),
        "comparison": ww.compare({"lapses": fit, "none": never}),
        "curve": ww.jnd_curve(TAP, [10e-3, 30e-3], n_readings=8, seed=1),
        "curves": ww.jnd_curve(
            cones, [[10e-3], [30e-3]], [0.1, 0.2], n_readings=8, seed=1
        ),
        "contact": ww.press(W, 30e-3, 0.2),
        "contacts": ww.press(W, [[20e-3], [30e-3]], np.linspace(0.01, 0.4, 20)),
        "lost": ww.press(W, 60e-3, 0.2),
        "power": ww.power(scheme, pair, trials=[5, 10], truths=["tapered"], runs=8, seed=1),
        "study": ww.simulate_study(Plan(scheme, pair, Evidence(bayes_factor=10)), 2, seed=1),
    }  # fmt: skip


@pytest.fixture(scope="module")
def made() -> dict[str, Any]:
    return results()


def test_every_result_is_drawn_says_what_it_found_and_has_html(made: dict[str, Any]) -> None:
    from matplotlib import pyplot

    for name, result in made.items():
        assert isinstance(result, Shown), name
        figure = result.plot()
        assert isinstance(figure, Figure)
        assert figure.number in pyplot.get_fignums()  # plt.show() shows it
        figure.savefig(io.BytesIO(), format="png")
        pyplot.close(figure)
        assert "\n" not in repr(result), name
        assert len(repr(result)) <= 200, name
        assert result._repr_html_().startswith(f"<p><b>{type(result).__name__}</b>: ")
    axes = pyplot.figure().subplots()
    assert made["fit"].plot(axes) is axes.figure
    assert axes.lines
    pyplot.close()


def test_a_curve_has_units_in_its_names_and_the_contact_in_its_index(made: dict[str, Any]) -> None:
    curve, curves = made["curve"], made["curves"]
    assert curve.table.index.tolist() == [10.0, 30.0]
    assert curves.table.index.names == ["radial_distance_mm", "deflection_angle_deg"]
    np.testing.assert_allclose(curve.table["posterior_mm"], 1e3 * curve["posterior"])
    plain = {"criterion", "unreliable", "linear", "outcome"}
    assert {name for name in curve.table if not name.endswith("_mm")} == plain
    assert list(curves.lines()) == ["5.73°", "11.46°"]
    all_named = with_units(pd.DataFrame({name: [1.0] for name in UNITS}), units=UNITS)
    assert not set(all_named) & set(UNITS)
    assert {"angular_velocity_deg_per_s", "hinge_stiffness_Nm_per_rad"} <= set(all_named)


def test_help_documents_the_function_also_after_its_package_was_imported() -> None:
    code = (
        "import weberwhisk.inference, weberwhisk as ww;"
        "from weberwhisk.inference import Posterior;"
        "from weberwhisk import posterior;"
        "assert posterior is ww.posterior is ww.inference.posterior;"
        "print(sorted(n for n in dir(ww) if not hasattr(ww, n)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert (done.stdout, done.stderr) == ("[]\n", "")
    text = pydoc.plain(pydoc.render_doc(ww.posterior))
    assert text.startswith("Python Library Documentation: function posterior in module")
    assert "A reading or many" in text or "One reading or many" in text


def test_dir_has_all_public_names_and_no_others() -> None:
    names = set(dir(ww))
    assert {"behaviour", "plots", "sweeping", "Whisker", "posterior", "cues"} <= names
    assert [n for n in names if n.startswith("_")] == ["__version__"]
    assert names == {*ww.__all__, "__version__"}
    assert len(ww.__all__) <= 45


#: The modules whose public names the reference lists.
PUBLIC = re.findall(r'^    "weberwhisk\.(.+?)":', (ROOT / "docs/conf.py").read_text("utf-8"), re.M)


def test_public_modules_are_there_without_an_import_of_their_own() -> None:
    code = f"import operator, weberwhisk as ww; operator.attrgetter(*{PUBLIC})(ww)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert (done.returncode, done.stderr) == (0, "")
    assert {name.partition(".")[0] for name in PUBLIC} <= set(ww.__all__)


SCRIPT = """\
import numpy as np
import weberwhisk as ww
w = ww.Whisker.from_identity("C2")
b = ww.press(w, radial_distance=20e-3, deflection_angle=np.radians(15))
observer = ww.Observer(w, ww.cues.ForceMap(), ww.receptors.Weber(0.1))
p = ww.posterior(observer, observer.read([20e-3, 0.26], seed=1))
curve = ww.jnd_curve(observer, [5e-3, 25e-3], 0.1, seed=1)
fit = ww.fit_weber(ww.simulate_trials(weber_fraction=0.15, seed=1))
population = ww.fit_population(ww.simulate_population(3, seed=1)[0])
both = ww.compare({"one": fit, "two": fit})
plan = ww.plan_experiment("C2", runs=16)
print(b.moment, b.outcome.message, p.mean, p.interval(0.95)[0], p.status.message, fit.report())
"""
REVEALED = """b.moment b.held b.outcome.message p.mean p.sd p.interval() p.quantile(0.5)
p.status.message p.log_evidence p.outcome p.plot() p.summary() curve curve.table curve["posterior"]
fit.weber_fraction fit.interval() fit.summary() fit.plot() fit.status population.weber_fraction
population.subjects both.table both.report() plan.trials plan.plot()
ww.posterior(observer,[1e-7,1e-5]) w.stiffness
ww.flick_past(w,0.02).ended_by fit.to_dict() fit.to_arviz()["posterior"] population.fits
fit.trials.subjects plan.levels
w.length ww.receptors.Weber([0.1,0.2]).weber_fraction"""


def test_no_public_result_is_of_any_type() -> None:
    """What public functions return, and what fields and methods of public classes say they hold."""
    modules = [ww, *(operator.attrgetter(name)(ww) for name in PUBLIC)]
    homes = [vars(module) for name, module in sys.modules.items() if name.startswith("weberwhisk")]
    classes = {k: v for home in homes for k, v in home.items() if isinstance(v, type)}
    returned: dict[str, str] = {}
    for module in modules:
        for name in getattr(module, "__all__", [n for n in dir(module) if n[0] != "_"]):
            function = inspect.unwrap(getattr(module, name))
            listed = hasattr(module, "__all__")
            if inspect.isfunction(function) and (listed or function.__module__ == module.__name__):
                returned[f"{module.__name__}.{name}"] = function.__annotations__["return"]
    results = {word for text in returned.values() for word in re.findall(r"\w+", text)}
    results |= {name for module in modules for name in getattr(module, "__all__", ())}
    for result in {classes[word] for word in results & classes.keys()}:
        for base in (b for b in result.__mro__ if b.__module__.startswith("weberwhisk")):
            held = dict(inspect.get_annotations(base))
            for name, value in vars(base).items():
                function = getattr(value, "fget", None) or getattr(value, "func", value)
                function = inspect.unwrap(getattr(function, "__func__", function))
                if inspect.isfunction(function) and "renamed_" not in function.__qualname__:
                    held[name] = str(function.__annotations__.get("return", "Any"))
            public = {name: text for name, text in held.items() if not name.startswith("_")}
            returned |= {f"{base.__name__}.{name}": str(text) for name, text in public.items()}
    assert len(returned) > 300
    assert {"WeberFit.to_dict", "Bending.moment", "FlickPast.ended_by"} <= returned.keys()
    vague = {name for name, text in returned.items() if re.search(r"\bAny\b", text)}
    # Priors are what users give: whatever has the methods of a frozen SciPy distribution.
    assert {name for name in vague if "prior" not in name.lower()} == set()


#: What `strict` means to a module.
STRICT = (
    "disallow_any_generics", "disallow_subclassing_any", "disallow_untyped_calls",
    "disallow_untyped_defs", "disallow_untyped_decorators", "check_untyped_defs",
    "warn_unused_ignores", "warn_return_any", "strict_equality", "extra_checks",
)  # fmt: skip


@pytest.mark.slow  # a second after `mypy`, whose cache it shares, as in .ci/run; else twenty
def test_a_strict_type_checker_resolves_every_type(tmp_path: Path) -> None:
    script = tmp_path / "script_of_a_user.py"
    shown = [f"reveal_type({expression})" for expression in REVEALED.replace("\n", " ").split(" ")]
    script.write_text(SCRIPT + "\n".join(shown), encoding="utf-8")
    flags = "".join(f"{flag} = true\n" for flag in STRICT)
    own = f'\n[[tool.mypy.overrides]]\nmodule = "{script.stem}"\n{flags}'
    config = tmp_path / "pyproject.toml"
    config.write_text((ROOT / "pyproject.toml").read_text("utf-8") + own, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file", str(config), str(script)],
        capture_output=True, text=True, cwd=ROOT,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    revealed = [line for line in done.stdout.splitlines() if "Revealed type" in line]
    assert len(revealed) == len(shown)
    # `ndarray[tuple[Any, ...], ...]` is an array of any shape, and known.
    vague = [line for line in revealed if "Any" in line.replace("tuple[Any, ...]", "shape")]
    assert vague == []
