"""PLY and Mitsuba scenes: solid rooms, cut to plans, and files that are no such thing."""

from __future__ import annotations

import struct
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from estimator.errors import InputError
from raytrace.importers.convert import Imported, import_floorplan
from raytrace.importers.options import ImportOptions


def slab(x0: float, y0: float, x1: float, y1: float, z0: float = 0.0, z1: float = 2.8) -> trimesh.Trimesh:
    extents = (x1 - x0, y1 - y0, z1 - z0)
    middle = (0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * (z0 + z1))
    return trimesh.creation.box(extents, trimesh.transformations.translation_matrix(middle))


def house() -> trimesh.Trimesh:
    """A solid room of 8 m x 6 m with walls of 0.2 m, a doorway with a lintel inside, floor and ceiling."""
    return trimesh.util.concatenate(
        [
            slab(0, 0, 8, 0.2),
            slab(0, 5.8, 8, 6),
            slab(0, 0.2, 0.2, 5.8),
            slab(7.8, 0.2, 8, 5.8),
            slab(4, 0.2, 4.1, 2.0),
            slab(4, 3.0, 4.1, 5.8),
            slab(4, 2.0, 4.1, 3.0, 2.1, 2.8),
            slab(0, 0, 8, 6, -0.1, 0.0),
            slab(0, 0, 8, 6, 2.8, 2.9),
        ]
    )


def ends(made: Imported) -> set[frozenset[tuple[float, float]]]:
    return {frozenset((round(x, 3), round(y, 3)) for x, y in (w.from_m, w.to_m)) for w in made.plan.walls}


ROOM = {
    frozenset([(0.1, 0.1), (7.9, 0.1)]),
    frozenset([(7.9, 0.1), (7.9, 5.9)]),
    frozenset([(0.1, 5.9), (7.9, 5.9)]),
    frozenset([(0.1, 0.1), (0.1, 5.9)]),
    frozenset([(4.05, 0.1), (4.05, 2.0)]),
    frozenset([(4.05, 3.0), (4.05, 5.9)]),
}


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
@pytest.mark.parametrize(("unit", "up"), [("m", "z"), ("cm", "y")])
def test_a_solid_house_is_its_plan(encoding: str, unit: str, up: str, tmp_path: Path) -> None:
    """Cut at eye height: centre lines with thickness, an open doorway, floor and ceiling."""
    mesh = house()
    if up == "y":
        mesh.vertices = mesh.vertices[:, [0, 2, 1]] * (1, 1, -1)
    mesh.vertices *= {"m": 1.0, "cm": 100.0}[unit]
    path = tmp_path / "brick-house.ply"
    path.write_bytes(mesh.export(file_type="ply", encoding=encoding))
    made = import_floorplan(path, ImportOptions(unit=unit, up=up))  # type: ignore[arg-type]
    assert ends(made) == ROOM
    assert {wall.material for wall in made.plan.walls} == {"brick"}
    assert {round(wall.thickness_m, 3) for wall in made.plan.walls} == {0.1, 0.2}
    assert made.plan.has_floor
    assert made.plan.has_ceiling
    assert made.drawing.report.dropped["upright face of brick-house, below or above the cut"] > 0


def scene(*shapes: str, head: str = "") -> str:
    return f'<scene version="3.0.0">{head}{"".join(shapes)}</scene>'


def rectangle(name: str, x: float, y: float, half: float, turn: float, bsdf: str = "") -> str:
    """A wall 3 m high: the unit square scaled, raised, turned about z and moved to its middle."""
    return (
        f'<shape type="rectangle" id="{name}"><transform name="to_world">'
        f'<scale x="{half}" y="1.5"/><rotate x="1" angle="90"/><translate z="1.5"/>'
        f'<rotate z="1" angle="{turn}"/><translate value="{x}, {y}, 0"/></transform>{bsdf}</shape>'
    )


def four_walls(bsdf: str = "") -> list[str]:
    return [
        rectangle("south", 4, 0, 4, 0, bsdf),
        rectangle("north", 4, 6, 4, 180, bsdf),
        rectangle("west", 0, 3, 3, 90, bsdf),
        rectangle("east", 8, 3, 3, 90, bsdf),
    ]


def test_a_scene_of_rectangles(tmp_path: Path) -> None:
    """Transforms apply in their order, materials are those of the BSDFs, defaults are filled in."""
    head = (
        '<default name="reach" value="4"/>'
        '<bsdf type="twosided" id="mat-itu_brick"><bsdf type="diffuse"/></bsdf>'
        '<bsdf type="itu-radio-material" id="panel"><string name="type" value="glass"/></bsdf>'
        '<sensor type="perspective"/><emitter type="constant"/>'
    )
    walls = four_walls('<ref id="mat-itu_brick"/>')
    walls[0] = walls[0].replace('x="4"', 'x="$reach"').replace("mat-itu_brick", "panel")
    path = tmp_path / "room.xml"
    path.write_text(scene(*walls, head=head))
    made = import_floorplan(path)
    corners = [(0.0, 0.0), (8.0, 0.0), (8.0, 6.0), (0.0, 6.0)]
    expected = {frozenset(pair) for pair in zip(corners, corners[1:] + corners[:1], strict=True)}
    assert ends(made) == expected
    assert sorted(wall.material for wall in made.plan.walls) == ["brick", "brick", "brick", "glass"]
    assert {wall.height_m for wall in made.plan.walls} == {3.0}
    assert made.drawing.report.dropped["<sensor>"] == 1


def test_meshes_are_read_only_if_given(tmp_path: Path) -> None:
    """A mesh that the scene names is dropped and told, though it lies there; given, it is read."""
    (tmp_path / "meshes").mkdir()
    mesh = tmp_path / "meshes" / "inner.ply"
    mesh.write_bytes(slab(4, 2, 4.1, 6.0, 0, 3).export(file_type="ply"))
    inner = '<shape type="ply" id="inner"><string name="filename" value="meshes/inner.ply"/></shape>'
    path = tmp_path / "room.xml"
    path.write_text(scene(*four_walls(), inner))
    without = import_floorplan(path)
    assert len(without.plan.walls) == 4
    assert without.drawing.report.dropped["mesh inner.ply, which was not given"] == 1
    given = import_floorplan(path, meshes=[mesh])
    assert frozenset([(4.05, 2.0), (4.05, 6.0)]) in ends(given)


def test_nothing_that_a_scene_names_is_opened(
    tmp_path: Path, opened_files: Callable[[], AbstractContextManager[list[str]]]
) -> None:
    """Scenes to include, meshes, textures and plug-ins by name: reported, and left alone."""
    for name in ("other.xml", "inner.ply", "wood.png", "sky.exr"):
        (tmp_path / name).write_text("not to be read")
    named = (
        '<include filename="other.xml"/><path value="."/>',
        '<shape type="ply"><string name="filename" value="inner.ply"/></shape>',
        '<shape type="obj"><string name="filename" value="/etc/passwd"/></shape>',
        '<texture type="bitmap" id="wood"><string name="filename" value="wood.png"/></texture>',
        '<emitter type="envmap"><string name="filename" value="sky.exr"/></emitter>',
    )
    path = tmp_path / "room.xml"
    path.write_text(scene(*four_walls(), *named))
    import_floorplan(path)  # what a first import loads is not of interest
    with opened_files() as opened:
        made = import_floorplan(path)
    assert set(opened) == {str(path)}
    assert len(made.plan.walls) == 4
    dropped = made.drawing.report.dropped
    assert dropped["<include>"] == dropped["<path>"] == dropped["<texture>"] == dropped["<emitter>"] == 1
    assert dropped["mesh inner.ply, which was not given"] == 1


def test_a_cube_is_four_walls(tmp_path: Path) -> None:
    """A scaled cube is cut to a column; its own name gives the material."""
    cube = (
        '<shape type="cube" id="steel-rack"><transform name="to_world">'
        '<scale value="1 0.5 1"/><translate x="4" y="3" z="1"/></transform></shape>'
    )
    path = tmp_path / "room.xml"
    path.write_text(scene(*four_walls(), cube))
    metal = [wall for wall in import_floorplan(path).plan.walls if wall.material == "metal"]
    assert len(metal) == 4
    assert {end for wall in metal for end in (wall.from_m, wall.to_m)} == {
        (3, 2.5),
        (5, 2.5),
        (5, 3.5),
        (3, 3.5),
    }


BOMB = (
    '<?xml version="1.0"?><!DOCTYPE scene [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
    '<scene version="3.0.0"><shape type="&b;"/></scene>'
)
LEAK = (
    '<?xml version="1.0"?><!DOCTYPE scene [<!ENTITY a SYSTEM "file:///etc/passwd">]>'
    '<scene version="3.0.0"><shape type="&a;"/></scene>'
)
WALL = four_walls()[0]
BAD_SCENES: dict[str, tuple[str | bytes, str]] = {
    "nothing": ("", "got an empty file"),
    "prose": ("four walls and a door", "expected XML"),
    "binary": (bytes(range(200)), "expected XML"),
    "a stump": (scene(WALL)[:80], "expected XML"),
    "tags that cross": ("<scene><shape></scene></shape>", "expected XML"),
    "an unknown encoding": ('<?xml version="1.0" encoding="klingon"?><scene/>', "expected XML"),
    "entities": (BOMB, "without document type and entities"),
    "an entity of a file": (LEAK, "without document type and entities"),
    "a document type": ('<!DOCTYPE scene SYSTEM "scene.dtd"><scene/>', "without document type"),
    "a web page": ("<html><body/></html>", "expected a <scene>, got <html>"),
    "an empty scene": (scene(), "expected shapes that can be read, got none: the scene has none"),
    "spheres": (scene('<shape type="sphere"/>'), "shape of type sphere"),
    "a mesh that was not given": (
        scene('<shape type="ply"><string name="filename" value="/etc/passwd"/></shape>'),
        "mesh passwd, which was not given",
    ),
    "a mesh without a name": (scene('<shape type="ply"/>'), "expected a string 'filename'"),
    "a scale in words": (
        scene(WALL.replace('x="4"', 'x="wide"', 1)),
        "expected 1 finite numbers, got 'wide'",
    ),
    "two numbers for three": (scene(WALL.replace("4, 0, 0", "4, 0")), "expected 1 or 3 finite numbers"),
    "not a number": (scene(WALL.replace("4, 0, 0", "nan, 0, 0")), "finite numbers, got 'nan, 0, 0'"),
    "a rotation about nothing": (scene(WALL.replace('<rotate x="1"', '<rotate x="0"')), "expected an axis"),
    "no angle": (scene(WALL.replace('angle="90"', "")), "rotate: expected 1 finite numbers, got ''"),
    "a matrix of three": (
        scene('<shape type="cube"><transform name="to_world"><matrix value="1 2 3"/></transform></shape>'),
        "matrix: expected 9 or 16 finite numbers",
    ),
    "an unknown step": (
        scene(WALL.replace("<scale", "<shear")),
        "expected translate, scale, rotate or matrix",
    ),
    "a default that is missing": (scene(WALL.replace('x="4"', 'x="$w"', 1)), "expected a <default> for $w"),
    "a floor alone": (scene('<shape type="rectangle"/>'), "expected vertical faces"),
}


def assert_told(path: Path, message: str) -> None:
    with pytest.raises(InputError) as caught:
        import_floorplan(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert message in text
    assert "expected" in text
    assert len(text) < 500


@pytest.mark.parametrize("name", BAD_SCENES)
def test_malformed_scenes_are_told_in_one_line(name: str, tmp_path: Path) -> None:
    """Each says the file, the shape, what was expected and what came; entities are never expanded."""
    content, message = BAD_SCENES[name]
    path = tmp_path / "bad.xml"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    assert_told(path, message)


def ply(vertices: Any, faces: Any) -> bytes:
    """An ASCII file of numbers as they come, right or wrong."""
    rows = [" ".join(map(str, row)) for row in vertices] + [
        f"{len(f)} " + " ".join(map(str, f)) for f in faces
    ]
    return (
        f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
        + "\n".join(rows)
        + "\n"
    ).encode()


def binary_house() -> bytes:
    return bytes(house().export(file_type="ply"))


SQUARE = [(0, 0, 0), (5, 0, 0), (5, 0, 3), (0, 0, 3)]
QUAD = [(0, 1, 2, 3)]
BAD_MESHES: dict[str, tuple[Callable[[], bytes], str]] = {
    "nothing": (lambda: b"", "got an empty file"),
    "prose": (lambda: b"a mesh of walls", "starts with 'ply'"),
    "an STL": (lambda: b"solid room\nendsolid room\n", "starts with 'ply'"),
    "an XML": (lambda: b"<scene/>", "starts with 'ply'"),
    "no end of the header": (
        lambda: ply(SQUARE, QUAD).replace(b"end_header", b"the_end"),
        "ends with end_header",
    ),
    "the header alone": (lambda: b"ply\nend_header\n", "expected the PLY format"),
    "format of the future": (
        lambda: ply(SQUARE, QUAD).replace(b"ascii 1.0", b"quantum 9.1"),
        "expected the PLY format",
    ),
    "no counts": (
        lambda: ply(SQUARE, QUAD).replace(b"vertex 4", b"vertex many"),
        "element vertex: expected a count",
    ),
    "a negative count": (
        lambda: ply(SQUARE, QUAD).replace(b"face 1", b"face -1"),
        "element face: expected a count",
    ),
    "a billion vertices": (
        lambda: ply(SQUARE, QUAD).replace(b"vertex 4", b"vertex 1000000000"),
        "element vertex: expected a count that fits",
    ),
    "two billion faces": (
        lambda: binary_house().replace(b"element face ", b"element face 2000000000"),
        "element face: expected a count that fits",
    ),
    "half of it": (lambda: binary_house()[: len(binary_house()) // 2], "expected"),
    "words for numbers": (lambda: ply([("a", "b", "c"), *SQUARE[1:]], QUAD), "could not read it"),
    "no faces": (lambda: ply(SQUARE, []), "expected faces"),
    "no vertices": (lambda: ply([], []), "expected"),
    "faces of other vertices": (lambda: ply(SQUARE, [(0, 1, 9)]), "of the 4 vertices, got vertex 9"),
    "faces below zero": (lambda: ply(SQUARE, [(0, 1, -2)]), "expected faces of the 4 vertices"),
    "not a number": (lambda: ply([("nan", 0, 0), *SQUARE[1:]], QUAD), "expected finite vertices"),
    "infinite": (lambda: ply([("inf", 0, 0), *SQUARE[1:]], QUAD), "expected finite vertices"),
    "a point": (lambda: ply([(1, 1, 1)] * 4, QUAD), "expected vertical faces"),
    "a floor alone": (
        lambda: ply([(0, 0, 0), (5, 0, 0), (5, 5, 0), (0, 5, 0)], QUAD),
        "expected vertical faces",
    ),
    "a kerb": (lambda: bytes(slab(0, 0, 5, 5, 0, 0.3).export(file_type="ply")), "the model is 0.3 m high"),
    "a wrong list": (
        lambda: (
            b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
            b"property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
            + struct.pack("<fffB", 0, 0, 0, 255)
        ),
        "expected",
    ),
}


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", BAD_MESHES)
def test_malformed_meshes_are_told_in_one_line(name: str, tmp_path: Path) -> None:
    """Each says the file, what was expected and what came; counts come before memory."""
    make, message = BAD_MESHES[name]
    path = tmp_path / "bad.ply"
    path.write_bytes(make())
    assert_told(path, message)


def test_slanted_faces_are_no_walls(tmp_path: Path) -> None:
    """A pyramid in a room is dropped and told."""
    pyramid = trimesh.Trimesh(
        [(3, 2, 0), (5, 2, 0), (5, 4, 0), (3, 4, 0), (4, 3, 2.5)],
        [(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)],
        process=False,
    )
    path = tmp_path / "tent.ply"
    path.write_bytes(trimesh.util.concatenate([house(), pyramid]).export(file_type="ply"))
    made = import_floorplan(path)
    assert made.drawing.report.dropped["slanted face of tent"] == 4
    assert ends(made) == ROOM
    assert np.isfinite(made.plan.track()).all()


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".glb", ".gltf"])
def test_models_of_other_formats(suffix: str, tmp_path: Path) -> None:
    """OBJ, STL and whole glTF files give the plan of the house that is in them, y upwards in glTF."""
    sides = [(0, 0, 8, 0.2), (0, 5.8, 8, 6), (0, 0, 0.2, 6), (7.8, 0, 8, 6)]
    scene = trimesh.Scene()
    for number, (x0, y0, x1, y1) in enumerate(sides):
        material = "glass" if number == 3 else "brick"
        scene.add_geometry(slab(x0, y0, x1, y1, 0, 3), geom_name=f"{material}-{number}")
    if suffix in (".glb", ".gltf"):
        scene.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0)))
    path = tmp_path / f"house{suffix}"
    data = trimesh.util.concatenate(scene.dump()).export(file_type="stl") if suffix == ".stl" else None
    if suffix == ".gltf":
        files = trimesh.exchange.gltf.export_gltf(scene, merge_buffers=True, embed_buffers=True)
        data = files["model.gltf"]
    path.write_bytes(data if data is not None else as_bytes(scene.export(file_type=suffix[1:])))
    made = import_floorplan(path)
    assert len(made.plan.walls) == 4
    assert {wall.thickness_m for wall in made.plan.walls} == {0.2}
    if suffix != ".stl":  # it has no names
        assert sorted(wall.material for wall in made.plan.walls) == ["brick", "brick", "brick", "glass"]


def as_bytes(data: Any) -> bytes:
    return data.encode() if isinstance(data, str) else bytes(data)


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".glb", ".gltf"])
def test_damaged_models_are_told_in_one_line(suffix: str, tmp_path: Path) -> None:
    """What is no such file, or needs others beside it, is an error that names the file."""
    path = tmp_path / f"bad{suffix}"
    for data in (b"\x00\x01 nothing of the kind", b'{"buffers": [{"uri": "/etc/passwd", "byteLength": 9}]}'):
        path.write_bytes(data)
        with pytest.raises(InputError, match="bad"):
            import_floorplan(path)


def test_a_folder_of_meshes_is_given_at_once(tmp_path: Path) -> None:
    """All meshes of a scene's folder are named by one option; a folder without any is told."""
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "inner.ply").write_bytes(slab(4, 2, 4.1, 6.0, 0, 3).export(file_type="ply"))
    inner = '<shape type="ply" id="inner"><string name="filename" value="meshes/inner.ply"/></shape>'
    path = tmp_path / "room.xml"
    path.write_text(scene(*four_walls(), inner))
    made = import_floorplan(path, meshes=[tmp_path / "meshes"])
    assert frozenset([(4.05, 2.0), (4.05, 6.0)]) in ends(made)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="expected a folder with .ply files"):
        import_floorplan(path, meshes=[tmp_path / "empty"])
