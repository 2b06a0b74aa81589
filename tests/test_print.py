"""Page and cards on paper and on small screens, in a headless browser."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path

import pytest

from headless import FLAT, SPATIAL, browse, find_browser
from learn2assemble.assembly.blocks import Assembly
from learn2assemble.export.cards import step_cards
from learn2assemble.viewer.page import Verdict, render_assembly_page
from learn2assemble.viewer.tables import StepNote
from read_back import STRUCTURES

SCREENS = ((1400, 900), (900, 900), (390, 844))


@pytest.fixture(scope="module")
def house() -> Assembly:
    return STRUCTURES["house"]()


def page_of(assembly: Assembly) -> str:
    notes = [StepNote("bed faces, local", 0.2, 0.5)] * len(assembly.steps)
    return render_assembly_page(
        assembly, title="house", step_notes=notes, verdict=Verdict("complete")
    )


@pytest.mark.browser
@pytest.mark.parametrize("document", ["page", "cards"])
def test_no_printed_page_is_empty_and_none_cuts_a_line(
    house: Assembly, document: str, tmp_path: Path
) -> None:
    pypdf = pytest.importorskip("pypdf")
    browser = find_browser()
    text = page_of(house) if document == "page" else step_cards(STRUCTURES["gate"]())
    (tmp_path / "view.html").write_text(text, encoding="utf-8")
    paper = tmp_path / "paper.pdf"
    address = (tmp_path / "view.html").as_uri()
    browse(
        browser,
        tmp_path / "run",
        address,
        *FLAT,
        "--no-pdf-header-footer",
        f"--print-to-pdf={paper}",
    )
    pages = [page.extract_text() for page in pypdf.PdfReader(paper).pages]
    assert len(pages) > 1
    assert all(len(words.split()) > 20 for words in pages)
    for number, words in enumerate(pages, 1):
        assert re.search(rf"{number}\s*/\s*{len(pages)}", words), "every page has its number"
    if document == "page":
        rows = [re.findall(r"^\s*(\d+)\s*(?:place|remove)", words, re.MULTILINE) for words in pages]
        told = [int(number) for found in rows for number in found]
        assert told == list(range(1, len(house.steps) + 1))
        parts = sum(bool(found) for found in rows)
        heads = sum("Nominal size" in w and "Turn" in w and "Push" in w for w in pages)
        assert heads >= parts, "the head of the table stands on each of its pages"


@pytest.mark.browser
def test_the_timeline_is_in_sight_without_scrolling(house: Assembly, tmp_path: Path) -> None:
    """Measured inside frames of the size of three screens, which tell the page around them."""
    browser = find_browser()
    text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page_of(house))
    measure = """<script>
    const seen = [...document.querySelectorAll(".timeline button, #slider, #stage")]
      .map((item) => item.getBoundingClientRect());
    parent.postMessage({ width: innerWidth, height: innerHeight,
      low: Math.min(...seen.map((one) => one.left)),
      right: Math.max(...seen.map((one) => one.right)),
      bottom: Math.max(...seen.slice(1).map((one) => one.bottom)),
      wide: document.documentElement.scrollWidth, stage: seen[0].height }, "*");
    </script></body>"""
    (tmp_path / "view.html").write_text(text.replace("</body>", measure), encoding="utf-8")
    frames = "".join(
        f'<iframe src="view.html#step=5" style="border:0;width:{w}px;height:{h}px"></iframe>'
        for w, h in SCREENS
    )
    listen = """<pre id="out"></pre><script>
    const found = [];
    addEventListener("message", ({ data }) => {
      found.push(data);
      document.getElementById("out").textContent = JSON.stringify(found);
    });
    </script>"""
    around = tmp_path / "around.html"
    around.write_text(f"<!doctype html><body>{listen}{frames}", encoding="utf-8")
    dom, log = browse(browser, tmp_path / "run", around.as_uri(), *SPATIAL, "--dump-dom")
    out = re.search(r'<pre id="out">(.*?)</pre>', dom)
    assert out, log
    found = json.loads(html.unescape(out[1]))
    assert {(one["width"], one["height"]) for one in found} == set(SCREENS)
    for one in found:
        assert one["bottom"] <= one["height"], one
        assert one["low"] >= 0, one
        assert max(one["right"], one["wide"]) <= one["width"], one
