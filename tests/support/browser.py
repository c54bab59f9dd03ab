"""A page in a headless browser, Chromium: what it shows after a script has worked on it."""

import json
import re
import shutil
import subprocess
from html import unescape

import pytest

CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)

needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: the pages were not opened")

_BEFORE = """<script>window.faults = [];
// Without a screen the browser may draw no frames: they come by the clock, which runs ahead of time.
window.requestAnimationFrame = (act) => setTimeout(() => act(performance.now()), 16);
addEventListener("error", (event) => faults.push(String(event.message)));
addEventListener("unhandledrejection", (event) => faults.push(String(event.reason)));</script>"""

_AFTER = """<script>(async () => {
const settled = () => new Promise((done) => setTimeout(done, 50));
const viewers = [...document.querySelectorAll(".viewer")], drawn = () => {
  const { triangles, signs, state, frame, depth, labels, view } = viewers[0].dataset;
  return { triangles: Number(triangles), signs: JSON.parse(signs), state: Number(state), frame: Number(frame),
           depth: Number(depth), labels: Number(labels), view };
};
const button = (said) => [...document.querySelectorAll("button")].find((one) => one.textContent === said).click();
const slide = (name, value) => {
  const one = document.querySelector("input[aria-label='" + name + "']");
  one.value = value;
  one.dispatchEvent(new Event("input"));
};
const legend = [...document.querySelectorAll(".legend label")];
const toggle = (said) => legend.find((one) => one.textContent === said).click();
let found = null;
try { await settled(); found = await (async () => { %s })(); } catch (error) { faults.push(String(error)); }
const out = document.createElement("pre");
out.id = "found";
out.textContent = JSON.stringify({ found, faults, wide: document.documentElement.scrollWidth - innerWidth });
document.body.appendChild(out);
})();</script>"""


def opened(page, script="return viewers.length ? drawn() : null;", width=1000):
    """Open a page, run a script in it, and return what the script returns and by how many pixels the page is too wide.

    Fails if the page writes an error to its console or reaches for anything else.
    """
    text = page.read_text(encoding="utf-8")
    made = page.with_name(f"{page.stem}-opened.html")
    head = text.replace("<head>", "<head>" + _BEFORE, 1)
    made.write_text(head.replace("</body>", (_AFTER % script) + "</body>"), encoding="utf-8")
    target = made
    if width < 500:  # the browser's own window is never narrower
        target = page.with_name(f"{page.stem}-framed.html")
        target.write_text(
            f"<body><iframe src='{made.name}' style='width:{width}px;height:900px'></iframe><script>"
            "const look = setInterval(() => { const one = frames[0].document.getElementById('found'); if (one) {"
            "clearInterval(look); document.body.innerHTML = one.outerHTML; } }, 50);</script></body>",
            encoding="utf-8",
        )
    words = ["--headless", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files", "--enable-logging=stderr"]
    words += [f"--user-data-dir={page.parent / 'profile'}", f"--window-size={width},900", "--virtual-time-budget=8000"]
    done = subprocess.run(
        [CHROMIUM, *words, "--dump-dom", target.as_uri()], capture_output=True, text=True, check=True, timeout=120
    )
    said = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    answer = json.loads(unescape(re.search(r'<pre id="found">(.*?)</pre>', done.stdout, re.DOTALL)[1]))
    assert (answer["faults"], said) == ([], [])
    return answer["found"], answer["wide"]
