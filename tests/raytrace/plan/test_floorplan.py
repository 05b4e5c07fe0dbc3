"""Floor plans: the shipped scenes, the track, and what is said about bad plans."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from estimator.errors import InputError
from raytrace.plan.files import FloorPlanError, load_floorplan, parse_floorplan, shipped_scenes, updated
from raytrace.plan.floorplan import FloorPlan


@pytest.fixture(scope="module")
def room() -> FloorPlan:
    return load_floorplan("l-room")


def square(**changes: Any) -> dict[str, Any]:
    corners = [[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]]
    walls = [
        {"name": f"w{index}", "from_m": corner, "to_m": corners[(index + 1) % 4]}
        for index, corner in enumerate(corners)
    ]
    plan = {
        "format": "hapslam-floorplan",
        "version": 1,
        "name": "square",
        "walls": walls,
        "anchors": [{"name": "pa1", "position_m": [7.0, 6.0, 2.5]}],
        "agent": {"waypoints_m": [[2.0, 3.0], [8.0, 3.0]], "smoothing_m": 0.0, "epochs": 5},
    }
    return plan | changes


def test_shipped_scenes_load() -> None:
    """Every scene that ships is valid and is named like its file."""
    assert {"l-room", "l-room-hard"} <= set(shipped_scenes())
    for name in shipped_scenes():
        assert load_floorplan(name).name == name


def test_l_room_is_the_reference_scenario(room: FloorPlan) -> None:
    """Six walls, anchors at P0, a start at (10, 15), 236 steps of half a metre at half a metre per second."""
    assert len(room.walls) == 6
    np.testing.assert_array_equal(room.anchors_m(), [[68, 6, 2.5], [42, 36, 2.5]])
    track = room.track()
    assert track.shape == (236, 3)
    np.testing.assert_array_equal(track[0], [10, 15, 1.5])
    steps = np.linalg.norm(np.diff(track, axis=0), axis=1)
    np.testing.assert_allclose(steps, 0.5, atol=1e-3)  # chords of a curve sampled by arc length
    np.testing.assert_allclose(room.times_s(), np.arange(236.0))
    assert room.radio.grid().bandwidth_hz == pytest.approx(393.12e6)
    assert not room.has_floor
    assert not room.scatters


def test_hard_room_adds_floor_ceiling_and_scattering(room: FloorPlan) -> None:
    """The hard scene differs from the plain one in slabs and scattering, not in walls, anchors or track."""
    hard = load_floorplan("l-room-hard")
    assert hard.walls == room.walls
    assert hard.anchors == room.anchors
    np.testing.assert_array_equal(hard.track(), room.track())
    assert hard.surface_names[-2:] == ("floor", "ceiling")
    assert hard.scattering == {"concrete": 0.3}
    assert hard.scatters


def test_load_by_path_and_by_name_agree(room: FloorPlan, tmp_path: Path) -> None:
    """A plan written back as TOML and read by its path is the same plan, with the same hash."""
    file = tmp_path / "copy.toml"
    file.write_bytes(tomli_w.dumps(room.model_dump(mode="json", exclude_none=True)).encode())
    again = load_floorplan(file)
    assert again == room
    assert again.sha256() == room.sha256()


def test_hash_sees_every_change(room: FloorPlan) -> None:
    """Moving one wall by a millimetre changes the hash; spelling out a default does not."""
    moved = updated(room, {"agent.height_m": 1.501})
    assert moved.sha256() != room.sha256()
    assert updated(room, {"agent.height_m": 1.5}).sha256() == room.sha256()


def test_updated_validates(room: FloorPlan) -> None:
    """Changes by dotted names are checked like a file, unknown names included."""
    short = updated(room, {"agent.epochs": 20, "echo.model": "radar-equation"})
    assert short.track().shape == (20, 3)
    assert short.echo.model == "radar-equation"
    for changes, message in (
        ({"agent.speed": 1.0}, r"agent\.speed: expected only known keys"),
        ({"agents.epochs": 3}, "agents.epochs: expected the name of a value"),
        ({"agent.epochs": 2000}, r"agent\.epochs: expected at most \d+ positions 0\.5 m apart"),
    ):
        with pytest.raises(FloorPlanError, match=message):
            updated(room, changes)


def chair(**changes: Any) -> dict[str, Any]:
    target = {"name": "chair", "position_m": [8.0, 8.0, 1.0], "rcs_m2": 1.0, **changes}
    return {key: value for key, value in target.items() if value is not None}


def walker(**changes: Any) -> dict[str, Any]:
    return {"name": "ann", "waypoints_m": [[2.0, 7.0], [8.0, 7.0]], "epochs": 5, **changes}


BAD_VALUES = [
    ({"format": "dxf"}, "format: expected 'hapslam-floorplan', got 'dxf'"),
    ({"version": 2}, "version: expected 1, got 2"),
    ({"version": True}, "version: expected 1, got True"),
    ({"name": ""}, "name: expected .*at least 1 character"),
    ({"ceilling": {}}, "ceilling: expected only known keys, got the unknown key 'ceilling'"),
    (
        {"walls.1.material": "cheese"},
        r"walls\[1\] \(w1\)\.material: expected one of vacuum, .*, got 'cheese'",
    ),
    (
        {"radio": {"carrier_hz": 105e9}},
        r"radio\.carrier_hz: concrete: expected a frequency of .* got 105 GHz",
    ),
    ({"echo": {"carrier_hz": 500e9}}, r"echo\.carrier_hz: concrete: expected a frequency of .* got 500 GHz"),
    ({"scattering": {"cheese": 0.3}}, "scattering: expected names among .*, got 'cheese'"),
    ({"scattering": {"concrete": 1.5}}, r"scattering\.concrete: expected less than or equal to 1, got 1\.5"),
    ({"walls.2.height_m": -1.0}, r"walls\[2\]\.height_m: expected greater than 0, got -1\.0"),
    ({"walls.2.height_m": float("nan")}, r"walls\[2\]\.height_m: expected a finite number, got nan"),
    ({"walls.0.from_m": [float("nan"), 0.0]}, r"walls\[0\]\.from_m\[0\]: expected a finite number, got nan"),
    ({"walls.0.from_m": [0.0]}, r"walls\[0\]\.from_m.*: expected"),
    ({"walls.3.to_m": [0.0, 10.0]}, r"walls\[3\] \(w3\): expected two ends .* zero-length wall"),
    ({"walls.3.name": "w0"}, "walls: expected names that differ, got 'w0' twice"),
    ({"walls": []}, "walls: expected .*at least 1"),
    ({"walls.0.thickness_m": "thin"}, r"walls\[0\]\.thickness_m: expected a valid number, got 'thin'"),
    ({"anchors.0.position_m": [0.05, 5.0, 2.5]}, r"anchors\[0\] \(pa1\)\.position_m: .*: it is in the wall"),
    ({"anchors.0.position_m": [5.0, 5.0, 3.5]}, "expected a height between 0 and 3 m, got 3.5 m"),
    ({"anchors.0.position_m": [2.0, 3.05, 1.5]}, "expected at least 0.1 m to the agent's track, got 0.05 m"),
    (
        {"agent.waypoints_m": [[2.0, 3.0], [18.0, 3.0]], "agent.epochs": 30},
        "'w1': the agent crosses the wall",
    ),
    ({"agent.waypoints_m": [[2.0, 3.0]]}, r"agent\.waypoints_m: expected .*at least 2"),
    (
        {"agent.waypoints_m": [[2.0, 3.0], [2.0, 3.0]]},
        r"agent\.waypoints_m\[1\]: expected a point that differs",
    ),
    ({"agent.epochs": 0}, r"agent\.epochs: expected greater than or equal to 1, got 0"),
    ({"agent.epochs": 2.5}, r"agent\.epochs: expected .*integer, got 2\.5"),
    (
        {"agent.epochs": 50},
        r"agent\.epochs: expected at most 13 positions 0\.5 m apart on a track of 6\.00 m, got 50",
    ),
    ({"agent.height_m": 3.0}, r"agent\.height_m: expected less than the ceiling's 3 m, got 3"),
    ({"radio": {"subcarriers": 6, "comb": 4}}, r"radio: expected subcarriers >= 2 \* comb = 8, got 6"),
    (
        {"echo": {"beams": {"beams": 63}}},
        r"echo\.beams: expected beams to be a multiple of panels = 4, got 63",
    ),
    ({"echo": {"model": "magic"}}, r"echo\.model: expected 'physical' or 'radar-equation', got 'magic'"),
    (
        {"echo": {"sweep_epochs": [0, 2], "sweep_every": 2}},
        "echo: expected sweep_epochs or sweep_every, got both",
    ),
    ({"echo": {"sweep_every": 0}}, "echo.sweep_every"),
    ({"agent.max_speed_m_s": 0.1}, "agent: expected max_speed_m_s of at least speed_m_s = 0.5, got 0.1"),
    ({"echo": {"sweep_epochs": [7]}}, r"echo\.sweep_epochs: expected epochs below agent\.epochs = 5, got 7"),
    ({"agent.orientation": "sideways"}, r"agent\.orientation: expected 'fixed' or 'travel', got 'sideways'"),
    ({"agent.clock": {"offset": 1e-9}}, r"agent\.clock\.offset: expected only known keys"),
    ({"anchors.0.clock": {"drift_ppm": float("inf")}}, r"anchors\[0\]\.clock\.drift_ppm: expected a finite"),
    ({"radio": {"snapshots": 0}}, r"radio\.snapshots: expected greater than or equal to 1, got 0"),
    (
        {"radio": {"snapshot_interval_s": 0.0}},
        r"radio\.snapshot_interval_s: expected greater than 0, got 0\.0",
    ),
    ({"targets": [chair(rcs_dbsm=3.0)]}, r"targets\[0\]: expected either rcs_m2 or rcs_dbsm, got both"),
    ({"targets": [chair(rcs_m2=None)]}, r"targets\[0\]: expected either rcs_m2 or rcs_dbsm, got neither"),
    ({"targets": [chair(kind="human")]}, "expected neither rcs_m2, rcs_dbsm nor points_m of a human"),
    (
        {"targets": [chair(kind="human", rcs_m2=None)]},
        r"expected waypoints_m of a human \(one where it stands, on the floor\), got position_m",
    ),
    ({"targets": [chair(waypoints_m=[[8.0, 8.0]])]}, "expected either position_m or waypoints_m, got both"),
    ({"targets": [chair(position_m=None)]}, "expected either position_m or waypoints_m, got neither"),
    (
        {"targets": [chair(position_m=None, waypoints_m=[[8.0, 8.0], [8.0, 8.0]])]},
        "expected waypoints_m that differ from one to the next",
    ),
    (
        {"targets": [chair(position_m=None, waypoints_m=[[8.0, 8.0], [12.0, 8.0]])]},
        r"targets\[0\] \(chair\)\.waypoints_m: expected a way that stays more than 0\.1 m from every wall",
    ),
    (
        {"targets": [chair(position_m=None, waypoints_m=[[8.0, 8.0]], height_m=3.5)]},
        "expected less than the ceiling's 3 m, got 3.5 m",
    ),
    (
        {"targets": [chair(position_m=None, waypoints_m=[[2.4, 3.0]], rcs_m2=None, kind="human")]},
        r"targets.* at least 0\.454 m to the agent's track, got 0\.1 m",
    ),
    ({"targets": [chair(rcs_m2=-1.0)]}, r"targets\[0\]\.rcs_m2: expected greater than 0, got -1\.0"),
    ({"targets": [chair(), chair()]}, "targets: expected names that differ, got 'chair' twice"),
    ({"targets": [chair(position_m=[9.95, 8.0, 1.0])]}, r"targets\[0\] \(chair\).*: it is in the wall"),
    ({"targets": [chair(position_m=[8.0, 8.0, 3.5])]}, "expected a height between 0 and 3 m, got 3.5 m"),
    (
        {"targets": [chair(position_m=[2.0, 3.0, 1.5])]},
        r"targets.* at least 0\.1 m to the agent's track, got 0 m",
    ),
    (
        {"radio": {"anchor_array": {"pattern": "yagi"}}},
        r"anchor_array\.pattern: expected 'iso', .* got 'yagi'",
    ),
    ({"radio": {"agent_array": {"polarization": "X"}}}, r"polarization: expected 'V' or 'H', got 'X'"),
    (
        {"radio": {"agent_array": {"rows": 0}}},
        r"agent_array\.rows: expected greater than or equal to 1, got 0",
    ),
    ({"anchors.0.downtilt_deg": 100.0}, r"anchors\[0\]\.downtilt_deg: expected less than or equal to 90"),
    ({"tracing": {"edge_diffraction": True}}, "tracing: expected diffraction = true with edge_diffraction"),
    ({"tracing": {"refraction": 1}}, r"tracing\.refraction: expected a valid boolean, got 1"),
    ({"materials": {"brick": {"relative_permittivity": 3.0}}}, "materials: expected names .* got 'brick'"),
    (
        {"materials": {"oak": {"relative_permittivity": 0.5}}},
        r"materials\.oak\.relative_permittivity: .* got 0\.5",
    ),
    ({"materials": {"oak": {}}}, r"materials\.oak\.relative_permittivity: expected a value, it is missing"),
    ({"scattering_patterns": {"cheese": {}}}, "scattering_patterns: expected names among .*, got 'cheese'"),
    ({"scattering_patterns": {"brick": {"alpha_r": 0}}}, r"scattering_patterns\.brick\.alpha_r: .* got 0"),
    (
        {"scattering_patterns": {"brick": {"pattern": "phong"}}},
        r"pattern: expected 'lambertian', .* got 'phong'",
    ),
    ({"agents": [walker(name="agent")]}, "agents: expected names that differ, got 'agent' twice"),
    ({"agents": [walker(name="a/b")]}, r"agents\[0\]\.name: expected .*pattern.*, got 'a/b'"),
    ({"agents": [walker(epochs=50)]}, r"agents\[0\] \(ann\): agent\.epochs: expected at most"),
    ({"agents": [walker(waypoints_m=[[2.0, 7.0], [18.0, 7.0]], epochs=30)]}, r"\(ann\): .* crosses the wall"),
    ({"tracing": {"depth": 9}}, r"tracing\.depth: expected less than or equal to 3, got 9"),
]


@pytest.mark.parametrize(("changes", "message"), BAD_VALUES)
def test_bad_plans_are_told_in_one_line(changes: dict[str, Any], message: str) -> None:
    """File, field, what was expected, what came: for every kind of mistake, in one line."""
    data = square()
    for dotted, value in changes.items():
        node: Any = data
        *parents, last = dotted.split(".")
        for parent in parents:
            node = node[int(parent)] if parent.isdigit() else node[parent]
        node[last] = value
    with pytest.raises(FloorPlanError, match=message) as caught:
        parse_floorplan(data, source="bad.toml")
    assert str(caught.value).startswith("bad.toml: ")
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, InputError)


def test_good_square_is_accepted() -> None:
    """The plan that the mistakes above are made in is itself valid."""
    assert parse_floorplan(square()).track().shape == (5, 3)


def test_a_plan_need_not_enclose_anything() -> None:
    """Anchors, agents and targets outside of a room, and before a single wall, are as good as inside."""
    outside = square(targets=[chair(position_m=[18.0, 8.0, 1.0])])
    outside["anchors"][0]["position_m"] = [15.0, 5.0, 2.5]
    outside["agent"]["waypoints_m"] = [[12.0, 3.0], [18.0, 3.0]]
    assert parse_floorplan(outside).track()[0, 0] == 12.0
    assert len(parse_floorplan(square(walls=square()["walls"][:1])).walls) == 1


def test_agent_through_an_inner_wall() -> None:
    """Both ends are inside the room, but a partition stands between: the agent would cross it."""
    partition = {"name": "partition", "from_m": [5.0, 0.0], "to_m": [5.0, 5.0]}
    data = square()
    data["walls"].append(partition)
    data["agent"]["epochs"] = 13
    with pytest.raises(FloorPlanError, match="wall 'partition': the agent crosses the wall"):
        parse_floorplan(data)
    data["agent"]["waypoints_m"] = [[2.0, 7.0], [8.0, 7.0]]
    data["anchors"][0]["position_m"] = [7.0, 3.0, 2.5]
    assert len(parse_floorplan(data).walls) == 5


def test_several_mistakes_are_counted() -> None:
    """The first mistake is described, the others counted."""
    data = square(name=3)
    data["walls"][0]["height_m"] = "high"
    with pytest.raises(FloorPlanError, match=r"\(and 1 more\)$"):
        parse_floorplan(data)


def test_missing_file_and_bad_toml(tmp_path: Path) -> None:
    """A file that is not there, one that is no TOML, and one that is no text, are named."""
    with pytest.raises(FloorPlanError, match=r"nowhere\.toml: expected a floor plan file or one of corridor"):
        load_floorplan(tmp_path / "nowhere.toml")
    for content in (b"walls = [", b"\xff\xfe\x00"):
        file = tmp_path / "bad.toml"
        file.write_bytes(content)
        with pytest.raises(FloorPlanError, match=r"bad\.toml: expected a TOML file, could not read it"):
            load_floorplan(file)
    (tmp_path / "empty.toml").write_text("")
    with pytest.raises(FloorPlanError, match="format: expected 'hapslam-floorplan', got nothing"):
        load_floorplan(tmp_path / "empty.toml")


def test_scene_files_have_no_defaults_hidden() -> None:
    """The shipped scenes spell out their links, so that a change of a default cannot change them."""
    for name in ("l-room", "l-room-hard"):
        file = Path(__file__).parents[3] / "scenes" / f"{name}.toml"
        data = tomllib.loads(file.read_text())
        assert {"carrier_hz", "subcarriers", "comb", "symbols", "eirp_dbm"} <= set(data["radio"])
        assert {"carrier_hz", "subcarriers", "model", "tx_power_dbm", "gamma", "eta"} <= set(data["echo"])
