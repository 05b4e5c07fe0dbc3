"""The page in a real browser: upload, a map that grows, the replay; nothing on the console.

Chromium is driven through its debugging pipe. Without Chromium the tests are skipped; in CI
they fail. `HAPSLAM_TEST_SCREENSHOTS=FOLDER` keeps what the browser showed.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from estimator.measurement_files import save_measurements
from estimator.measurements import MeasurementSet
from service.client import Client
from service.messages.requests import epoch_entry, session_entry, sweep_entry
from tests.browser.chromium import Browser
from tests.service.harness import Server

_PAINTED = """(() => { const c = document.getElementById('map');
  const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
  let n = 0; for (let i = 3; i < d.length; i += 4) n += d[i] > 0; return n; })()"""


def test_a_map_grows_and_can_be_replayed(
    browser: Browser, server: Server, stroll: MeasurementSet, tmp_path: Path
) -> None:
    """Epochs sent while the page is open appear by themselves; the slider goes back in time."""
    entries = [epoch_entry(stroll.anchors, epoch) for epoch in stroll.epochs]
    with Client(server.url) as client:
        session = client.create_session(session_entry(stroll, name="stroll"))
        client.post_sweep(session, sweep_entry(stroll))
        client.post_epochs(session, entries[:10])
        browser.ask("Page.navigate", url=f"{server.url}/#/s/{session}")
        browser.wait_for("document.getElementById('facts')?.innerText.includes('9 of 9')")
        early = browser.value(_PAINTED)
        assert early > 1000
        for first in range(10, 30, 5):
            client.post_epochs(session, entries[first : first + 5])
        browser.wait_for("document.getElementById('facts').innerText.includes('29 of 29')")
        late = client.state(session)["agent"]["position_m"]
    shown = browser.value("document.getElementById('facts').innerText")
    assert f"{late[0]:.2f}, {late[1]:.2f} m" in shown
    browser.shot(tmp_path, "grown")
    browser.value(
        "(() => { const s = document.getElementById('slider'); s.value = 4; "
        "s.dispatchEvent(new Event('input')); })()"
    )
    browser.wait_for("document.getElementById('facts').innerText.includes('4 of 29')")
    browser.wait_for("document.getElementById('facts').innerText.includes('4.0 s')")
    browser.value("document.getElementById('theme').click()")
    browser.shot(tmp_path, "replay")
    assert browser.value("document.querySelectorAll('.plots canvas').length") == 3
    assert browser.complaints == []


def test_a_file_becomes_a_session(
    browser: Browser, server: Server, stroll: MeasurementSet, tmp_path: Path
) -> None:
    """A measurement file dropped on the page ends on its map; a wrong one, chosen, says what was expected."""
    file, wrong = tmp_path / "stroll.nc", tmp_path / "wrong.nc"
    save_measurements(stroll, file)
    wrong.write_bytes(b"not a file of measurements")
    browser.ask("Page.navigate", url=f"{server.url}/")
    browser.wait_for("document.getElementById('list') && !document.getElementById('list').hidden")
    _choose(browser, wrong)
    browser.wait_for("document.getElementById('notice').innerText.includes('expected a netCDF-4')")
    browser.complaints.clear()  # the browser notes the 422
    _drop(browser, file)
    browser.wait_for("document.getElementById('facts')?.innerText.includes('29 of 29')")
    assert browser.value("document.getElementById('name').innerText") == "stroll.nc"
    browser.ask("Page.navigate", url=f"{server.url}/docs")
    browser.wait_for("document.querySelectorAll('.route').length > 10")
    route = (
        "[...document.querySelectorAll('.route')].find((r) => r.innerText.startsWith('GET /v1/sessions '))"
    )
    browser.value(f"{route}.open = true")
    assert "list of Session" in browser.value(f"{route}.innerText")
    browser.value(f"{route}.querySelector('.try').requestSubmit()")
    browser.wait_for(f"{route}.innerText.includes('stroll.nc')")
    browser.shot(tmp_path, "docs")
    assert browser.complaints == []


def _choose(browser: Browser, file: Path) -> None:
    root = browser.ask("DOM.getDocument")["root"]["nodeId"]
    node = browser.ask("DOM.querySelector", nodeId=root, selector="#file")["nodeId"]
    browser.ask("DOM.setFileInputFiles", nodeId=node, files=[str(file)])


def _drop(browser: Browser, file: Path) -> None:
    data = {"items": [], "files": [str(file)], "dragOperationsMask": 1}
    for step in ("dragEnter", "dragOver", "drop"):
        browser.ask("Input.dispatchDragEvent", type=step, x=300, y=160, data=data)


def test_the_example_runs_from_the_keyboard(browser: Browser, server: Server, tmp_path: Path) -> None:
    """Enter on its button: the map grows beside the truth; on a phone nothing is wider than the screen."""
    browser.ask("Emulation.setDeviceMetricsOverride", width=390, height=844, deviceScaleFactor=1, mobile=True)
    browser.ask("Page.navigate", url=f"{server.url}/")
    browser.wait_for("document.getElementById('list') && !document.getElementById('list').hidden")
    browser.value("document.getElementById('example').focus()")
    _type(browser, "Enter", 13, "\r")
    browser.wait_for("/Epoch\\s+[1-9]\\d+ of/.test(document.getElementById('facts')?.innerText)")
    browser.wait_for("document.getElementById('facts').innerText.includes('Error')")
    browser.value("document.getElementById('slider').focus()")
    _type(browser, "Home", 36)
    browser.wait_for("document.getElementById('facts').innerText.includes('0 of')")
    before = browser.value("document.getElementById('map').toDataURL()")
    browser.value("document.getElementById('map').focus()")
    _type(browser, "+", 187, "+")
    assert browser.value("document.getElementById('map').toDataURL()") != before
    assert browser.value("document.documentElement.scrollWidth") <= 390
    browser.shot(tmp_path, "phone")
    assert browser.complaints == []


def _type(browser: Browser, key: str, code: int, text: str = "") -> None:
    for step in ("keyDown", "keyUp"):
        typed = {"text": text} if text and step == "keyDown" else {}
        browser.ask("Input.dispatchKeyEvent", type=step, key=key, windowsVirtualKeyCode=code, **typed)


_DRAWN_MS = 30.0  # of processor and picture together, for a map that follows its slider
_LARGE = """(async () => {
  const { MapView } = await import("/web/map.js");
  const canvas = document.createElement("canvas");
  canvas.style = "width: 900px; height: 600px; display: block";
  document.body.append(canvas);
  const map = new MapView(canvas), many = (length, made) => Array.from({ length }, (_, i) => made(i));
  map.resize();
  const covariance_m2 = [[0.01, 0], [0, 0.01]];
  const track = many(10000, (i) => [30 * Math.cos(i / 700) + i / 900, 20 * Math.sin(i / 900)]);
  const vrp = (id) => [80 * Math.cos(id), 80 * Math.sin(id)];
  const walls = many(12, (id) => ({ id, vrp_m: vrp(id), covariance_m2 }));
  const anchors = many(4, (k) => ({ name: `pa${k}`, located: true, position_m: [9 * k, 12], covariance_m2 }));
  const agent = { position_m: track[9999], covariance: [[0.01, 0, 0, 0], [0, 0.01, 0, 0]] };
  const scene = { state: { agent, anchors, walls, candidates: [] }, place: (p) => p, heading: 0, enlarge: 1 };
  const times = many(21, (n) => {
    const begin = performance.now();
    map.show({ ...scene, track: track.slice(0, 9980 + n) });
    canvas.getContext("2d").getImageData(0, 0, 1, 1);  // until it is drawn
    return performance.now() - begin;
  });
  canvas.remove();
  return times.sort((a, b) => a - b)[2];
})()"""


def test_ten_thousand_epochs_are_drawn_in_time(
    browser: Browser, server: Server, record_property: Callable[[str, Any], None]
) -> None:
    """A long track, walls and anchors are redrawn well within two frames of a screen."""
    browser.ask("Page.navigate", url=f"{server.url}/")
    browser.wait_for("document.getElementById('list') && !document.getElementById('list').hidden")
    found = browser.ask("Runtime.evaluate", expression=_LARGE, returnByValue=True, awaitPromise=True)
    spent = found["result"]["value"]
    record_property("10,000 epochs redrawn, ms", f"{spent:.1f}")
    assert spent < _DRAWN_MS
    assert browser.complaints == []


def test_things_are_selected_and_doubts_are_seen(
    browser: Browser, server: Server, stroll: MeasurementSet, tmp_path: Path
) -> None:
    """An anchor chosen in the table tells distances on the map; a lost run and a foreign session say so."""
    with Client(server.url) as client:
        name = "a very long name of a session " * 6
        session = client.create_session(session_entry(stroll, name=name))
        client.post_sweep(session, sweep_entry(stroll))
        client.post_epochs(session, [epoch_entry(stroll.anchors, epoch) for epoch in stroll.epochs[:12]])
    browser.ask("Page.navigate", url=f"{server.url}/")
    browser.wait_for("document.querySelectorAll('#sessions tr').length > 0")
    assert browser.value("document.documentElement.scrollWidth <= innerWidth")
    assert browser.value("document.querySelector('#sessions [data-integrity]').innerText") in (
        "ok",
        "doubtful",
    )
    browser.shot(tmp_path, "list")
    browser.ask("Page.navigate", url=f"{server.url}/#/s/{session}")
    browser.wait_for("document.querySelectorAll('#anchors tbody tr').length === 2")
    assert browser.value("document.title").startswith("a very long name")
    browser.value("document.querySelector('#anchors tbody tr').click()")
    browser.wait_for("document.querySelector('#anchors tr[aria-selected=true]') !== null")
    box = browser.value(
        "(() => { const b = document.getElementById('map').getBoundingClientRect();"
        " return [b.left + b.width / 2, b.top + b.height / 2]; })()"
    )
    browser.ask("Input.dispatchMouseEvent", type="mouseMoved", x=box[0], y=box[1])
    browser.wait_for("document.getElementById('tip').innerText.includes('m from pa1')")
    assert browser.value("document.getElementById('link').dataset.state") == "live"
    browser.value(
        "import('/web/session.js').then(({ SessionView }) => SessionView.prototype.tellIntegrity.call({},"
        " { state: 'lost', reasons: ['no wall explains the paths'] }))"
    )
    browser.wait_for("!document.getElementById('integrity').hidden")
    assert "Lost: do not rely" in browser.value("document.getElementById('integrity').innerText")
    browser.shot(tmp_path, "lost")
    assert browser.complaints == []
    browser.ask("Page.navigate", url=f"{server.url}/#/s/{'0' * 32}")
    browser.wait_for("document.getElementById('notice').innerText.includes('belongs to another key')")
    browser.shot(tmp_path, "foreign")


def test_predicted_coverage_lies_under_the_map(
    browser: Browser, server: Server, stroll: MeasurementSet, tmp_path: Path
) -> None:
    """Asked for, it colours the room and says its range; put off, the map is as before."""
    with Client(server.url) as client:
        session = client.create_session(session_entry(stroll, name="covered"))
        client.post_sweep(session, sweep_entry(stroll))
        client.post_epochs(session, [epoch_entry(stroll.anchors, epoch) for epoch in stroll.epochs])
        assert client.twin(session).startswith('format = "hapslam-floorplan"')
    browser.ask("Page.navigate", url=f"{server.url}/#/s/{session}")
    browser.wait_for("document.querySelectorAll('#anchors tbody tr').length === 2")
    pixels = "map.getContext('2d').getImageData(0, 0, map.width, map.height).data"
    coloured = (
        f"(() => {{ const map = document.getElementById('map'), d = {pixels}; let n = 0;"
        " for (let i = 0; i < d.length; i += 4) { const rgb = [d[i], d[i + 1], d[i + 2]];"
        " if (d[i + 3] > 100 && Math.max(...rgb) - Math.min(...rgb) > 60) n++; }"
        " return n / (d.length / 4); })()"
    )
    bare = browser.value(coloured)
    browser.value("document.getElementById('coverage').click()")
    browser.wait_for("document.getElementById('coverage-legend').innerText.includes('dB (bright)')")
    assert browser.value(coloured) > bare + 0.2
    browser.shot(tmp_path, "coverage")
    browser.value("document.getElementById('coverage').click()")
    browser.wait_for("document.getElementById('coverage-legend').innerText === 'predicted coverage'")
    assert abs(browser.value(coloured) - bare) < 0.02
    assert browser.complaints == []


_CONTRAST = """(() => {
  const style = getComputedStyle(document.documentElement);
  const light = (name) => {
    const hex = style.getPropertyValue(`--${name}`).trim().slice(1);
    const full = hex.length === 3 ? [...hex].map((c) => c + c).join("") : hex;
    const [r, g, b] = [0, 2, 4].map((i) => parseInt(full.slice(i, i + 2), 16) / 255)
      .map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ratio = (a, b) => {
    const [x, y] = [light(a), light(b)].sort((p, q) => q - p);
    return (x + 0.05) / (y + 0.05);
  };
  return Object.fromEntries(JSON.parse(PAIRS).map(([a, b]) => [`${a} on ${b}`, ratio(a, b)]));
})()"""


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_colours_have_contrast(browser: Browser, server: Server, theme: str) -> None:
    """Text stands out 4.5 times, marks of the map three times (WCAG 2.2, 1.4.3 and 1.4.11)."""
    browser.ask("Page.navigate", url=f"{server.url}/")
    browser.wait_for("document.getElementById('list') !== null")
    browser.value(f"document.documentElement.dataset.theme = '{theme}'")
    text = [(a, b) for a in ("ink", "muted", "accent") for b in ("ground", "panel")]
    text += [("on-accent", "accent"), ("on-accent", "anchor"), ("on-accent", "wall"), ("anchor", "ground")]
    marks = [(mark, "ground") for mark in ("agent", "anchor", "wall", "true")]
    for pairs, least in ((text, 4.5), (marks, 3.0)):
        found = browser.value(_CONTRAST.replace("PAIRS", repr(json.dumps(pairs))))
        assert {name: ratio for name, ratio in found.items() if ratio < least} == {}
