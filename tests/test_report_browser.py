"""Report pages in a browser: accessible by the rules of axe-core, and on A4 paper."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from importlib.resources import files
from pathlib import Path

import pytest

from report_sample import sample_diagnosis, sample_fit


BROWSER = next(
    (b for b in ("chromium", "chromium-browser", "google-chrome", "chrome") if shutil.which(b)),
    None,
)

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


@pytest.mark.parametrize("kind", ["diagnosis", "fit"])
def test_pages_are_accessible(kind, tmp_path):
    pytest.importorskip(
        "axe_core_python", reason="axe-core is not installed: accessibility was not checked"
    )
    axe = (files("axe_core_python") / "axe.min.js").read_text(encoding="utf-8")
    page = (sample_diagnosis(800) if kind == "diagnosis" else sample_fit(samples=800)).report(
        tmp_path / "page.html"
    )
    source = page.read_text(encoding="utf-8")
    assert "Content-Security-Policy" in source  # which would refuse the script below
    source = re.sub(r"<meta http-equiv=[^>]*>", "", source)
    run = """
    axe.run(document, {resultTypes: ["violations"]}).then(found => {
      const out = document.createElement("pre");
      out.id = "found";
      out.textContent = JSON.stringify({rules: found.passes.length, violations: found.violations.map(
        v => [v.id, v.impact, v.help, v.nodes.slice(0, 3).map(n => n.html.slice(0, 200))])});
      document.body.appendChild(out);
    });
    """
    page.write_text(
        source.replace("</body>", f"<script>{axe}</script><script>{run}</script></body>"),
        encoding="utf-8",
    )
    shown = chromium("--virtual-time-budget=60000", "--dump-dom", page.as_uri(), folder=tmp_path)
    match = re.search(r'<pre id="found">(.*?)</pre>', shown, re.S)
    assert match is not None, "axe did not finish"
    found = json.loads(html.unescape(match[1]))
    assert found["rules"] > 10
    assert found["violations"] == []


def test_letters_of_pictures_can_be_read_on_a_phone(tmp_path):
    page = sample_diagnosis(800).report(tmp_path / "page.html")
    source = re.sub(r"<meta http-equiv=[^>]*>", "", page.read_text(encoding="utf-8"))
    run = """
    const shown = [...document.querySelectorAll("figure svg")].filter(s => s.getClientRects().length);
    const scale = t => { const m = t.getScreenCTM(); return Math.hypot(m.a, m.b); };
    const size = t => parseFloat(getComputedStyle(t).fontSize) * scale(t);
    const outside = t => { const r = t.getBoundingClientRect(); return r.left < 0 || r.right > innerWidth; };
    const letters = shown.flatMap(s => [...s.querySelectorAll("text")]);
    parent.postMessage(JSON.stringify({pictures: shown.length, all: document.querySelectorAll("figure").length,
      width: document.documentElement.scrollWidth, least: Math.min(...letters.map(size)),
      cut: letters.filter(outside).map(t => t.textContent)}), "*");
    """
    page.write_text(source.replace("</body>", f"<script>{run}</script></body>"), encoding="utf-8")
    phone = tmp_path / "phone.html"
    phone.write_text(
        "<pre id=found></pre><script>onmessage = m => document.getElementById('found').textContent = m.data</script>"
        f'<iframe src="{page.as_uri()}" style="width: 390px; height: 800px; border: 0"></iframe>',
        encoding="utf-8",
    )
    shown = chromium("--virtual-time-budget=60000", "--dump-dom", phone.as_uri(), folder=tmp_path)
    match = re.search(r'<pre id="found">({.*?})</pre>', shown, re.S)
    assert match is not None, "the page did not answer"
    found = json.loads(html.unescape(match[1]))
    assert found["pictures"] == found["all"] > 3  # one of the two of each
    assert found["least"] >= 9.0 and found["width"] <= 390 and found["cut"] == []


def test_prints_on_a4(tmp_path):
    page = sample_diagnosis(800).report(tmp_path / "page.html")
    pdf = tmp_path / "page.pdf"
    chromium(f"--print-to-pdf={pdf}", "--no-pdf-header-footer", page.as_uri(), folder=tmp_path)
    content = pdf.read_bytes()
    boxes = re.findall(rb"/MediaBox\s*\[\s*0 0 ([\d.]+) ([\d.]+)\s*\]", content)
    assert 2 <= len(boxes) <= 8
    for width, height in boxes:  # points
        assert (float(width), float(height)) == pytest.approx((595.3, 841.9), abs=1.0)
