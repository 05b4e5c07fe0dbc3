"""Encoded messages of positioning: LPP in UPER, NRPPa in APER, as the JSON of their elements.

Decoding needs the package pycrate (`hapslam[3gpp]`), which has both protocols compiled. Messages are of
strangers: decode them where memory and time are limited.
"""

from __future__ import annotations

from typing import Any, Literal

from estimator.errors import FileFormatError, InputError

__all__ = ["Protocol", "decoded"]

Protocol = Literal["lpp", "nrppa"]
_LPP_INFORMATION = {
    "nr-DL-TDOA-ProvideLocationInformation-r16": "nr-DL-TDOA-SignalMeasurementInformation-r16",
    "nr-Multi-RTT-ProvideLocationInformation-r16": "nr-Multi-RTT-SignalMeasurementInformation-r16",
    "nr-DL-AoD-ProvideLocationInformation-r16": "nr-DL-AoD-SignalMeasurementInformation-r16",
}
_READER_ERRORS = (ValueError, TypeError, KeyError, IndexError, AttributeError, RecursionError)
_RESPONSE_LISTS = (42, 43)  # ProtocolIE-IDs of TRP-MeasurementResponseList in a response and in a report


def decoded(protocol: Protocol, body: bytes) -> dict[str, Any]:
    """The measurements in a message, as :class:`service.messages.nr_epoch.NrEpoch` takes them under its name.

    Parameters
    ----------
    protocol : str
        ``"lpp"`` for an ``LPP-Message`` with ``ProvideLocationInformation`` (TS 37.355), ``"nrppa"`` for an
        ``NRPPA-PDU`` with a measurement response or report (TS 38.455).
    body : bytes
        The encoded message.

    Raises
    ------
    InputError
        If pycrate is not installed.
    FileFormatError
        If it is no such message.
    """
    try:
        from pycrate_asn1rt.err import ASN1Err
        from pycrate_core.charpy import CharpyErr
    except ImportError as error:
        raise InputError(
            "expected JSON, for this service does not decode messages: pycrate is missing (hapslam[3gpp])"
        ) from error
    try:
        return _lpp(body) if protocol == "lpp" else _nrppa(body)
    except FileFormatError:
        raise
    except _READER_ERRORS + (ASN1Err, CharpyErr) as error:
        kind = "LPP-Message in UPER" if protocol == "lpp" else "NRPPA-PDU in APER"
        raise FileFormatError(f"expected an {kind}, could not decode it ({type(error).__name__})") from error


def _lpp(body: bytes) -> dict[str, Any]:
    from pycrate_asn1dir.LPP import LPP_PDU_Definitions

    message = LPP_PDU_Definitions.LPP_Message
    message.from_uper(body)
    content = _json(message.get_val())
    found = _at(content, "lpp-MessageBody", "c1", "provideLocationInformation", "criticalExtensions", "c1")
    information = (found or {}).get("provideLocationInformation-r9") or {}
    reports = {
        report: information[name][report]
        for name, report in _LPP_INFORMATION.items()
        if report in information.get(name, {})
    }
    if not reports:
        raise FileFormatError(
            "expected ProvideLocationInformation with NR measurements, got "
            f"{_named(content.get('lpp-MessageBody'))}"
        )
    return reports


def _nrppa(body: bytes) -> dict[str, Any]:
    from pycrate_asn1dir.NRPPa import NRPPA_PDU_Descriptions

    message = NRPPA_PDU_Descriptions.NRPPA_PDU
    message.from_aper(body)
    content = _json(message.get_val())
    ((kind, outcome),) = content.items()
    value = outcome.get("value", {})
    ((_, response),) = value.items()
    for element in response["protocolIEs"]:
        if element["id"] in _RESPONSE_LISTS:
            return {"TRP-MeasurementResponseList": next(iter(element["value"].values()))}
    raise FileFormatError(f"expected a measurement response or report, got {kind} {_named(value)}")


def _json(value: Any) -> Any:
    """A decoded value as the JSON of its elements: a chosen alternative is an object of one member."""
    if isinstance(value, dict):
        return {name: _json(content) for name, content in value.items()}
    if isinstance(value, list):
        return [_json(content) for content in value]
    if isinstance(value, tuple) and len(value) == 2 and isinstance(value[0], str):
        return {value[0]: _json(value[1])}
    return value


def _at(content: Any, *names: str) -> Any:
    """What stands under names one below the other; None if something is missing."""
    for name in names:
        content = content.get(name) if isinstance(content, dict) else None
    return content


def _named(content: Any) -> str:
    """The names of what is there, for a message."""
    return ", ".join(map(str, content))[:100] if isinstance(content, dict) else "nothing"
