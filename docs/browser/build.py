"""Build the pages that run in a browser: ``python docs/browser/build.py``.

They are plain HTML with Pyodide in a worker. As built by default Pyodide comes from jsDelivr; with
``--pyodide FOLDER`` (Pyodide's release, unpacked) what is needed of it is copied in, and the result
works without a network. ``--pyodide registries`` collects the same from npm and PyPI, for machines
that reach nothing else. Look at the result by ``python -m http.server -d docs/_build/browser``: a
browser reads no WebAssembly from ``file:``.
"""

from __future__ import annotations

import argparse
import hashlib
import html
import json
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from importlib.metadata import version
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PYODIDE = "314.0.3"
CDN = f"https://cdn.jsdelivr.net/pyodide/v{PYODIDE}/full/"
RUNTIME = ("pyodide.mjs", "pyodide.asm.mjs", "pyodide.asm.wasm", "python_stdlib.zip")
LOCK = "pyodide-lock.json"
PACKAGES = ("numpy", "scipy", "pandas", "matplotlib")
#: A wheel on PyPI that holds Pyodide's own builds of these packages; each is checked against the
#: digest in npm's lock file, so it matters not who carries them.
CARRIER = "open-webui==0.12.4"
PAGES = {
    "jnd": "A whisker's JND and force map",
    "fit": "Fit a table of choices",
    "plan": "Plan an experiment",
}


def build(out: Path, pyodide: str | None = None) -> None:
    """Write the pages into a folder, which is emptied before.

    Parameters
    ----------
    out : Path
    pyodide : str, optional
        A folder with Pyodide to copy from, or "registries"; the pages load it from jsDelivr where
        it is left out.

    Raises
    ------
    ValueError
        For a folder that lacks something, or holds something else than the lock file says.
    """
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    source = CDN
    if pyodide is not None:
        source = "pyodide/"
        with tempfile.TemporaryDirectory() as collected:
            if pyodide == "registries":
                _collect(Path(collected))
            _copy(Path(collected if pyodide == "registries" else pyodide), out / "pyodide")
    for name in ("page.js", "worker.js", "style.css"):
        shutil.copy(HERE / name, out)
    shutil.copy(ROOT / "data_synthetic" / "distance_tapered.csv", out / "sample.csv")
    with zipfile.ZipFile(out / "weberwhisk.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(HERE / "pages.py", "pages.py")
        for path in sorted((ROOT / "weberwhisk").rglob("*")):
            if path.is_file() and path.suffix != ".pyc":
                archive.write(path, path.relative_to(ROOT))
        told = f"Metadata-Version: 2.1\nName: weberwhisk\nVersion: {version('weberwhisk')}\n"
        archive.writestr("weberwhisk.dist-info/METADATA", told)  # for reports
    template = (HERE / "page.html").read_text("utf-8")
    for name, title in PAGES.items():
        links = " ".join(
            f'<a href="{other}.html"{" aria-current=page" * (other == name)}>{words}</a>'
            for other, words in PAGES.items()
        )
        filled = {
            "title": html.escape(title),
            "pyodide": source,
            "policy": _policy(source),
            "links": links,
            "body": (HERE / f"{name}.html").read_text("utf-8"),
            "size": "45",
        }
        page = re.sub(r"\{(\w+)\}", lambda found: filled[found[1]], template)  # noqa: B023
        (out / f"{name}.html").write_text(page, "utf-8")


def _policy(source: str) -> str:
    """What the browser lets a page do: load itself and Pyodide, and send nothing anywhere."""
    also = f" {source}" if source.startswith("https:") else ""
    return (
        f"default-src 'none'; script-src 'self' blob: 'wasm-unsafe-eval'{also}; "
        f"connect-src 'self'{also}; worker-src 'self' blob:; style-src 'self'; "
        "img-src blob: data:; form-action 'none'; base-uri 'none'"
    )


def _needed(lock: dict[str, dict[str, dict[str, object]]]) -> dict[str, str]:
    """Wheels of the packages and of what they need, with their digests."""
    known, found, wanted = lock["packages"], {}, list(PACKAGES)
    while wanted:
        package = known[wanted.pop()]
        if package["file_name"] not in found:
            found[str(package["file_name"])] = str(package["sha256"])
            wanted += package["depends"]  # type: ignore[operator]
    return found


def _copy(folder: Path, target: Path) -> None:
    """The part of Pyodide that the pages load."""
    for name in (*RUNTIME, LOCK):
        if not (folder / name).is_file():
            raise ValueError(f"{str(folder)!r} has no {name}; give a folder with Pyodide unpacked.")
    target.mkdir()
    for name in (*RUNTIME, LOCK):
        shutil.copy(folder / name, target)
    for name, digest in _needed(json.loads((folder / LOCK).read_text("utf-8"))).items():
        path = folder / name
        if not path.is_file() or hashlib.sha256(path.read_bytes()).hexdigest() != digest:
            raise ValueError(
                f"{str(path)!r} is not the file that {LOCK} names; unpack Pyodide's full release."
            )
        shutil.copy(path, target)


def _collect(folder: Path) -> None:
    """Pyodide's runtime and lock file from npm, its wheels from the carrier on PyPI."""
    npm = ["npm", "pack", "--silent", f"pyodide@{PYODIDE}"]
    subprocess.run(npm, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    with tarfile.open(next(folder.glob("pyodide-*.tgz"))) as archive:
        for member in archive.getmembers():
            member.name = Path(member.name).name
            archive.extract(member, folder, filter="data")
    pip = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "--ignore-requires-python"]
    subprocess.run([*pip, "--only-binary=:all:", "-d", str(folder), CARRIER], check=True)
    wanted = _needed(json.loads((folder / LOCK).read_text("utf-8")))
    with zipfile.ZipFile(
        next(folder.glob(f"{CARRIER.partition('=')[0].replace('-', '_')}-*.whl"))
    ) as wheel:
        for name in wheel.namelist():
            if Path(name).name in wanted:
                (folder / Path(name).name).write_bytes(wheel.read(name))


if __name__ == "__main__":
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("--out", type=Path, default=HERE.parent / "_build" / "browser")
    asked.add_argument("--pyodide", help="a folder with Pyodide, or 'registries'")
    given = asked.parse_args()
    build(given.out, given.pyodide)
    print(f"Pages in {given.out}; look at them by: python -m http.server -d {given.out}")
