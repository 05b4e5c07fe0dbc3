"""XML of strangers: read without document types, entities and anything outside of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from estimator.errors import FileFormatError
from raytrace.importers.drawing import require_package

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

__all__ = ["parse_xml"]


def parse_xml(data: bytes) -> Element:
    """The root element of an XML text; raises FileFormatError if it is none, or not safe."""
    require_package("defusedxml")
    from xml.etree.ElementTree import ParseError

    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import fromstring

    try:
        root: Element = fromstring(data, forbid_dtd=True, forbid_entities=True, forbid_external=True)
    except DefusedXmlException as error:
        raise FileFormatError(f"expected XML without document type and entities, got {error}") from error
    except (ParseError, ValueError, LookupError, RecursionError) as error:
        raise FileFormatError(f"expected XML, could not read it: {error}") from error
    return root
