"""Sphinx configuration: ``sphinx-build -W -n docs docs/_build/html`` makes the site.

The pages of the reference are written here from the package itself, so that no public name can be
left out: a page a module from its ``__all__``, and one for the command line from its help.
"""

import json
import os
import re
import runpy
import shutil
import subprocess
import sys
import tarfile
import tempfile
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.util.nodes import make_refnode
from typer.testing import CliRunner

HERE = Path(__file__).parent
ROOT = HERE.parent
os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path[:0] = [str(ROOT), str(ROOT / "analyses")]
# The notebooks' kernels import this tree too, and find its command.
os.environ["PYTHONPATH"] = str(ROOT)
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])

import weberwhisk  # noqa: E402

#: MathJax and its font, by their folders in the site, with what is needed of them.
MATHJAX = {
    "mathjax": ("mathjax@4.1.3", ("tex-mml-chtml.js", "a11y", "input", "output", "sre", "ui")),
    "mathjax-newcm-font": ("@mathjax/mathjax-newcm-font@4.1.3", ("chtml.js", "chtml")),
}


def mathjax_from_npm(target: Path) -> bool:
    """Fetch MathJax, so that the site needs no network; False without npm: then from jsDelivr."""
    npm = shutil.which("npm")
    if npm is None:
        return False
    target.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target) as folder:
        for name, (package, parts) in MATHJAX.items():
            pack = [npm, "pack", "--silent", package]
            packed = subprocess.run(pack, cwd=folder, capture_output=True, text=True)
            if packed.returncode:
                return False
            with tarfile.open(Path(folder) / packed.stdout.split()[-1]) as archive:
                archive.extractall(folder, filter="data")
            for part in parts:
                (Path(folder) / name).mkdir(exist_ok=True)
                (Path(folder) / "package" / part).rename(Path(folder) / name / part)
            shutil.rmtree(Path(folder) / "package")
        for name in reversed(MATHJAX):  # that which is looked for comes last
            shutil.rmtree(target / name, ignore_errors=True)
            (Path(folder) / name).rename(target / name)
    return True


project = "weberwhisk"
author = "the weberwhisk authors"
version = release = weberwhisk.__version__
html_title = "weberwhisk"
language = "en_GB"

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "numpydoc",
    "myst_nb",
    "sphinx_design",
    "sphinx_copybutton",
]
root_doc = "index"
exclude_patterns = ["_build"]
templates_path = ["_templates"]
nitpicky = True
default_role = "obj"

mathjax4_config: dict[str, Any] = {"output": {"displayOverflow": "scroll"}}  # on a phone

# Pages that run. A cell that raises is an error of the build.
nb_execution_mode = "cache"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_merge_streams = True
nb_output_stderr = "warn"  # a warning in a cell, of a renamed name say, is one of the build
myst_enable_extensions = ["amsmath", "attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

html_theme = "pydata_sphinx_theme"
html_static_path = ["_static"]
VENDORED = HERE / "_build" / "vendored"
if (VENDORED / "mathjax").exists() or mathjax_from_npm(VENDORED):
    html_static_path.append(str(VENDORED))
    mathjax_path = "mathjax/tex-mml-chtml.js"
    mathjax4_config["loader"] = {"paths": {"fonts": "[mathjax]/.."}}
html_css_files = ["site.css"]
html_js_files = [("site.js", {"defer": "defer"})]
html_show_sourcelink = False
html_sidebars = {
    f"validation/{page}": []
    for page in ("lapse_prior", "populations", "prior_choice", "real_data", "recovery")
}
html_theme_options = {
    "navigation_with_keys": False,
    "show_prev_next": True,
    "header_links_before_dropdown": 5,
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
copyright = "the weberwhisk authors, BSD-3-Clause"
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

autosummary_generate = True
autosummary_ignore_module_all = False
autodoc_typehints = "none"  # the docstrings say types, with shapes and units
numpydoc_show_class_members = False
numpydoc_attributes_as_param_list = True
numpydoc_xref_param_type = True
numpydoc_xref_ignore: Any = "all"  # but for what has a page, below

# -- the reference ---------------------------------------------------------------------------------

#: Modules whose public names are the reference, in the order of the argument.
MODULES = {
    "weberwhisk": "What `import weberwhisk as ww` gives",
    "weberwhisk.mechanics": "Bending, flick-past and vibration",
    "weberwhisk.cues": "The paper's methods",
    "weberwhisk.receptors": "Receptor noise",
    "weberwhisk.inference": "Posteriors and observers",
    "weberwhisk.recordings": "Measured contacts: tables, trackers, sensors",
    "weberwhisk.array": "Where whiskers stand, and an object's place from all of them",
    "weberwhisk.sweeping": "Sweeps over objects, and contacts followed along them",
    "weberwhisk.behaviour": "Trials, tasks and fits",
    "weberwhisk.behaviour.effects": "What else moves choices",
    "weberwhisk.design": "Plans, power and placement",
    "weberwhisk.campaign": "Long sweeps on cores and clusters",
    "weberwhisk.plots": "Figures of results",
}


def public_module(name: str) -> Any:
    """A module by its public name, which for `weberwhisk.campaign` is not where its file stands."""
    _, _, below = name.partition(".")
    return attrgetter(below)(weberwhisk) if below else weberwhisk


def public_names() -> dict[str, list[str]]:
    """Names that each module's page documents; each object once, where it is first met."""
    seen: set[int] = set()
    pages: dict[str, list[str]] = {}
    for module_name in MODULES:
        module = public_module(module_name)
        names = getattr(module, "__all__", None) or sorted(
            name
            for name, value in vars(module).items()
            if not name.startswith("_") and getattr(value, "__module__", None) == module.__name__
        )
        pages[module_name] = []
        for name in names:
            value = getattr(module, name)
            is_alias = hasattr(value, "__origin__") or hasattr(value, "__args__")
            if isinstance(value, type(sys)) or is_alias or (callable(value) and id(value) in seen):
                continue
            seen.add(id(value))
            pages[module_name].append(name)
    return pages


def write_reference() -> dict[str, str]:
    """Write the pages; returns where each object's name is documented, by short and full name."""
    folder = HERE / "api"
    folder.mkdir(parents=True, exist_ok=True)
    places: dict[str, str] = {}
    lines = ["API", "===", "", "Every public name, from its docstring.", "", ".. toctree::", ""]
    for module_name, names in public_names().items():
        home = public_module(module_name).__name__
        title = f"{module_name}: {MODULES[module_name].lower()}".replace("`", "")
        if module_name == "weberwhisk":
            title = "weberwhisk: the names to start with"
        page = [title, "=" * len(title), "", f".. automodule:: {home}"]
        page += ["   :no-index:", ""] if module_name in places else [""]  # a function's name too
        page += [f".. currentmodule:: {home}", ""]
        page += [".. autosummary::", "   :toctree: objects", "   :nosignatures:", ""]
        page += [f"   {name}" for name in names]
        _write(folder / f"{module_name}.rst", "\n".join(page) + "\n")
        lines.append(f"   {module_name}")
        for name in names:
            value = getattr(public_module(module_name), name)
            full = f"{home}.{name}"
            places.setdefault(name, full)
            places[full] = places[f"{module_name}.{name}"] = full
            if defined := getattr(value, "__module__", None):
                places.setdefault(f"{defined}.{name}", full)
    _write(folder / "index.rst", "\n".join(lines) + "\n")
    for stub in (folder / "objects").glob("*.rst"):
        if stub.stem not in places:  # of a name that is gone
            stub.unlink()
    return places


def _write(path: Path, text: str) -> None:
    """Write where it differs, so that a second build does not make pages again."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def write_command_line() -> None:
    """The page of the command line: what ``typer utils docs`` says of it."""
    from typer.cli import app

    result = CliRunner().invoke(
        app, ["weberwhisk.cli", "utils", "docs", "--name", "weberwhisk", "--title", "Command line"]
    )
    if result.exit_code:
        raise RuntimeError(f"typer utils docs failed: {result.output}")
    _write(HERE / "cli.md", result.output)


def write_gallery() -> None:
    """A section for each chart of analyses/gallery, in its quick form."""
    from gallery.make import CHARTS

    page = [GALLERY]
    for name, make in CHARTS.items():
        says = (make.__doc__ or "").strip()
        says = says[:1].upper() + says[1:]
        page.append(f"## {name}\n\n{says}.\n")
        page.append(f"```{{code-cell}} ipython3\n:tags: [remove-output]\n"
                    f"!python analyses/gallery/make.py --only {name} --short {name}\n"
                    "```\n")  # fmt: skip
        page.append("```{code-cell} ipython3\n---\ntags: [remove-input]\n"
                    f"mystnb:\n  image:\n    alt: {json.dumps(says, ensure_ascii=False)}\n---\n"
                    f'Image("{name}/{name}.png", width=700)\n```\n')  # fmt: skip
    _write(HERE / "gallery.md", "\n".join(page))


def write_project() -> None:
    """A page for each of the project's own files that there are."""
    names = ("CHANGELOG", "CONTRIBUTING", "CODE_OF_CONDUCT")
    for name in names:
        page, source = HERE / "project" / f"{name.lower()}.md", ROOT / f"{name}.md"
        if not source.exists():
            page.unlink(missing_ok=True)
            continue
        text = source.read_text(encoding="utf-8")
        for other in names:  # they link to one another
            text = text.replace(f"]({other}.md)", f"]({other.lower()}.md)")
        _write(page, text)


GALLERY = """---
file_format: mystnb
kernelspec: {name: python3, display_name: Python 3}
---

# Gallery

What every method tells, with the command that draws it in a clone. Each folder also has the table
of what is drawn and a record of what was done. Here is the quick form, `--short`, of few posteriors
and a coarse grid. Figures of your own results: {doc}`gallery_results`. The paper's, in its order:
{doc}`validation/paper`.

```{code-cell} ipython3
:tags: [remove-cell]
import os, tempfile
from IPython.display import Image
os.chdir(tempfile.mkdtemp())
os.symlink(f"{os.environ['PYTHONPATH']}/analyses", "analyses")
```
"""
PLACES = write_reference()
write_command_line()
write_gallery()
write_project()
numpydoc_xref_aliases = {name: full for name, full in PLACES.items() if "." not in name}


def resolve(app: Any, env: Any, node: Any, contnode: Any) -> Any:
    """Links to names by where they are defined or imported; other code in backticks is code."""
    target = node["reftarget"].removeprefix("ww.").lstrip(".~")
    if target.startswith(("python:", "numpy")):  # no page of others' is linked: built off line
        return contnode
    if node.get("refdomain") != "py":
        return None
    head, _, member = target.rpartition(".")
    for name, tail in ((target, ""), (head, f".{member}")):
        for candidate in (name, f"weberwhisk.{name}", f"{node.get('py:module')}.{name}"):
            full = PLACES.get(candidate)
            if full is None:
                continue
            found = env.domains["py"].objects.get(full + tail)
            if found is not None:
                return make_refnode(
                    app.builder, node["refdoc"], found.docname, found.node_id, contnode, full
                )
    if node.get("reftype") == "obj" and (not target.startswith("weberwhisk.") or exists(target)):
        return nodes.literal(contnode.astext(), contnode.astext())
    return None


def exists(name: str) -> bool:
    """Whether there is such a module or name, if without a page: else the docstring is stale."""
    for module_name, _, attribute in ((name, "", ""), name.rpartition(".")):
        try:
            module = import_module(module_name)
        except ImportError:
            continue
        return not attribute or hasattr(module, attribute)
    return False


def escape_bars(_app: Any, _what: str, _name: str, _value: Any, _options: Any, lines: Any) -> None:
    """Absolute values, |x|, are no substitutions."""
    for i, line in enumerate(lines):
        if not line.lstrip().startswith((">>>", "...")):
            parts = re.split(r"(`+[^`]*`+)", line)
            lines[i] = "".join(p if p.startswith("`") else p.replace("|", r"\|") for p in parts)


def add_browser_pages(app: Any, error: Any) -> None:
    """The pages that run in a browser, beside the site's own; Pyodide comes from jsDelivr."""
    if error is None and app.builder.name == "html":
        runpy.run_path(str(HERE / "browser" / "build.py"))["build"](Path(app.outdir) / "browser")


def setup(app: Any) -> None:
    """Connect what is above."""
    app.connect("build-finished", add_browser_pages)
    app.connect("autodoc-process-docstring", escape_bars)
    app.connect("missing-reference", resolve)
