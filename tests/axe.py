"""What is wrong with pages for people who hear them, enlarge them, use a keyboard alone or read on a phone."""

from pathlib import Path

import axe_core_python
import pytest

from chromium import BROWSER, tab

AXE = Path(axe_core_python.__file__).with_name("axe.min.js").read_text("utf-8")
SERIOUS = ("serious", "critical")
NODES = "nodes: each.nodes.map(node => node.html)"
RUN = f"axe.run().then(found => found.violations.map(each => ({{impact: each.impact, rule: each.id, {NODES}}})))"
TOO_WIDE = "document.documentElement.scrollWidth > document.documentElement.clientWidth"

PAGES = pytest.mark.parametrize(("width_px", "scheme"), [(1280, "light"), (400, "dark")])
in_browser = pytest.mark.skipif(BROWSER is None, reason="no chromium is installed")


def faults_of(pages, width_px=1280, scheme="light"):
    """What axe-core calls serious or critical in HTML files, and files that are wider than the window."""
    faults = []
    with tab("about:blank", width_px) as browser:
        browser.prefer(scheme)
        for page in pages:
            browser.open(page.as_uri())
            browser.until(f"location.href == {page.as_uri()!r} && document.readyState == 'complete'")
            if browser.ask(TOO_WIDE):
                faults.append(f"{page.name} is wider than {width_px} px")
            browser.ask(f"{AXE}; 0")
            for found in browser.ask(RUN):
                if found["impact"] in SERIOUS:
                    nodes = found["nodes"]
                    faults.append(f"{page.name}: {found['rule']}, {len(nodes)} times, as {nodes[0][:200]}")
    return faults
