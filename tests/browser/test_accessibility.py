"""Who does not see, or uses no mouse: axe-core finds no serious fault on any page, light, dark or narrow.

``axe-core/`` has version 4.14.1 of Deque's engine as its authors publish it, packed, under the licence
beside it (MPL-2.0); nothing of it is installed with the service.
"""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import pytest

from estimator.measurements import MeasurementSet
from service.client import Client
from service.messages.requests import epoch_entry, session_entry, sweep_entry
from tests.browser.chromium import Browser
from tests.service.harness import Server

_ENGINE = Path(__file__).parent / "axe-core" / "axe.min.js.gz"
_FAULTS = """axe.run(document, { resultTypes: ["violations"] }).then((found) => found.violations
  .filter(({ impact }) => ["serious", "critical"].includes(impact))
  .map(({ id, help, nodes }) => `${id}: ${help}: ${nodes.slice(0, 3).map((node) => node.html).join(" ")}`))"""


def _faults(browser: Browser) -> Any:
    browser.ask("Runtime.evaluate", expression=gzip.decompress(_ENGINE.read_bytes()).decode())
    found = browser.ask("Runtime.evaluate", expression=_FAULTS, returnByValue=True, awaitPromise=True)
    return found["result"]["value"]


@pytest.fixture(scope="module")
def session(server: Server, stroll: MeasurementSet) -> str:
    """A session of some epochs."""
    with Client(server.url) as client:
        made = client.create_session(session_entry(stroll, name="stroll"))
        client.post_sweep(made, sweep_entry(stroll))
        client.post_epochs(made, [epoch_entry(stroll.anchors, epoch) for epoch in stroll.epochs[:12]])
    return made


@pytest.mark.parametrize(("theme", "width"), [("light", 1200), ("dark", 390)])
def test_no_serious_fault(browser: Browser, server: Server, session: str, theme: str, width: int) -> None:
    """List, session, a refusal and the reference of the interface."""
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 800}
    browser.ask("Emulation.setDeviceMetricsOverride", **size)
    feature = {"name": "prefers-color-scheme", "value": theme}
    browser.ask("Emulation.setEmulatedMedia", features=[feature])
    pages = {
        "/": "document.querySelectorAll('#sessions tr').length > 0",
        f"/#/s/{session}": "document.querySelectorAll('#anchors tbody tr').length === 2",
        f"/#/s/{'0' * 32}": "document.getElementById('notice')?.hidden === false",
        "/docs": "document.querySelectorAll('.route').length > 10",
    }
    found = {}
    for place, ready in pages.items():
        browser.ask("Page.navigate", url=f"{server.url}{place}")
        browser.wait_for(ready)
        if place == "/docs":
            browser.value("document.querySelectorAll('.route').forEach((r) => { r.open = true; })")
        found[place] = _faults(browser)
    assert {place: faults for place, faults in found.items() if faults} == {}
