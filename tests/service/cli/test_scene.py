"""The commands of scenes: what they print and write, and how they refuse."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import ezdxf
import pytest

from raytrace.plan.files import load_floorplan
from raytrace.plan.random_plans import KINDS

Runner = Callable[..., SimpleNamespace]

ROOM = {
    "type": "Feature",
    "properties": {"name": "brick room"},
    "geometry": {"type": "Polygon", "coordinates": [[[0, 0], [9, 0], [9, 6], [0, 6], [0, 0]]]},
}


def assert_refused(run: SimpleNamespace, *words: str) -> None:
    assert run.status == 2
    assert run.out == ""
    (line,) = run.err.splitlines()
    assert line.startswith("hapslam: error: ")
    for word in words:
        assert word in line


@pytest.mark.parametrize(
    "command", ["check", "show", "random", "import", "export", "schema", "profile", "sweep"]
)
def test_help_has_examples(main: Runner, command: str) -> None:
    """Each command explains itself, with examples that call it."""
    run = main("scene", command, "--help")
    assert run.status == 0
    assert f"$ hapslam scene {command}" in run.out


def test_check_sums_up(main: Runner) -> None:
    """For people a line each, for programs an object with the same numbers."""
    run = main("scene", "check", "hall")
    assert (run.status, run.err) == (0, "")
    assert "walls          36" in run.out
    numbers = json.loads(main("scene", "check", "hall", "--json").out)
    assert numbers["walls"] == 36
    assert numbers["area_m2"] == pytest.approx(1000.0)
    assert_refused(main("scene", "check", "nowhere"), "nowhere: expected a floor plan file or one of")


@pytest.mark.parametrize("kind", KINDS)
def test_random_writes_a_plan(main: Runner, kind: str, tmp_path: Path) -> None:
    """The plan is valid, named like its file, a function of the seed, and never overwrites."""
    files = [tmp_path / f"{name}.toml" for name in "abc"]
    for file, seed in zip(files, (3, 3, 4), strict=True):
        run = main("scene", "random", "--seed", seed, "--kind", kind, "--out", file)
        assert (run.status, run.err) == (0, "")
    plans = [load_floorplan(file) for file in files]
    assert [plan.name for plan in plans] == ["a", "b", "c"]
    assert plans[0].walls == plans[1].walls != plans[2].walls
    assert_refused(main("scene", "random", "--kind", kind, "--out", files[0]), "expected a name that is free")


def test_random_refuses_unknown_kinds(main: Runner, tmp_path: Path) -> None:
    """The message lists what there is, and nothing is written."""
    out = tmp_path / "x.toml"
    assert_refused(
        main("scene", "random", "--kind", "castle", "--out", out), "expected one of rectangle", "castle"
    )
    assert not out.exists()


def test_show_draws(main: Runner, tmp_path: Path) -> None:
    """The plan, the paths at an epoch, and the power; in the form that the name asks for."""
    for index, options in enumerate(([], ["--paths", 3], ["--coverage", "--depth", 0])):
        out = tmp_path / f"{index}.svg"
        run = main("scene", "show", "l-room", "--out", out, *options)
        assert (run.status, run.out) == (0, f"{out}\n")
        assert b"<svg" in out.read_bytes()[:1000]
    assert_refused(main("scene", "show", "l-room", "--out", tmp_path / "x.gif"), ".png, .svg, .pdf")
    assert_refused(main("scene", "show", "l-room", "--paths", 1, "--coverage"), "got both")
    assert_refused(main("scene", "show", "l-room", "--paths", 999), "epoch: expected 0 to 235, got 999")


def test_show_names_the_picture_itself(main: Runner, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without --out the picture is named like the scene, in the folder where one is."""
    monkeypatch.chdir(tmp_path)
    assert main("scene", "show", "l-room").out == "l-room.png\n"
    assert (tmp_path / "l-room.png").read_bytes().startswith(b"\x89PNG")


def test_import_makes_a_plan_and_reports(main: Runner, tmp_path: Path) -> None:
    """The plan loads, the report is told, options reach the importer, and nothing is overwritten."""
    drawing, out = tmp_path / "room.geojson", tmp_path / "room.toml"
    drawing.write_text(json.dumps(ROOM))
    run = main("scene", "import", drawing, "--out", out)
    assert (run.status, run.err) == (0, "")
    assert "Polygon as brick" in run.out
    plan = load_floorplan(out)
    assert plan.name == "room"
    assert {wall.material for wall in plan.walls} == {"brick"}
    assert_refused(main("scene", "import", drawing, "--out", out), "expected a name that is free")
    arguments = ["--layer", "brick*=glass", "--unit", "ft", "--height", 2.5, "--thickness", 0.01, "--json"]
    run = main("scene", "import", drawing, "--out", tmp_path / "feet.toml", *arguments)
    assert json.loads(run.out)["kept"] == {"Polygon as glass": 1}
    wall = load_floorplan(tmp_path / "feet.toml").walls[0]
    assert (wall.material, wall.height_m, wall.thickness_m) == ("glass", 2.5, 0.01)
    assert max(*wall.from_m, *wall.to_m) == pytest.approx(9 * 0.3048)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--layer", "brick"], ["--layer: expected PATTERN=MATERIAL, got 'brick'"]),
        (["--layer", "brick*=jelly"], ["expected one of vacuum, concrete", "got 'jelly'"]),
        (["--unit", "furlong"], ["unit: expected one of m, dm", "got 'furlong'"]),
        (["--height", "-1"], ["height_m: expected metres above 0"]),
        (["--up", "x"], ["up: expected 'z' or 'y', got 'x'"]),
        (["--mesh", "wall.ply"], ["expected meshes with a Mitsuba scene"]),
    ],
)
def test_import_refuses_bad_options(
    main: Runner, tmp_path: Path, arguments: list[str], words: list[str]
) -> None:
    """One line says what was expected; nothing is written."""
    drawing, out = tmp_path / "room.geojson", tmp_path / "room.toml"
    drawing.write_text(json.dumps(ROOM))
    assert_refused(main("scene", "import", drawing, "--out", out, *arguments), *words)
    assert not out.exists()


def test_schema_is_a_schema(main: Runner) -> None:
    """What is printed is JSON and describes the plan's parts."""
    schema = json.loads(main("scene", "schema").out)
    assert schema["$schema"].startswith("https://json-schema.org/")
    assert {"walls", "anchors", "agent", "radio", "echo"} <= schema["properties"].keys()
    assert schema["additionalProperties"] is False


def test_datasets_are_drawn(main: Runner, demo: tuple[Path, SimpleNamespace], tmp_path: Path) -> None:
    """Power over delay along the way, and the echo over range and angle."""
    for command in ("profile", "sweep"):
        out = tmp_path / f"{command}.png"
        run = main("scene", command, demo[0] / "dataset", "--out", out)
        assert (run.status, run.out) == (0, f"{out}\n")
        assert out.stat().st_size > 10_000
    assert_refused(
        main("scene", "sweep", demo[0] / "dataset", "--number", 5), "sweep: expected 0 to 0, got 5"
    )
    assert_refused(main("scene", "profile", tmp_path), "expected a dataset directory")


def drawn(path: Path) -> Path:
    """A room with a door's gap and a shaft, as DXF."""
    document = ezdxf.new()
    document.header["$INSUNITS"] = 6
    space, wall = document.modelspace(), {"layer": "WALLS"}
    space.add_lwpolyline([(0, 3), (0, 5), (8, 5), (8, 0), (0, 0), (0, 2)], dxfattribs=wall)
    space.add_lwpolyline([(5, 2), (6.5, 2), (6.5, 3.5), (5, 3.5)], close=True, dxfattribs=wall)
    space.add_text("[bold]room", dxfattribs={"layer": "NOTES [1]"})
    space.add_line((0, -2), (8, -2), dxfattribs={"layer": "NOTES [1]"})
    document.saveas(path)
    return path


def test_inspect_tells_before_anything_is_imported(main: Runner, tmp_path: Path) -> None:
    """Layers with their lines and what they would be, unit, extent, and a picture."""
    path = drawn(tmp_path / "room.dxf")
    run = main("scene", "inspect", path, "--out", tmp_path / "new" / "room.png")
    assert run.status == 0, run.err
    assert "layer      WALLS: 9 lines, 31 m, concrete" in run.out
    assert "layer      NOTES [1]: 1 lines, 8 m, left out" in run.out
    assert "unit m, from the header" in run.out
    assert (tmp_path / "new" / "room.png").stat().st_size > 5000
    facts = json.loads(main("scene", "inspect", path, "--json").out)
    assert facts["extent_m"] == [8.0, 7.0]
    assert facts["layers"]["WALLS"]["taken_as"] == "concrete"
    assert facts["problem"] == ""


def test_inspect_tells_levels_and_problems(main: Runner, tmp_path: Path) -> None:
    """Of a file with several levels the levels are told, and what an import would end with."""
    ring = [[0, 0], [8, 0], [8, 5], [0, 5], [0, 0]]
    features = [
        {
            "type": "Feature",
            "properties": {"level": level},
            "geometry": {"type": "Polygon", "coordinates": [ring]},
        }
        for level in ("0", "1")
    ]
    path = tmp_path / "mall.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    run = main("scene", "inspect", path)
    assert run.status == 0
    assert "levels     0, 1" in run.out
    assert "problem    levels: expected one level" in run.out
    assert main("scene", "import", path, "--level", "1", "--out", tmp_path / "first.toml").status == 0


def test_the_walk_is_in_the_room_and_not_in_the_shaft(main: Runner, tmp_path: Path) -> None:
    """A room with a gap for a door is where the agent walks, though the shaft in it is closed."""
    run = main("scene", "import", drawn(tmp_path / "room.dxf"), "--out", tmp_path / "room.toml")
    assert run.status == 0, run.err
    assert "m2 inside" in run.out
    track = load_floorplan(tmp_path / "room.toml").track()
    assert ((track[:, 0] > 0) & (track[:, 0] < 8) & (track[:, 1] > 0) & (track[:, 1] < 5)).all()
    assert not ((track[:, 0] > 5) & (track[:, 0] < 6.5) & (track[:, 1] > 2) & (track[:, 1] < 3.5)).any()


def test_walk_and_anchors_by_option(main: Runner, tmp_path: Path) -> None:
    """Way-points and anchors of the user's are taken as they are; what is no point is told."""
    path, out = drawn(tmp_path / "room.dxf"), tmp_path / "room.toml"
    options = ("--walk", "1,1 4,1 4,4", "--anchor", "2,4,2.2", "--anchor", "7,1")
    run = main("scene", "import", path, *options, "--out", out)
    assert run.status == 0, run.err
    plan = load_floorplan(out)
    assert plan.agent.waypoints_m == ((1.0, 1.0), (4.0, 1.0), (4.0, 4.0))
    assert [anchor.position_m for anchor in plan.anchors] == [(2.0, 4.0, 2.2), (7.0, 1.0, 2.4)]
    bad = main("scene", "import", path, "--walk", "1,1 here", "--out", tmp_path / "b.toml")
    assert (bad.status, "--walk: expected X,Y in metres, got 'here'" in bad.err) == (2, True)


def test_repairs_are_told(main: Runner, tmp_path: Path) -> None:
    """`check` says which walls were made one on loading."""
    text = (Path(__file__).parents[3] / "scenes" / "l-room.toml").read_text()
    first = text[text.index("[[walls]]") : text.index("[[walls]]", text.index("[[walls]]") + 1)]
    name = first[first.index('name = "') + 8 :].split('"')[0]
    path = tmp_path / "twice.toml"
    path.write_text(text.replace("[[walls]]", first.replace(name, "twin") + "[[walls]]", 1))
    run = main("scene", "check", path)
    assert run.status == 0, run.err
    assert f"walls 'twin' and '{name}' lie on one another: made one" in run.out


def test_a_plan_becomes_a_scene(main: Runner, tmp_path: Path) -> None:
    """Scene, meshes and devices; a folder that is there is left alone."""
    run = main("scene", "export", "l-room-hard", "--out", tmp_path / "scene")
    assert run.status == 0, run.err
    assert len(list((tmp_path / "scene" / "meshes").iterdir())) == 8
    assert "itu-radio-material" in (tmp_path / "scene" / "scene.xml").read_text()
    assert set(json.loads((tmp_path / "scene" / "devices.json").read_text())["anchors"]) == {"pa1", "pa2"}
    assert_refused(
        main("scene", "export", "l-room", "--out", tmp_path / "scene"), "expected a name that is free"
    )
