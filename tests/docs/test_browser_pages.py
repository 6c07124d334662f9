"""The pages of docs/browser in a headless Chromium, with Pyodide beside them and no network.

Needs playwright (extra `browser`), a Chromium, npm and PyPI; skipped where playwright is not
installed. ``WEBERWHISK_PYODIDE`` may name a folder with Pyodide unpacked, and ``WEBERWHISK_SITE``
the documentation as built, whose pages are then looked at too.
"""

from __future__ import annotations

import functools
import html
import http.server
import os
import re
import shutil
import subprocess
import sys
import tarfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pytest

import weberwhisk as ww
from weberwhisk._util.values import interval_text

sync_api = pytest.importorskip("playwright.sync_api")

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "data_synthetic" / "distance_tapered.csv"
SLOW = 300_000  # ms; Python and its packages are some 45 MB of WebAssembly to compile


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *said: Any) -> None:
        pass


@contextmanager
def _served(folder: Path) -> Iterator[str]:
    """The address of a folder's pages, on a port of this machine."""
    serve = functools.partial(_Quiet, directory=folder)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), serve) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The pages, built with Pyodide in their folder."""
    out = tmp_path_factory.mktemp("browser") / "pages"
    source = os.environ.get("WEBERWHISK_PYODIDE", "registries")
    build = [sys.executable, ROOT / "docs" / "browser" / "build.py"]
    subprocess.run([*build, "--out", out, "--pyodide", source], check=True)
    (out / "bare.html").write_text("a page without our policy")
    with _served(out) as address:
        yield address


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """A Chromium of the system's, or playwright's own."""
    path = next(filter(None, map(shutil.which, ("chromium", "google-chrome", "chrome"))), None)
    arguments = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    with sync_api.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=path, args=arguments)
        yield browser
        browser.close()


@pytest.fixture
def page(chromium: Any, site: str) -> Iterator[Any]:
    """A fresh page that fails where it reports an error, or asks anybody else for anything."""
    page = chromium.new_page()
    wrong: list[str] = []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda said: wrong.append(said.text) if said.type == "error" else None)
    page.on(
        "request", lambda asked: asked.url.startswith((site, "blob:")) or wrong.append(asked.url)
    )
    page.set_default_timeout(SLOW)
    yield page
    page.close()
    assert wrong == []


def _estimates(page: Any) -> dict[str, str]:
    """The first row of the table of estimates, once there is one."""
    table = "table:has(caption:text-is('Estimates'))"
    page.wait_for_selector(table)
    names = page.locator(f"{table} th").all_inner_texts()
    cells = page.locator(f"{table} tbody tr").first.locator("td").all_inner_texts()
    return dict(zip(names, cells, strict=True))


def test_a_dropped_table_is_fitted_and_k_shown(page: Any, site: str) -> None:
    page.goto(f"{site}fit.html")
    page.set_input_files("input[type=file]", SAMPLE)
    page.wait_for_selector("#menus select")
    page.click("button:text-is('Fit')")
    row = _estimates(page)
    fit = ww.fit_weber(ww.read_trials(SAMPLE))
    assert row["parameter"] == "weber_fraction"
    # WebAssembly's arithmetic is not this machine's to the last bit.
    low, high = fit.interval()
    for name, value in {"median": fit.weber_fraction, "lower": low, "upper": high}.items():
        assert float(row[name]) == pytest.approx(value, rel=1e-3)
    report, methods = page.locator("#results .words").all_inner_texts()
    assert f"Weber fraction: {interval_text(fit.weber_fraction, low, high)}" in report
    assert f"{fit.trials.n_trials} trials" in methods
    assert page.locator("#results img").evaluate("image => image.naturalWidth") > 100
    # The wrong column is refused in a sentence, and the page goes on.
    page.select_option("select[name=answer]", "trial")
    page.click("button:text-is('Fit')")
    page.wait_for_selector("#status.wrong")
    assert "is not an answer" in page.inner_text("#status")


SENDING = """address => Promise.allSettled([
  fetch(address, { method: "POST", mode: "no-cors", body: "data" }),
  new Promise((done) => {
    const post = `fetch("${address}", { method: "POST", mode: "no-cors", body: "data" })`;
    const source = `${post}.finally(() => postMessage("tried"))`;
    new Worker(URL.createObjectURL(new Blob([source]))).onmessage = done;
  }),
  new Promise((done) => Object.assign(new Image(), { onload: done, onerror: done, src: address })),
]).then(() => "tried")"""


def test_nothing_can_be_sent(chromium: Any, site: str) -> None:
    """Not by the page, and not by a worker of it, where Python and the data are."""
    arrived: list[str] = []

    class Elsewhere(_Quiet):
        def do_GET(self) -> None:
            arrived.append(self.command)
            self.send_response(204)
            self.end_headers()

        do_POST = do_GET

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Elsewhere) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        for name, hears in (("fit.html", 0), ("bare.html", 3)):
            page = chromium.new_page()
            page.goto(site + name)
            assert page.evaluate(SENDING, f"http://127.0.0.1:{server.server_port}/") == "tried"
            assert len(arrived) == hears  # a page without the policy can send
            page.close()
        server.shutdown()


def test_a_slider_moves_the_jnd(page: Any, site: str) -> None:
    page.goto(f"{site}jnd.html")
    page.wait_for_selector("#results figure")
    before = page.inner_text("#results .words")
    page.locator("input[name=weber_fraction]").fill("0.2")
    page.wait_for_selector(f"#results .words:not(:text-is({before!r}))")
    assert page.locator("#results img").count() == 2


def test_a_plan_has_the_library_s_levels_and_lists(page: Any, site: str) -> None:
    page.goto(f"{site}plan.html")
    page.click("button:text-is('Plan')")
    with page.expect_download() as kept:
        page.click("a:text-is('Keep plan.zip')")
    assert kept.value.suggested_filename == "plan.zip"
    plan = ww.plan_experiment("C2", trials=20, runs=0)
    assert page.locator("table:has(caption:text-is('Levels')) tbody tr").count() == len(plan.levels)
    # The same lists, byte for byte, from another processor.
    assert plan.fingerprint[:16] in page.locator("details").text_content()


@pytest.fixture(scope="module")
def axe(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The script that finds what keeps people from reading a page, from npm."""
    folder = tmp_path_factory.mktemp("axe")
    npm = ["npm", "pack", "--silent", "axe-core@4"]
    subprocess.run(npm, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    with tarfile.open(next(folder.glob("*.tgz"))) as archive:
        found = archive.extractfile("package/axe.min.js")
        assert found is not None
        return found.read().decode()


def _faults(page: Any, axe: str) -> list[tuple[str, str]]:
    page.evaluate(axe)
    found = page.evaluate("axe.run()")["violations"]
    serious = [one for one in found if one["impact"] in ("serious", "critical")]
    return [(one["id"], one["nodes"][0]["html"]) for one in serious]


def test_pages_that_run_can_be_read_by_all(chromium: Any, site: str, axe: str) -> None:
    for scheme in ("light", "dark"):
        context = chromium.new_context(color_scheme=scheme, bypass_csp=True)
        for name in ("jnd", "fit", "plan"):
            page = context.new_page()
            page.goto(f"{site}{name}.html")
            assert _faults(page, axe) == [], (scheme, name)
        context.close()


@pytest.fixture(scope="module")
def documentation() -> Path:
    if "WEBERWHISK_SITE" not in os.environ:
        pytest.skip("WEBERWHISK_SITE names no site")
    return Path(os.environ["WEBERWHISK_SITE"]).resolve()


MAIN = ["index", "gallery", "cli", "start/index", "start/fit", "tutorials/figure_4", "theory/jnd",
        "validation/paper", "api/weberwhisk"]  # fmt: skip


def test_main_pages_can_be_read_by_all_and_fit_a_phone(
    chromium: Any, documentation: Path, axe: str
) -> None:
    with _served(documentation) as address:
        for scheme in ("light", "dark"):
            context = chromium.new_context(color_scheme=scheme)
            for name in MAIN:
                page = context.new_page()
                page.route(lambda url: not url.startswith(address), lambda route: route.abort())
                page.goto(f"{address}{name}.html")
                assert _faults(page, axe) == [], (scheme, name)
                page.set_viewport_size({"width": 390, "height": 844})
                wide = page.evaluate("document.documentElement.scrollWidth")
                assert wide <= 390, (scheme, name)
                page.close()
            context.close()


#: How many pixels of each table of a page lie behind the edge of what shows it.
HIDDEN = """() => [...document.querySelectorAll("main table")].map((table) => {
  let edge = document.documentElement.clientWidth;
  for (let box = table.parentElement; box; box = box.parentElement)
    if (getComputedStyle(box).overflowX !== "visible")
      edge = Math.min(edge, box.getBoundingClientRect().left + box.clientWidth);
  return table.getBoundingClientRect().right - edge;
})"""


def test_tables_and_maths_are_seen_whole_without_a_network(
    chromium: Any, documentation: Path
) -> None:
    """Each table at 1280 px, those of how to choose on a phone, the header on one line."""
    site = [p.relative_to(documentation) for p in documentation.rglob("*.html")]
    pages = [str(p) for p in site if p.parts[0] not in ("api", "browser", "_static")]
    with _served(documentation) as address:
        for width, looked_at in (
            (1280, pages),
            (390, ["start/choose.html", "start/which_tool.html"]),
        ):
            page = chromium.new_page(viewport={"width": width, "height": 900})
            page.route(lambda url: not url.startswith(address), lambda route: route.abort())
            for name in looked_at:
                page.goto(address + name)
                assert max(page.evaluate(HIDDEN), default=0) <= 1, (width, name)
            assert page.evaluate("document.querySelector('.bd-header').offsetHeight") <= 80
            page.goto(f"{address}theory/jnd.html")
            page.wait_for_selector("mjx-container")
            assert page.locator("mjx-merror").count() == 0
            # Broken at every operator, an equation of one line was 300 px high.
            heights = "all => all.map((one) => one.offsetHeight)"
            assert max(page.eval_on_selector_all("mjx-container[display]", heights)) < 160
            page.close()


def test_every_link_within_the_documentation_leads_somewhere(documentation: Path) -> None:
    pages = {p: p.read_text("utf-8") for p in documentation.rglob("*.html")}
    named = {page: set(re.findall(r'\b(?:id|name)="(.+?)"', text)) for page, text in pages.items()}
    broken, seen = [], 0
    for page, text in pages.items():
        for found in re.findall(r'<(?:a|img|link|script)\b[^>]*?\b(?:href|src)="([^"]+)"', text):
            link = urlsplit(html.unescape(found))
            if link.scheme or link.netloc or "{{" in found:  # another site's, or a template's
                continue
            seen += 1
            target = (page.parent / unquote(link.path)).resolve() if link.path else page
            place = unquote(link.fragment)
            if not target.exists() or (place and place not in named.get(target, {place})):
                broken.append((page.name, found))
    assert seen > 10_000
    assert broken == []
