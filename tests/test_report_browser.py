"""Report pages in a browser: accessible by the rules of axe-core, and on A4 paper."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from chromium import BROWSER, Chromium, DESKTOP, PHONE
from page_samples import pages
from report_sample import sample_diagnosis


pytestmark = [
    pytest.mark.timeout(600),
    pytest.mark.skipif(
        BROWSER is None,
        reason="no Chromium here: accessibility and print of the report were not checked",
    ),
]


def chromium(*arguments: str, folder: Path) -> str:
    assert BROWSER is not None
    profile = folder / "profile"
    command = [
        BROWSER,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        f"--user-data-dir={profile}",
        *arguments,
    ]
    return subprocess.run(command, capture_output=True, text=True, timeout=550, check=True).stdout


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> dict[str, Path]:
    """A page of every kind."""
    return pages(tmp_path_factory.mktemp("pages"))


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_pages_of_every_kind_are_accessible(written, size, tmp_path):
    pytest.importorskip(
        "axe_core_python", reason="axe-core is not installed: accessibility was not checked"
    )
    found = {}
    with Chromium(tmp_path, size) as browser:
        for kind, page in written.items():
            assert "Content-Security-Policy" in page.read_text(encoding="utf-8")
            browser.shown(page.as_uri())
            found[kind] = browser.violations()
            browser.evaluate(UNFOLD)
            found[kind] += browser.violations()
    assert found == dict.fromkeys(written, [])


def test_a_page_of_many_joints_is_folded_on_a_screen_and_whole_in_print(written, tmp_path):
    page = written["robot under goals"].as_uri()
    height = "document.documentElement.scrollHeight"
    hidden = """[...document.querySelectorAll("details svg, details td")]
        .filter(e => !e.checkVisibility({contentVisibilityAuto: true})).length"""
    with Chromium(tmp_path, DESKTOP) as browser:
        browser.shown(page)
        folded = browser.evaluate(height)
        cards = browser.evaluate("document.querySelector('.cards').getBoundingClientRect().top")
        assert cards < DESKTOP[1] and browser.evaluate(hidden) > 0
        browser.ask("Emulation.setEmulatedMedia", media="print")
        printed = browser.evaluate(height)
        assert browser.evaluate(hidden) == 0
        browser.ask("Emulation.setEmulatedMedia", media="screen")
        browser.evaluate(UNFOLD)
        opened = browser.evaluate(height)
    assert folded < 0.7 * opened
    assert printed > folded


#: Opens what is folded on a page.
UNFOLD = "document.querySelectorAll('details').forEach(d => { d.open = true })"

#: What a phone shows: pictures of a page, their smallest letters, how wide it is, what is cut off.
READ = """
(() => {
  const shown = [...document.querySelectorAll("figure svg")].filter(s => s.getClientRects().length);
  const scale = t => { const m = t.getScreenCTM(); return Math.hypot(m.a, m.b); };
  const size = t => parseFloat(getComputedStyle(t).fontSize) * scale(t);
  const outside = t => { const r = t.getBoundingClientRect(); return r.left < 0 || r.right > innerWidth; };
  const letters = shown.flatMap(s => [...s.querySelectorAll("text")]);
  return {pictures: shown.length, all: document.querySelectorAll("figure svg").length,
    width: document.documentElement.scrollWidth, least: Math.min(99, ...letters.map(size)),
    cut: letters.filter(outside).map(t => t.textContent)};
})()
"""


def test_letters_of_pictures_can_be_read_on_a_phone(written, tmp_path):
    with Chromium(tmp_path, PHONE) as browser:
        for kind, page in written.items():
            browser.shown(page.as_uri())
            browser.evaluate(UNFOLD)
            found = browser.evaluate(READ)
            assert found["pictures"] == found["all"], kind
            assert found["least"] >= 9.0, (kind, found)
            assert found["width"] <= PHONE[0] and found["cut"] == [], (kind, found)


#: Letters that reach beyond their picture, by how many pixels.
BEYOND = """
[...document.querySelectorAll("figure svg")].flatMap(s => {
  const edge = s.getBoundingClientRect();
  return [...s.querySelectorAll("text")].filter(t => t.textContent.trim())
    .map(t => [t.textContent, t.getBoundingClientRect()])
    .map(([told, r]) => [told, Math.max(edge.left - r.left, r.right - edge.right)])
    .filter(([, far]) => far > 0.5);
})
"""


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_letters_of_pictures_stay_within_them(written, size, tmp_path):
    found = {}
    with Chromium(tmp_path, size) as browser:
        for kind, page in written.items():
            browser.shown(page.as_uri())
            browser.evaluate(UNFOLD)
            found[kind] = browser.evaluate(BEYOND)
    assert found == dict.fromkeys(written, [])


#: Letters of a picture that lie over one another by more than a pixel or two.
OVER = """
[...document.querySelectorAll("figure svg")].flatMap(s => {
  const boxes = [...s.querySelectorAll("text")].filter(t => t.textContent.trim())
    .map(t => [t.textContent, t.getBoundingClientRect()]);
  const over = (a, b) => Math.min(a.right, b.right) - Math.max(a.left, b.left) > 2
    && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 6;
  return boxes.flatMap(([one, a], i) => boxes.slice(i + 1).filter(([, b]) => over(a, b))
    .map(([other]) => [one, other]));
})
"""


def test_letters_of_pictures_do_not_lie_over_one_another(written, tmp_path):
    found = {}
    with Chromium(tmp_path, DESKTOP) as browser:
        for kind, page in written.items():
            browser.shown(page.as_uri())
            browser.evaluate(UNFOLD)
            found[kind] = browser.evaluate(OVER)
    assert found == dict.fromkeys(written, [])


def test_prints_on_a4(tmp_path):
    page = sample_diagnosis(800).report(tmp_path / "page.html")
    pdf = tmp_path / "page.pdf"
    chromium(f"--print-to-pdf={pdf}", "--no-pdf-header-footer", page.as_uri(), folder=tmp_path)
    content = pdf.read_bytes()
    boxes = re.findall(rb"/MediaBox\s*\[\s*0 0 ([\d.]+) ([\d.]+)\s*\]", content)
    assert 2 <= len(boxes) <= 8
    for width, height in boxes:  # points
        assert (float(width), float(height)) == pytest.approx((595.3, 841.9), abs=1.0)
