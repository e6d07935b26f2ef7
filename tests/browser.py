"""A report as Chromium draws it, without a window."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

from tools import need

DARK, LIGHT = 0, 1  # Chromium's numbers
_LOOK = """
<iframe id="page" src="PAGE" style="width:WIDTHpx;height:900px;border:0"></iframe><p id="seen"></p><script>
setInterval(() => {
  const page = document.getElementById("page").contentDocument;
  if (!page.body || page.body.dataset.drawn !== "yes") return;
  const found = {right: [], drawn: 0, scrolled: page.documentElement.scrollWidth, paper: getComputedStyle(page.body).backgroundColor};
  const look = node => {
    for (const e of node.querySelectorAll("*")) {
      if (e.tagName === "CANVAS" && e.width && e.height) {
        found.right.push(Math.round(e.getBoundingClientRect().right));
        const pixels = new Uint32Array(e.getContext("2d").getImageData(0, 0, e.width, e.height).data.buffer);
        found.drawn += new Set(pixels).size > 8;
      }
      if (e.shadowRoot) look(e.shadowRoot);
    }
  };
  look(page);
  document.getElementById("seen").textContent = JSON.stringify(found);
}, 500);</script>"""


class Seen(NamedTuple):
    """What is on a page: errors on the console, the right edges of its canvases [px], how many of these show something, how wide the page
    is [px], and the colour of its background.
    """

    errors: list[str]
    right: list[int]
    drawn: int
    width: int
    paper: str


def seen(report: Path, width: int, scheme: int = LIGHT) -> Seen:
    """`report` in a frame `width` pixels wide, by a reader who likes the `scheme`."""
    need(shutil.which("chromium") is not None, "chromium is not installed")
    frame = report.resolve().with_name(f"frame_{width}_{scheme}.html")
    frame.write_text(_LOOK.replace("PAGE", report.name).replace("WIDTH", str(width)), encoding="utf-8")
    command = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files"]
    command += ["--enable-logging=stderr", "--virtual-time-budget=15000", "--window-size=1300,1000", "--dump-dom"]
    command += [f"--blink-settings=preferredColorScheme={scheme}", frame.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    errors = [line for line in done.stderr.splitlines() if "CONSOLE" in line and "rror" in line]
    (text,) = re.findall(r'<p id="seen">([^<]*)</p>', done.stdout)
    found = json.loads(text)
    return Seen(errors, found["right"], found["drawn"], found["scrolled"], found["paper"])


def check(report: Path, figures: int) -> None:
    """Assert that all figures of a report are drawn, without an error, on a screen and on a telephone, light and dark."""
    papers = set()
    for width, scheme in ((1200, LIGHT), (400, DARK)):
        found = seen(report, width, scheme)
        assert found.errors == []
        assert found.drawn >= figures and max(found.right) <= width and found.width <= width
        papers.add(found.paper)
    assert papers == {"rgb(254, 254, 254)", "rgb(22, 22, 22)"}
    assert report.stat().st_size < 1.5e6
