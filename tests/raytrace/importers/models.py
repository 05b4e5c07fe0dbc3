"""IFC models of a small house, as modelling programs write them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("ifcopenshell", reason="IfcOpenShell has no wheel for this machine")

from ifcopenshell.api import (
    aggregate,
    context,
    feature,
    geometry,
    material,
    owner,
    project,
    root,
    spatial,
    unit,
)


class House:
    """Rooms of 8 m x 6 m over one another; storeys are added one by one."""

    def __init__(self, version: str = "IFC4", length: str = "MILLIMETERS", offset_m: float = 0.0) -> None:
        self.file: Any = project.create_file(version=version)
        self.offset_m = offset_m
        if version == "IFC2X3":  # wants to know who drew it
            owner.add_person_and_organisation(
                self.file, owner.add_person(self.file), owner.add_organisation(self.file)
            )
            owner.add_application(self.file, owner.add_organisation(self.file))
        whole = root.create_entity(self.file, ifc_class="IfcProject", name="house")
        if length == "FEET":
            unit.assign_unit(self.file, length={"is_metric": False, "raw": length})
        else:
            unit.assign_unit(self.file, length={"is_metric": True, "raw": length})
        model = context.add_context(self.file, context_type="Model")
        self.body = context.add_context(
            self.file,
            context_type="Model",
            context_identifier="Body",
            target_view="MODEL_VIEW",
            parent=model,
        )
        self.building = self.made("IfcBuilding", "house")
        aggregate.assign_object(self.file, relating_object=whole, products=[self.building])
        self.storey: Any = None

    def made(self, kind: str, name: str) -> Any:
        return root.create_entity(self.file, ifc_class=kind, name=name)

    def place(self, thing: Any, x: float, y: float, z: float, turn_deg: float = 0.0) -> None:
        matrix = np.eye(4)
        c, s = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
        matrix[:2, :2] = [[c, -s], [s, c]]
        matrix[:3, 3] = x + self.offset_m, y + self.offset_m, z
        geometry.edit_object_placement(self.file, product=thing, matrix=matrix)

    def begin(self, name: str, floor_m: float) -> None:
        self.storey, self.floor_m = self.made("IfcBuildingStorey", name), floor_m
        self.place(self.storey, 0.0, 0.0, floor_m)
        aggregate.assign_object(self.file, relating_object=self.building, products=[self.storey])

    def box(
        self,
        kind: str,
        name: str,
        at: tuple[float, float],
        size: tuple[float, float, float],
        turn_deg: float = 0.0,
        sill_m: float = 0.0,
    ) -> Any:
        """A thing of length, thickness and height, from a corner along a direction."""
        thing = self.made(kind, name)
        self.place(thing, *at, self.floor_m + sill_m, turn_deg)
        length, thickness, height = size
        shape = geometry.add_wall_representation(
            self.file, context=self.body, length=length, height=height, thickness=thickness
        )
        geometry.assign_representation(self.file, product=thing, representation=shape)
        if not thing.is_a("IfcOpeningElement"):
            spatial.assign_container(self.file, relating_structure=self.storey, products=[thing])
        return thing

    def fill(
        self,
        wall: Any,
        kind: str,
        at: tuple[float, float],
        size: tuple[float, float, float],
        turn_deg: float = 0.0,
        sill_m: float = 0.0,
    ) -> None:
        """A door or window in a hole of a wall."""
        length, thickness, height = size
        hole = self.box("IfcOpeningElement", "hole", at, (length, thickness, height), turn_deg, sill_m)
        feature.add_feature(self.file, feature=hole, element=wall)
        filling = self.box(kind, kind.removeprefix("Ifc"), at, (length, 0.06, height), turn_deg, sill_m)
        feature.add_filling(self.file, opening=hole, element=filling)

    def made_of(self, things: list[Any], *layers: tuple[str, float]) -> None:
        """Give things layers of materials, metres."""
        stack = material.add_material_set(self.file, name="stack", set_type="IfcMaterialLayerSet")
        for name, thickness in layers:
            stuff = material.add_material(self.file, name=name)
            layer = material.add_layer(self.file, layer_set=stack, material=stuff)
            layer.LayerThickness = 1000.0 * thickness
        material.assign_material(self.file, products=things, type="IfcMaterialLayerSet", material=stack)

    def rooms(self, name: str = "Ground floor", floor_m: float = 0.0, height_m: float = 3.0) -> Any:
        """A storey of two rooms with a door between them and a window to the south; its outer walls."""
        self.begin(name, floor_m)
        outer = [
            self.box("IfcWall", "south", (0, 0), (8, 0.2, height_m)),
            self.box("IfcWall", "east", (8, 0), (6, 0.2, height_m), 90),
            self.box("IfcWall", "north", (8, 6), (8, 0.2, height_m), 180),
            self.box("IfcWall", "west", (0, 6), (6, 0.2, height_m), -90),
        ]
        self.made_of(outer, ("Plaster", 0.02), ("Mauerwerk 17.5", 0.175))
        inner = self.box("IfcWall", "inner", (4.1, 0.2), (5.6, 0.1, 2.8), 90)
        self.fill(inner, "IfcDoor", (4.2, 2), (0.9, 0.3, 2.1), 90)
        self.fill(outer[0], "IfcWindow", (1, -0.05), (1.5, 0.3, 1.3), sill_m=0.9)
        return outer

    def bytes(self) -> bytes:
        return bytes(self.file.to_string().encode())
