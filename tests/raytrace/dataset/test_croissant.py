"""Croissant metadata and the head of the data card: every file with its hash, licence and tags."""

from __future__ import annotations

import hashlib
import json

import pytest

from estimator.dataset import Dataset
from raytrace.dataset.croissant import card_head, croissant


def test_every_file_is_listed_with_its_hash(sharded: Dataset) -> None:
    """Files, sizes and SHA-256 are those of the folder; the terms and the name those of the manifest."""
    facts = json.loads((sharded.path / "croissant.json").read_text())
    assert facts["@type"] == "sc:Dataset"
    assert facts["conformsTo"] == "http://mlcommons.org/croissant/1.0"
    assert facts["name"] == sharded.manifest["name"]
    listed = {entry["@id"]: entry for entry in facts["distribution"]}
    assert set(listed) == {file.name for file in sharded.path.glob("*.nc")}
    for name, entry in listed.items():
        data = (sharded.path / name).read_bytes()
        assert entry["sha256"] == hashlib.sha256(data).hexdigest()
        assert entry["contentSize"] == f"{len(data)} B"
        assert entry["contentUrl"] == name
    text = json.dumps(facts)
    assert "68.0" not in text  # neither walls nor anchors


@pytest.mark.parametrize(
    ("licence", "lines"),
    [
        ("CC-BY-4.0", ["license: cc-by-4.0"]),
        ("", ["license: unknown"]),
        ('ask "us": first', ["license: other", 'license_name: "ask \\"us\\": first"']),
    ],
)
def test_the_head_of_the_card(sharded: Dataset, licence: str, lines: list[str]) -> None:
    """Licences by their identifiers, others by name, none as unknown; the rest is quoted."""
    manifest = {**sharded.manifest, "output": {**sharded.manifest["output"], "licence": licence}}
    head = card_head(manifest)
    assert head[0] == head[-1] == "---"
    assert head[1 : 1 + len(lines)] == lines
    assert ("license" in json.loads(croissant(manifest, []))) == bool(licence)
    assert (sharded.path / "CARD.md").read_text().startswith("---\nlicense: ")
