"""Files that no friend would send: HDF5 that reaches for other files, and what unpacks to too much.

Each maker takes a good measurement file that it may change, and a file whose bytes must not come back.
"""

from __future__ import annotations

import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from estimator.measurement_files import save_measurements
from estimator.measurements import MeasurementSet

__all__ = ["BOMBS", "CANARY", "REACHING", "Maker", "measurement_file", "with_variable"]

CANARY = b"CANARY-7f3a91c2"
Maker = Callable[[Path, Path], bytes]
REACHING: dict[str, Maker] = {}
BOMBS: dict[str, Maker] = {}


def measurement_file(walk: MeasurementSet, folder: Path) -> Path:
    """A good measurement file."""
    file = folder / "walk.nc"
    file.unlink(missing_ok=True)
    save_measurements(walk, file)
    return file


def with_variable(file: Path, name: str, scales: bool = True, **given: Any) -> None:
    """Replace a variable of a file by one made as given, with the same axes."""
    with h5py.File(file, "r+") as data:
        old = data[name]
        shape, axes = old.shape, [dim[0].name if len(dim) else "" for dim in old.dims]
        is_scale = old.is_scale
        if is_scale:
            users = [
                (data[key], i) for key in data for i, dim in enumerate(data[key].dims) if old in dim.values()
            ]
            for user, axis in users:
                user.dims[axis].detach_scale(old)
        del data[name]
        new = data.create_dataset(name, **{"shape": shape, **given})
        if is_scale:
            new.make_scale(name)
            for user, axis in users:
                user.dims[axis].attach_scale(new)
        elif scales:
            for axis, scale in zip(range(new.ndim), axes, strict=False):
                if scale:
                    new.dims[axis].attach_scale(data[scale])


def _reaching(make: Maker) -> Maker:
    REACHING[make.__name__.strip("_")] = make
    return make


def _bomb(make: Maker) -> Maker:
    BOMBS[make.__name__.strip("_")] = make
    return make


@_reaching
def _external_gains(file: Path, canary: Path) -> bytes:
    with h5py.File(file) as data:
        size = data["delay_s"].size
    external = [(str(canary), 0, 8 * size)]
    with h5py.File(file) as data:
        there = "gain_db" in data
    with_variable(file, "gain_db" if there else "delay_std_s", dtype="f8", external=external)
    return file.read_bytes()


@_reaching
def _external_environment(file: Path, canary: Path) -> bytes:
    with_variable(file, "time_s", dtype="f8", external=[("/proc/self/environ", 0, 8 * 40)])
    return file.read_bytes()


@_reaching
def _external_link(file: Path, canary: Path) -> bytes:
    with h5py.File(canary.with_suffix(".h5"), "w") as other:
        other["time_s"] = np.frombuffer(canary.read_bytes()[: 8 * 40], dtype="f8")
    return _linked(file, h5py.ExternalLink(str(canary.with_suffix(".h5")), "/time_s"))


@_reaching
def _soft_link(file: Path, canary: Path) -> bytes:
    return _linked(file, h5py.SoftLink("/epoch"))


def _linked(file: Path, link: Any) -> bytes:
    with h5py.File(file, "r+") as data:
        del data["time_s"]
        data["time_s"] = link
    return file.read_bytes()


@_reaching
def _virtual(file: Path, canary: Path) -> bytes:
    source = canary.with_suffix(".h5")
    with h5py.File(source, "w") as other:
        other["x"] = np.frombuffer(canary.read_bytes()[: 8 * 40], dtype="f8")
    layout = h5py.VirtualLayout((40,), "f8")
    layout[:] = h5py.VirtualSource(str(source), "x", (40,))
    with h5py.File(file, "r+") as data:
        del data["time_s"]
        data.create_virtual_dataset("time_s", layout)
    return file.read_bytes()


@_reaching
def _named_type(file: Path, canary: Path) -> bytes:
    with h5py.File(file, "r+") as data:
        data["kind"] = np.dtype("f8")
    return file.read_bytes()


@_reaching
def _group(file: Path, canary: Path) -> bytes:
    with h5py.File(file, "r+") as data:
        data.create_group("within")["loop"] = h5py.SoftLink("/within")
    return file.read_bytes()


@_reaching
def _own_type(file: Path, canary: Path) -> bytes:
    with_variable(file, "time_s", dtype=np.dtype([("a", "f8"), ("b", h5py.ref_dtype)]), scales=False)
    return file.read_bytes()


@_bomb
def _many_variables(file: Path, canary: Path) -> bytes:
    with h5py.File(file, "r+", libver="latest") as data:
        for i in range(3_000):
            data.create_dataset(f"v{i}", (1,), "i1")
    return file.read_bytes()


@_bomb
def _wide_elements(file: Path, canary: Path) -> bytes:
    with_variable(file, "anchor", shape=(2,), dtype="S900000000", chunks=(1,), compression="gzip")
    return file.read_bytes()


@_bomb
def _huge_shape(file: Path, canary: Path) -> bytes:
    with h5py.File(file, "r+") as data:
        data.create_dataset("more", (10**6, 10**6), "f8", chunks=(1000, 1000), compression="gzip")
    return file.read_bytes()


@_bomb
def _tiny_chunks(file: Path, canary: Path) -> bytes:
    with h5py.File(file, "r+") as data:
        data.create_dataset("more", (10**8,), "i1", chunks=(1,))
    return file.read_bytes()


@_bomb
def _huge_chunk(file: Path, canary: Path) -> bytes:
    with h5py.File(file, "r+") as data:
        data.create_dataset("more", (1,), "f8", maxshape=(None,), chunks=(2**28,), compression="gzip")
    return file.read_bytes()


@_bomb
def _expanding_chunk(file: Path, canary: Path) -> bytes:
    """A chunk of 320 bytes whose deflate stream goes on for two gigabytes."""
    packer = zlib.compressobj(9)
    stream = b"".join(packer.compress(bytes(2**24)) for _ in range(128)) + packer.flush()
    with_variable(file, "time_s", dtype="f8", chunks=(40,), compression="gzip")
    with h5py.File(file, "r+") as data:
        data["time_s"].id.write_direct_chunk((0,), stream)
    return file.read_bytes()


@_bomb
def _long_strings(file: Path, canary: Path) -> bytes:
    with_variable(file, "anchor", shape=(2,), dtype=h5py.string_dtype())
    with h5py.File(file, "r+") as data:
        data["anchor"][:] = ["a" * 4_000_000, "b" * 4_000_000]
    return file.read_bytes()


@_bomb
def _many_attributes(file: Path, canary: Path) -> bytes:
    with h5py.File(file, "r+", libver="latest") as data:
        for i in range(2_000):
            data.attrs[f"a{i}"] = i
    return file.read_bytes()


@_bomb
def _deep_settings(file: Path, canary: Path) -> bytes:
    return with_attribute(file, settings="[" * 30_000 + "]" * 30_000)


@_bomb
def _settings_of_another_type(file: Path, canary: Path) -> bytes:
    return with_attribute(file, settings=json.dumps({"measurement_model": [1, 2, {"a": None}]}))


@_bomb
def _carrier_of_many_numbers(file: Path, canary: Path) -> bytes:
    return with_attribute(file, carrier_hz=np.ones(50))


def with_attribute(file: Path, **given: Any) -> bytes:
    """A file with an attribute changed."""
    with h5py.File(file, "r+", libver="latest") as data:
        for name, value in given.items():
            del data.attrs[name]
            data.attrs[name] = value
    return file.read_bytes()


def zipped(members: dict[str, bytes]) -> bytes:
    """A zip archive."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return stream.getvalue()


@_bomb
def _zip_of_zeros(file: Path, canary: Path) -> bytes:
    return zipped({f"passive-{i:05d}.nc": bytes(100 * 2**20) for i in range(3)})


@_bomb
def _zip_that_lies(file: Path, canary: Path) -> bytes:
    """Members that say they are a kilobyte long and go on for a hundred megabytes."""
    body = bytearray(zipped({"manifest.json": bytes(100 * 2**20)}))
    at = body.rfind(b"PK\x01\x02")
    struct.pack_into("<I", body, at + 24, 1024)
    return bytes(body)


@_bomb
def _zip_of_many(file: Path, canary: Path) -> bytes:
    return zipped({f"passive-{i:05d}.nc": b"" for i in range(20_000)})


@_bomb
def _zip_that_climbs(file: Path, canary: Path) -> bytes:
    return zipped({f"../../../../{canary}": b"{}", "manifest.json": b"{}"})


@_bomb
def _deep_manifest(file: Path, canary: Path) -> bytes:
    return zipped({"manifest.json": b'{"a":' * 100_000})


@_bomb
def _manifest_of_other_types(file: Path, canary: Path) -> bytes:
    shard = {"file": "passive-0.nc", "kind": [], "bytes": {}, "sha256": 3}
    manifest = {"format": "hapslam-dataset", "version": 1, "complete": True, "shards": [shard], "radio": 7}
    return zipped({"manifest.json": json.dumps(manifest).encode()})


@_bomb
def _npz_with_a_huge_head(file: Path, canary: Path) -> bytes:
    stream = io.BytesIO()
    head = {"descr": "<f8", "fortran_order": False, "shape": (10**6, 10**5)}
    np.lib.format.write_array_header_1_0(stream, head)
    names = ("cfr_re", "cfr_im", "echo_re", "echo_im", "time_s", "epoch", "anchor", "tone_offset_hz")
    return zipped({f"{name}.npy": stream.getvalue() + bytes(1000) for name in names})


@_bomb
def _npz_of_objects(file: Path, canary: Path) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **{name: np.array([{}], dtype=object) for name in ("cfr_re", "echo_re", "time_s")})
    return stream.getvalue()
