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


BROWSER = next((b for b in ("chromium", "chromium-browser", "google-chrome", "chrome") if shutil.which(b)), None)

pytestmark = [
    pytest.mark.timeout(600),
    pytest.mark.skipif(BROWSER is None, reason="no Chromium here: accessibility and print of the report were not checked"),
]


def chromium(*arguments: str, folder: Path) -> str:
    assert BROWSER is not None
    profile = folder / "profile"
    command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={profile}", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=550, check=True).stdout


@pytest.mark.parametrize("kind", ["diagnosis", "fit"])
def test_pages_are_accessible(kind, tmp_path):
    pytest.importorskip("axe_core_python", reason="axe-core is not installed: accessibility was not checked")
    axe = (files("axe_core_python") / "axe.min.js").read_text(encoding="utf-8")
    page = (sample_diagnosis(800) if kind == "diagnosis" else sample_fit(samples=800)).report(tmp_path / "page.html")
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
    page.write_text(source.replace("</body>", f"<script>{axe}</script><script>{run}</script></body>"), encoding="utf-8")
    shown = chromium("--virtual-time-budget=60000", "--dump-dom", page.as_uri(), folder=tmp_path)
    match = re.search(r'<pre id="found">(.*?)</pre>', shown, re.S)
    assert match is not None, "axe did not finish"
    found = json.loads(html.unescape(match[1]))
    assert found["rules"] > 10
    assert found["violations"] == []


def test_prints_on_a4(tmp_path):
    page = sample_diagnosis(800).report(tmp_path / "page.html")
    pdf = tmp_path / "page.pdf"
    chromium(f"--print-to-pdf={pdf}", "--no-pdf-header-footer", page.as_uri(), folder=tmp_path)
    content = pdf.read_bytes()
    boxes = re.findall(rb"/MediaBox\s*\[\s*0 0 ([\d.]+) ([\d.]+)\s*\]", content)
    assert 2 <= len(boxes) <= 8
    for width, height in boxes:  # points
        assert (float(width), float(height)) == pytest.approx((595.3, 841.9), abs=1.0)
