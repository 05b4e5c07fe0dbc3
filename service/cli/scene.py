"""The commands around floor plans: `scene check`, `inspect`, `import`, `random`, `schema`, and pictures."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.console import made_parents

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["register"]

_scene = typer.Typer(no_args_is_help=True, help="Floor plans: check, draw, make, and import them.")

Scene = Annotated[
    str, typer.Argument(metavar="FILE", help="Floor plan file, or the name of a shipped scene.")
]
Picture = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Picture to write: .png, .svg or .pdf.", callback=made_parents),
]
Plan = Annotated[
    Path, typer.Option(metavar="FILE", help="Floor plan to write (TOML).", callback=made_parents)
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
DatasetPath = Annotated[Path, typer.Argument(help="Dataset directory.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    app.add_typer(_scene, name="scene")


def _examples(*lines: str) -> str:
    return "[bold]Examples[/]\n\n" + "\n\n".join(f"  $ hapslam scene {line}" for line in lines)


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")


@_scene.command(epilog=_examples("check l-room", "check my-plan.toml --json"))
def check(scene: Scene, as_json: Json = False) -> None:
    """Check a floor plan and say what it amounts to."""
    from raytrace.plan.files import load_floorplan
    from raytrace.propagation.plan_summary import floorplan_summary

    summary = floorplan_summary(load_floorplan(scene))
    if as_json:
        _say(json.dumps(summary, indent=2, allow_nan=False))
        return
    for name, value in summary.items():
        if name in ("warnings", "repairs"):
            continue
        texts = [f"{k} {v}" for k, v in value.items()] if isinstance(value, dict) else value
        text = ", ".join(texts) if isinstance(texts, list) else texts
        _say(f"{name:<14} {text}")
    for repair in summary["repairs"]:
        _say(f"repaired       {repair}")
    for warning in summary["warnings"]:
        _say(f"warning        {warning}")


@_scene.command(
    epilog=_examples(
        "show l-room --out l-room.png", "show l-room --coverage", "show l-room --paths 40 --depth 1"
    )
)
def show(
    scene: Scene,
    out: Picture = None,
    coverage: Annotated[bool, typer.Option("--coverage", help="Draw the received power.")] = False,
    paths: Annotated[
        int | None, typer.Option(min=0, metavar="EPOCH", help="Draw the paths at an epoch.")
    ] = None,
    depth: Annotated[int, typer.Option(min=0, max=3, help="Most bounces of what is drawn.")] = 1,
) -> None:
    """Draw a floor plan; with the power everywhere, or with the paths at an epoch."""
    from estimator.errors import ConfigurationError
    from raytrace.pictures.plans import draw_coverage, draw_paths, draw_plan
    from raytrace.plan.files import load_floorplan

    if coverage and paths is not None:
        raise ConfigurationError("expected --coverage or --paths, got both")
    plan = load_floorplan(scene)
    _check_name(out)
    if coverage:
        figure, name = draw_coverage(plan, depth), f"{plan.name}-coverage"
    elif paths is not None:
        figure, name = draw_paths(plan, paths, depth), f"{plan.name}-paths"
    else:
        figure, name = draw_plan(plan), plan.name
    _save(figure, out, name)


@_scene.command(
    "random",
    epilog=_examples(
        "random --seed 3 --kind office --out office-3.toml", "random --seed 1 --kind hall --out h.toml"
    ),
)
def random_(
    kind: Annotated[
        str,
        typer.Option(help="rectangle, l-shape, corridor, office, hall, suite, ring, bent, aisles or shops."),
    ],
    out: Plan,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all randomness.")] = 1,
    corner: Annotated[
        bool, typer.Option("--corner", help="Start at an end of the space, not in the open.")
    ] = False,
) -> None:
    """Make a random floor plan with anchors and a walk."""
    import numpy as np

    from raytrace.plan.files import save_floorplan, updated
    from raytrace.plan.random_plans import Start, random_plan

    start: Start = "end" if corner else "open"
    plan = random_plan(kind, np.random.default_rng(seed), start=start)  # type: ignore[arg-type]  # it checks
    save_floorplan(updated(plan, {"name": out.stem[:100]}), out)
    _say(f"{out}: {len(plan.walls)} walls, {len(plan.anchors)} anchors, {plan.agent.epochs} epochs")


Drawn = Annotated[
    Path,
    typer.Argument(
        help="Drawing: .dxf, .geojson, .json, .osm, .xml (Mitsuba), .ply, .obj, .stl, .glb, .gltf, .ifc; "
        "or a venue (IMDF), as a folder or .zip.",
        metavar="FILE",
    ),
]
Layers = Annotated[
    list[str] | None,
    typer.Option(
        "--layer", metavar="PATTERN=MATERIAL", help="Material of layers, features or objects; or =ignore."
    ),
]
UnitOption = Annotated[
    str | None, typer.Option("--unit", help="m, dm, cm, mm, in, ft, yd or km; by default the file's.")
]
Level = Annotated[str | None, typer.Option("--level", help="Level of a file that has several.")]
Meshes = Annotated[
    list[Path] | None,
    typer.Option("--mesh", help="PLY file, or a folder of them, that a Mitsuba scene may use; no other."),
]


@_scene.command(
    epilog=_examples("inspect flat.dxf", "inspect flat.dxf --out flat.png", "inspect mall.geojson --json")
)
def inspect(
    file: Drawn,
    out: Picture = None,
    layer: Layers = None,
    unit: UnitOption = None,
    level: Level = None,
    mesh: Meshes = None,
    as_json: Json = False,
) -> None:
    """Tell what is in a drawing, and what an import would take for what; with --out, draw it."""
    from raytrace.importers.inspection import draw_drawing, inspect_drawing
    from raytrace.importers.options import ImportOptions

    _check_name(out)
    options = ImportOptions(materials=_materials(layer or []), unit=unit, level=level)
    facts, drawing = inspect_drawing(file, options, tuple(mesh or ()))
    if as_json:
        _say(json.dumps(facts, indent=2, allow_nan=False))
    else:
        width, depth = facts["extent_m"]
        _say(f"{'extent':<10} {width:g} m by {depth:g} m")
        if facts["levels"]:
            _say(f"{'levels':<10} {', '.join(facts['levels'])}")
        for name, found in facts["layers"].items():
            told = f"{found['lines']} lines, {found['length_m']:g} m, {found['taken_as']}"
            _say(f"{'layer':<10} {name}: {told}")
        for verb in ("kept", "dropped"):
            for what, count in facts[verb].items():
                _say(f"{verb:<10} {count:>6}  {what}")
        for kind in ("note", "warning"):
            for text in facts[f"{kind}s"]:
                _say(f"{kind:<10} {text}")
        if facts["problem"]:
            _say(f"{'problem':<10} {facts['problem']}")
    if out is not None:
        _save(draw_drawing(drawing, file.name), out, file.stem)


@_scene.command(
    "import",
    epilog=_examples(
        "import flat.dxf --out flat.toml",
        'import flat.dxf --layer "A-WALL*=brick" --layer "A-DOOR=wood" --unit mm --out flat.toml',
        "import mall.geojson --level 0 --out ground-floor.toml",
        "import scene.xml --mesh meshes --out hall.toml",
        'import flat.dxf --walk "1,1 5,1 5,4" --anchor 2,3,2.5 --anchor 6,1 --out flat.toml',
    ),
)
def import_(
    file: Drawn,
    out: Plan,
    layer: Layers = None,
    material: Annotated[str | None, typer.Option(help="Material of what nothing else tells.")] = None,
    unit: UnitOption = None,
    level: Level = None,
    height: Annotated[float, typer.Option(help="Height of walls that the file does not tell, metres.")] = 3.0,
    thickness: Annotated[float, typer.Option(help="Thickness of single lines, metres.")] = 0.2,
    thickest: Annotated[
        float, typer.Option(help="Parallel lines nearer than this are faces of one wall, metres.")
    ] = 0.5,
    hatches: Annotated[bool, typer.Option("--hatches", help="Take outlines of hatches as walls.")] = False,
    cut: Annotated[float, typer.Option(help="Height at which models are cut, metres.")] = 1.2,
    up: Annotated[
        str | None, typer.Option(help="Axis of a model that points upwards, z or y; by default the format's.")
    ] = None,
    walk: Annotated[
        str, typer.Option(help='Way-points "x,y x,y ..." in metres of the plan, or auto.')
    ] = "auto",
    anchor: Annotated[
        list[str] | None,
        typer.Option(metavar="X,Y[,Z]", help="Anchor in metres of the plan, in place of others."),
    ] = None,
    space: Annotated[str, typer.Option(help="Where to walk: inside, outside or auto.")] = "auto",
    mesh: Meshes = None,
    as_json: Json = False,
) -> None:
    """Make a floor plan of a drawing, and report what was kept, dropped and collapsed."""
    from estimator.dataset import require_absent
    from raytrace.importers.convert import import_floorplan
    from raytrace.importers.options import ImportOptions
    from raytrace.plan.files import save_floorplan

    require_absent(out)
    options = ImportOptions(
        materials=_materials(layer or []),
        material=material,
        unit=unit,
        height_m=height,
        thickness_m=thickness,
        thickest_m=thickest,
        cut_m=cut,
        up=up,  # type: ignore[arg-type]  # it checks
        level=level,
        hatches=hatches,
        walk_m=()
        if walk == "auto"
        else tuple((x, y) for x, y, _ in (_point("--walk", text, 2) for text in walk.split())),
        anchors_m=tuple(_point("--anchor", text, 3) for text in anchor or ()),
        space=None if space == "auto" else space,  # type: ignore[arg-type]  # it checks
    )
    imported = import_floorplan(file, options, mesh or [])
    save_floorplan(imported.plan, out)
    report = imported.drawing.report
    _say(json.dumps(report.as_dict(), indent=2) if as_json else "\n".join(report.lines()))


def _point(option: str, text: str, most: int) -> tuple[float, float, float]:
    """``x,y`` or ``x,y,z`` as three numbers, the third 0 if it is missing; raises ConfigurationError."""
    from estimator.errors import ConfigurationError

    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if not 2 <= len(numbers) <= most or not all(map(math.isfinite, numbers)):
        wanted = "X,Y" if most == 2 else "X,Y or X,Y,Z"
        raise ConfigurationError(f"{option}: expected {wanted} in metres, got {text!r}")
    x, y, z = (*numbers, 0.0)[:3]
    return x, y, z


@_scene.command("export", epilog=_examples("export twin.toml --out twin-scene"))
def export_(
    scene: Scene,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder to make.", callback=made_parents)],
) -> None:
    """Write a floor plan as a Mitsuba scene with radio materials, as Sionna RT loads it."""
    from estimator.dataset import require_absent
    from raytrace.dataset.export_scene import export_scene
    from raytrace.plan.files import load_floorplan

    plan = load_floorplan(scene)
    require_absent(out)
    out.mkdir()
    export_scene(plan, out)


@_scene.command(epilog=_examples("schema > floorplan.schema.json"))
def schema() -> None:
    """Print the JSON Schema of floor plan files."""
    from raytrace.plan.files import floorplan_schema

    _say(json.dumps(floorplan_schema(), indent=2))


@_scene.command(epilog=_examples("profile room --out profile.png"))
def profile(dataset: DatasetPath, out: Picture = None) -> None:
    """Draw a dataset's power over path length along the trajectory."""
    from estimator.dataset import open_dataset
    from raytrace.pictures.datasets import draw_delay_profile

    _check_name(out)
    opened = open_dataset(dataset)
    _save(draw_delay_profile(opened), out, f"{_stem(opened.manifest)}-profile")


@_scene.command(epilog=_examples("sweep room --out sweep.png", "sweep room --number 2"))
def sweep(
    dataset: DatasetPath,
    out: Picture = None,
    number: Annotated[int, typer.Option(min=0, help="Which sweep.")] = 0,
) -> None:
    """Draw the echo of a dataset's beam sweep over range and angle."""
    from estimator.dataset import open_dataset
    from raytrace.pictures.datasets import draw_range_angle

    _check_name(out)
    opened = open_dataset(dataset)
    _save(draw_range_angle(opened, number), out, f"{_stem(opened.manifest)}-sweep")


def _stem(manifest: Any) -> str:
    return str(manifest.get("name", "dataset"))


def _materials(pairs: list[str]) -> dict[str, str]:
    """``PATTERN=MATERIAL`` arguments; raises ConfigurationError."""
    from estimator.errors import ConfigurationError

    materials = {}
    for pair in pairs:
        pattern, equals, material = pair.rpartition("=")
        if not equals or not pattern:
            raise ConfigurationError(f"--layer: expected PATTERN=MATERIAL, got {pair!r}")
        materials[pattern] = material
    return materials


def _check_name(out: Path | None) -> None:
    from estimator.evaluation.pictures import require_picture_name

    if out is not None:
        require_picture_name(out)


def _save(figure: Figure, out: Path | None, name: str) -> None:
    from estimator.evaluation.pictures import save_figure

    path = (
        Path(f"{''.join(c if c.isalnum() or c in '-_.' else '-' for c in name)}.png") if out is None else out
    )
    save_figure(figure, path)
    _say(str(path))
