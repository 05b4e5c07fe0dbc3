"""Two sessions on one map, at the same time, and what can be tried in the reference."""

from __future__ import annotations

from pathlib import Path

from estimator.measurements import MeasurementSet
from service.client import Client
from service.messages.requests import epoch_entry, session_entry, sweep_entry
from tests.browser.chromium import Browser
from tests.service.harness import Server

_PICTURE = "document.getElementById('map').toDataURL()"
_FACTS = "document.getElementById('facts').innerText"


def _session(client: Client, stroll: MeasurementSet, name: str, epochs: int, **more: object) -> str:
    session = client.create_session({**session_entry(stroll, name=name), **more})
    client.post_sweep(session, sweep_entry(stroll))
    client.post_epochs(session, [epoch_entry(stroll.anchors, epoch) for epoch in stroll.epochs[:epochs]])
    return session


def test_two_sessions_are_compared(
    browser: Browser, server: Server, stroll: MeasurementSet, tmp_path: Path
) -> None:
    """The other's agent, walls and anchors are drawn at the same time; the distance is among the facts."""
    with Client(server.url) as client:
        one = _session(client, stroll, "one", 20)
        other = _session(client, stroll, "the other", 12, measurement_model={"range_std_m": 0.4})
        ours, theirs = (client.state(session, 11) for session in (one, other))
    browser.ask("Page.navigate", url=f"{server.url}/#/s/{one}")
    browser.wait_for("document.getElementById('facts')?.innerText.includes('19 of 19')")
    alone = browser.value(_PICTURE)
    assert "the other" not in browser.value(_FACTS)
    browser.wait_for(f"!!document.querySelector(`#other option[value='{other}']`)")
    browser.value(
        f"(() => {{ const s = document.getElementById('other'); s.value = '{other}'; "
        "s.dispatchEvent(new Event('change')); })()"
    )
    browser.wait_for(f"{_FACTS}.includes('From the other')")
    assert browser.value("location.hash") == f"#/s/{one}?with={other}"
    assert browser.value(_PICTURE) != alone
    browser.ask("Page.reload")
    browser.wait_for(f"document.getElementById('facts') && {_FACTS}.includes('From the other')")
    browser.value(
        "(() => { const s = document.getElementById('slider'); s.value = 11; "
        "s.dispatchEvent(new Event('input')); })()"
    )
    places = [state["agent"]["position_m"] for state in (ours, theirs)]
    apart = sum((a - b) ** 2 for a, b in zip(*places, strict=True)) ** 0.5
    browser.wait_for(f"{_FACTS}.includes('{apart:.3f} m')")
    browser.shot(tmp_path, "compared")
    assert browser.value("document.getElementById('other-legend').hidden") is False
    assert browser.complaints == []


def test_the_reference_tries_bodies(browser: Browser, server: Server) -> None:
    """A form has numbers and choices where the interface has them; an example's body makes a session."""
    browser.ask("Page.navigate", url=f"{server.url}/docs")
    browser.wait_for("document.querySelectorAll('.route').length > 10")
    browser.value(
        "window.at = (start) => [...document.querySelectorAll('.route')]"
        ".find((r) => r.querySelector('summary').innerText.startsWith(start))"
    )
    assert browser.value("at('GET /v1/sessions ').querySelector('[name=limit]').type") == "number"
    kinds = browser.value(
        "[...at('GET /v1/sessions/{session_id}/map ').querySelectorAll('[name=format] option')]"
        ".map((option) => option.value)"
    )
    assert {"", "json", "geojson"} <= set(kinds)
    browser.value("at('POST /v1/sessions ').querySelector('form').requestSubmit()")
    browser.wait_for("at('POST /v1/sessions ').querySelector('form + pre').textContent.startsWith('201')")
    assert browser.complaints == []
