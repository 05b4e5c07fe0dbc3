"""What an IFC file holds: storeys, elements with their triangles and materials, and antennas.

The file is parsed and its shapes are made by IfcOpenShell, in a process of its own: compiled code that
a damaged file can bring down, or keep busy for ever, must not take the program with it. What comes back
are arrays and texts.
"""

from __future__ import annotations

import io
import json
import math
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.errors import BackendError, FileFormatError

__all__ = ["IfcElement", "IfcModel", "Storey", "load_model", "model_in"]

Array = NDArray[np.float64]

# Making the shapes of a large building takes minutes; a file that takes longer is not one floor's plan.
_MOST_SECONDS = 600.0
# Triangles of the elements that are kept; three times nine numbers of eight bytes each.
_MOST_FACES = 2_000_000
# Classes that a wave meets, or that open what it meets; what else stands about is furniture or services.
_BUILT = (
    "IfcWall", "IfcColumn", "IfcCurtainWall", "IfcPlate", "IfcMember", "IfcBuildingElementPart", "IfcSlab",
    "IfcCovering", "IfcWindow", "IfcDoor", "IfcChimney", "IfcShadingDevice", "IfcBuildingElementProxy",
)  # fmt: skip
_REMEDY = "pip install 'hapslam[ifc]'"
_REFUSED = 3  # exit status of the process if the file is no IFC


@dataclass(frozen=True)
class Storey:
    """A storey: its name, and the height of its floor in the model, metres."""

    name: str
    elevation_m: float


@dataclass(frozen=True, eq=False)
class IfcElement:
    """A part of a building.

    Parameters
    ----------
    kind : str
        Its IFC class without a suffix ``StandardCase`` or ``ElementedCase``.
    name : str
        What the drawing program called it.
    materials : tuple of str
        Names of its materials, the thickest layer first.
    triangles : ndarray, shape (n, 3, 3)
        Its faces, openings cut out, metres.
    """

    kind: str
    name: str
    materials: tuple[str, ...]
    triangles: Array


@dataclass(frozen=True, eq=False)
class IfcModel:
    """A building.

    Parameters
    ----------
    schema : str
        Version of IFC.
    storeys : tuple of Storey
        From the lowest to the highest.
    elements : tuple of IfcElement
        What is built.
    others : mapping of str to int
        How many elements of which classes were left out.
    antennas : tuple of (str, tuple)
        Name and place (x, y, z) of communication appliances, metres.
    georeference : tuple or None
        Name of the coordinate reference system and the place in it of the model's (0, 0); None if there
        is none, or the model is turned in it.
    """

    schema: str
    storeys: tuple[Storey, ...]
    elements: tuple[IfcElement, ...]
    others: dict[str, int]
    antennas: tuple[tuple[str, tuple[float, float, float]], ...] = ()
    georeference: tuple[str, tuple[float, float]] | None = None


@lru_cache(maxsize=1)  # a file is asked for its levels, and then for one of them
def load_model(data: bytes, seconds: float = _MOST_SECONDS) -> IfcModel:
    """What an IFC file holds, read in a process of its own.

    Parameters
    ----------
    data : bytes
        Contents of the file.
    seconds : float
        So long it may take.

    Raises
    ------
    FileFormatError
        If it is no IFC, brings the reader down or takes too long.
    BackendError
        If IfcOpenShell is not installed.
    """
    from importlib.util import find_spec

    if find_spec("ifcopenshell") is None:
        raise BackendError(f"expected the package 'ifcopenshell', it is not installed: {_REMEDY}")
    root = str(Path(__file__).resolve().parents[2])
    code = f"import sys; sys.path.insert(0, {root!r}); from raytrace.importers.ifc_model import main; main()"
    with TemporaryDirectory(prefix="hapslam-ifc-") as folder:
        drawn, made = Path(folder, "model.ifc"), Path(folder, "model.npz")
        drawn.write_bytes(data)
        try:
            done = subprocess.run(
                [sys.executable, "-c", code, str(drawn), str(made)],
                capture_output=True,
                timeout=seconds,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise FileFormatError(
                f"expected a model whose shapes are made within {seconds:g} s, it takes longer: "
                "export one storey, or walls, doors and windows alone"
            ) from None
        if done.returncode == _REFUSED:
            raise FileFormatError(made.read_text(encoding="utf-8"))
        if done.returncode:
            ended = f"signal {-done.returncode}" if done.returncode < 0 else f"status {done.returncode}"
            raise FileFormatError(f"expected a whole IFC file, reading it ended with {ended}")
        return _unpacked(made.read_bytes())


def main() -> None:
    """Read the file that the first argument names, and write what it holds to the second."""
    drawn, made = Path(sys.argv[1]), Path(sys.argv[2])
    try:
        made.write_bytes(_packed(model_in(drawn.read_bytes())))
    except FileFormatError as error:
        made.write_text(str(error), encoding="utf-8")
        sys.exit(_REFUSED)


def _packed(model: IfcModel) -> bytes:
    """A model as the bytes of an .npz file."""
    facts = {
        **asdict(replace(model, elements=())),
        "elements": [(e.kind, e.name, e.materials) for e in model.elements],
    }
    counts = [len(element.triangles) for element in model.elements]
    triangles = np.concatenate([np.empty((0, 3, 3)), *(e.triangles for e in model.elements)])
    stream = io.BytesIO()
    text = np.frombuffer(json.dumps(facts).encode("utf-8"), dtype=np.uint8)
    np.savez(stream, facts=text, counts=np.array(counts, dtype=np.int64), triangles=triangles)
    return stream.getvalue()


def _unpacked(data: bytes) -> IfcModel:
    """The inverse of :func:`_packed`."""
    with np.load(io.BytesIO(data)) as arrays:
        facts = json.loads(bytes(arrays["facts"]))
        parts = np.split(arrays["triangles"], np.cumsum(arrays["counts"])[:-1])
    place = facts["georeference"]
    return IfcModel(
        schema=facts["schema"],
        storeys=tuple(Storey(**storey) for storey in facts["storeys"]),
        elements=tuple(
            IfcElement(kind, name, tuple(materials), triangles)
            for (kind, name, materials), triangles in zip(facts["elements"], parts, strict=False)
        ),
        others=facts["others"],
        antennas=tuple((name, (x, y, z)) for name, (x, y, z) in facts["antennas"]),
        georeference=None if place is None else (place[0], (place[1][0], place[1][1])),
    )


def model_in(data: bytes) -> IfcModel:
    """What an IFC file holds, read in this process.

    Raises
    ------
    FileFormatError
        If it is no IFC, or has too many faces.
    """
    import ifcopenshell
    import ifcopenshell.util.element
    import ifcopenshell.util.placement
    import ifcopenshell.util.unit

    try:
        file = ifcopenshell.file.from_string(data.decode("utf-8-sig", errors="replace"))
        unit = float(ifcopenshell.util.unit.calculate_unit_scale(file))
        chosen = [element for kind in _BUILT for element in _by_type(file, kind)]
        names = {element.id(): element for element in chosen}
        shapes = list(_shapes(file, list(names.values())))
        storeys = [
            Storey(str(storey.Name or f"storey {number}"), _height(storey, unit))
            for number, storey in enumerate(_by_type(file, "IfcBuildingStorey"), 1)
        ]
        with_shape = {identity for identity, _ in shapes}
        others = Counter(
            _kind(element)
            for element in _by_type(file, "IfcElement")
            if element.id() not in with_shape and not element.is_a("IfcFeatureElement")
        )
        antennas = [
            (str(thing.Name or "antenna")[:100], _place(thing, unit))
            for thing in _by_type(file, "IfcCommunicationsAppliance")
        ]
        return IfcModel(
            schema=str(file.schema),
            storeys=tuple(sorted(_told_apart(storeys), key=lambda storey: storey.elevation_m)),
            elements=tuple(
                IfcElement(
                    _kind(names[identity]),
                    str(names[identity].Name or "unnamed"),
                    tuple(_materials(names[identity])),
                    triangles,
                )
                for identity, triangles in shapes
            ),
            others=dict(sorted(others.items())),
            antennas=tuple(antennas),
            georeference=_georeference(file),
        )
    except FileFormatError:
        raise
    except Exception as error:  # errors of many kinds on damaged files
        text = f"{type(error).__name__}: {error}".split("\n")[0][:120]
        raise FileFormatError(f"expected an IFC file (STEP), could not read it: {text}") from error


def _by_type(file: Any, kind: str) -> list[Any]:
    """Entities of a class and of what is derived from it; none if this version has no such class."""
    try:
        return list(file.by_type(kind))
    except RuntimeError:
        return []


def _kind(element: Any) -> str:
    return str(element.is_a()).removesuffix("StandardCase").removesuffix("ElementedCase")


def _shapes(file: Any, elements: list[Any]) -> Iterator[tuple[int, Array]]:
    """Identity and triangles (n, 3, 3) of the elements that have a body, metres."""
    import ifcopenshell.geom

    settings = ifcopenshell.geom.settings()
    settings.set("use-world-coords", True)
    if not elements:
        return
    shapes = ifcopenshell.geom.iterator(settings, file, 1, include=elements)
    going, faces = shapes.initialize(), 0
    while going:
        shape = shapes.get()
        vertices = np.array(shape.geometry.verts, dtype=np.float64).reshape(-1, 3)
        corners = np.array(shape.geometry.faces, dtype=np.int64).reshape(-1, 3)
        faces += len(corners)
        if faces > _MOST_FACES:
            raise FileFormatError(
                f"expected at most {_MOST_FACES} faces of walls, doors and windows, got more"
            )
        if not np.isfinite(vertices).all():
            raise FileFormatError(f"{shape.name}: expected finite coordinates, got NaN or infinity")
        if len(corners):
            yield int(shape.id), vertices[corners]
        going = shapes.next()


def _place(thing: Any, unit: float) -> tuple[float, float, float]:
    """Where the origin of an object is in the model, metres."""
    from ifcopenshell.util.placement import get_local_placement

    x, y, z = (float(value) * unit for value in get_local_placement(thing.ObjectPlacement)[:3, 3])
    return x, y, z


def _height(storey: Any, unit: float) -> float:
    """Height of a storey's floor, metres: that of its placement, to which its elements refer."""
    if storey.ObjectPlacement is None:
        return float(storey.Elevation or 0.0) * unit
    return _place(storey, unit)[2]


def _told_apart(storeys: list[Storey]) -> list[Storey]:
    """Storeys of one name have their heights in it."""
    count = Counter(storey.name for storey in storeys)
    return [
        storey
        if count[storey.name] == 1
        else Storey(f"{storey.name} ({storey.elevation_m:g} m)", storey.elevation_m)
        for storey in storeys
    ]


def _materials(element: Any) -> list[str]:
    """Names of an element's materials, the thickest layer first."""
    from ifcopenshell.util.element import get_material, get_materials

    material = get_material(element, should_skip_usage=True)
    if material is not None and material.is_a("IfcMaterialLayerSet"):
        layers = sorted(material.MaterialLayers, key=lambda layer: -float(layer.LayerThickness or 0.0))
        return [str(layer.Material.Name) for layer in layers if layer.Material is not None]
    return [str(one.Name) for one in get_materials(element) if getattr(one, "Name", None)]


def _georeference(file: Any) -> tuple[str, tuple[float, float]] | None:
    """The reference system that the file states, and where the model's (0, 0) is in it."""
    for conversion in _by_type(file, "IfcMapConversion"):
        turned = math.atan2(conversion.XAxisOrdinate or 0.0, conversion.XAxisAbscissa or 1.0)
        if abs(turned) < 1e-9:
            crs = str(conversion.TargetCRS.Name or "unknown")[:200]
            return crs, (float(conversion.Eastings), float(conversion.Northings))
    return None
