"""Choosing LLVM for the ray tracer, and saying what is wrong when it cannot run.

Dr.Jit compiles its kernels with libLLVM, looks for the library once, before its
first import, and takes the first it finds. LLVM 14 it refuses; with 15 and 16 its
import succeeds and the first path solve then aborts the whole process. So the library
is chosen here, before anything imports Dr.Jit: the one that the user names in
``DRJIT_LIBLLVM_PATH``, else that of the package karellen-llvm-core, else the newest
of the system that is not too old.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from estimator.errors import BackendError

__all__ = [
    "MINIMUM_LLVM",
    "SYSTEM_FOLDERS",
    "VARIANT",
    "Check",
    "LlvmChoice",
    "choose_llvm",
    "diagnose",
    "prepare",
]

MINIMUM_LLVM = 17
VARIANT = "llvm_ad_mono_polarized"
SYSTEM_FOLDERS = (
    "/usr/lib/llvm-*/lib",
    "/usr/lib/*-linux-gnu",
    "/usr/lib64",
    "/usr/lib",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm/lib",
)

_VARIABLE = "DRJIT_LIBLLVM_PATH"
_PACKAGE = "karellen-llvm-core"
_MODULES = ("mitsuba", "drjit", "sionna")
_REMEDY_LLVM = (
    f"install LLVM {MINIMUM_LLVM} or newer, either the Python package {_PACKAGE} (Linux, x86-64) or the "
    f"system's library (Debian: apt install libllvm19), or set {_VARIABLE} to such a libLLVM"
)
_REMEDY_PACKAGES = "install the ray tracer: pip install 'hapslam[raytrace]'"
_PROBE_SECONDS = 120.0
_ASK_VERSION = """
import ctypes, sys
library = ctypes.CDLL(sys.argv[1])
if hasattr(library, "LLVMGetVersion"):
    numbers = [ctypes.c_uint() for _ in range(3)]
    library.LLVMGetVersion(*map(ctypes.byref, numbers))
    print(*(number.value for number in numbers), sep=".")
else:
    print("old")
"""


@dataclass(frozen=True)
class LlvmChoice:
    """The LLVM library that the ray tracer uses.

    Parameters
    ----------
    path : Path
        The shared library.
    version : str
        Its version, for example ``"19.1.7"``.
    source : str
        Why it was chosen: ``DRJIT_LIBLLVM_PATH``, ``karellen-llvm-core`` or ``system``.
    """

    path: Path
    version: str
    source: str


@dataclass(frozen=True)
class Check:
    """One line of ``hapslam doctor``: what was looked at, what was found, what helps."""

    name: str
    ok: bool
    value: str
    remedy: str = ""


def choose_llvm(
    environment: Mapping[str, str] | None = None, folders: Sequence[str] = SYSTEM_FOLDERS
) -> LlvmChoice:
    """Find a libLLVM that the ray tracer can use.

    Parameters
    ----------
    environment : mapping, optional
        Environment variables; by default those of the process.
    folders : sequence of str
        Where the system's libraries are, with wildcards.

    Raises
    ------
    BackendError
        If the user's choice cannot be used, or there is no usable library; the
        message holds the remedy.
    """
    named = (os.environ if environment is None else environment).get(_VARIABLE)
    packaged = _packaged_llvm()
    if named:
        if packaged is not None and Path(named) == packaged.path:
            return packaged
        return _named_llvm(Path(named))
    if packaged is not None:
        return packaged
    found = dict(_system_llvms(folders))
    usable = {path: version for path, version in found.items() if _major(version) >= MINIMUM_LLVM}
    if usable:
        path = max(usable, key=lambda item: _numbers(usable[item]))
        return LlvmChoice(path, usable[path], "system")
    seen = ", ".join(f"{path} ({version})" for path, version in found.items()) or "none at all"
    raise BackendError(f"libLLVM: expected version {MINIMUM_LLVM} or newer, found {seen}; {_REMEDY_LLVM}")


def prepare() -> LlvmChoice:
    """Choose LLVM, import Mitsuba in the variant that Sionna needs, and use one thread.

    Call it before anything imports Dr.Jit, Mitsuba or Sionna; calling it again
    changes nothing. One thread is as fast as two here and makes results repeat bit
    for bit.

    Raises
    ------
    BackendError
        If there is no usable LLVM, the ray tracer is not installed, or Dr.Jit was
        imported before with another LLVM; the message holds the remedy.
    """
    missing = [name for name in _MODULES if find_spec(name) is None]
    if missing:
        raise BackendError(
            f"ray tracer: expected the packages {', '.join(_MODULES)}, "
            f"not installed: {', '.join(missing)}; {_REMEDY_PACKAGES}"
        )
    choice = choose_llvm()
    loaded = _loaded_llvm()
    if "drjit" in sys.modules and loaded is not None and not loaded.samefile(choice.path):
        raise BackendError(
            f"libLLVM: expected Dr.Jit to use {choice.path}, but it was imported before with {loaded}; "
            f"call raytrace.propagation.backend.prepare() before importing drjit, mitsuba or sionna"
        )
    os.environ[_VARIABLE] = str(choice.path)
    try:
        drjit = import_module("drjit")
        mitsuba = import_module("mitsuba")
    except ImportError as error:
        raise BackendError(
            f"ray tracer: expected Mitsuba and Sionna RT, cannot import them ({error}); {_REMEDY_PACKAGES}"
        ) from error
    try:
        if mitsuba.variant() != VARIANT:
            mitsuba.set_variant(VARIANT)
    except ImportError as error:
        raise BackendError(
            f"Mitsuba: expected the variant {VARIANT} with {choice.path}, got: {error}; {_REMEDY_LLVM}"
        ) from error
    drjit.set_thread_count(1)
    return choice


def diagnose() -> list[Check]:
    """Look at everything that the ray tracer needs, and trace a few paths in a subprocess.

    Nothing is imported here that could abort this process.
    """
    version = ".".join(str(part) for part in sys.version_info[:3])
    checks = [
        Check("Python", sys.version_info >= (3, 11), version, "install Python 3.11 or newer"),
        *(_package_check(name) for name in ("sionna-rt", "mitsuba", "drjit")),
    ]
    try:
        choice = choose_llvm()
    except BackendError as error:
        return [*checks, Check("LLVM", False, str(error).split(";")[0], _REMEDY_LLVM)]
    checks.append(Check("LLVM", True, f"{choice.version} at {choice.path} (from {choice.source})"))
    if all(check.ok for check in checks):
        checks.extend(_probe(choice))
    return [check if not check.ok else Check(check.name, True, check.value) for check in checks]


def _package_check(name: str) -> Check:
    try:
        return Check(name, True, metadata.version(name))
    except metadata.PackageNotFoundError:
        return Check(name, False, "not installed", _REMEDY_PACKAGES)


def _probe(choice: LlvmChoice) -> Iterator[Check]:
    """Trace a few paths in a process of its own: a bad LLVM aborts the one that runs it."""
    root = str(Path(__file__).resolve().parents[2])
    code = f"import sys; sys.path.insert(0, {root!r}); from raytrace.propagation.probe import main; main()"
    environment = {**os.environ, _VARIABLE: str(choice.path)}
    try:
        done = subprocess.run(
            [sys.executable, "-c", code],
            env=environment,
            capture_output=True,
            text=True,
            timeout=_PROBE_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        yield Check("path solve", False, f"no answer in {_PROBE_SECONDS:g} s", _REMEDY_LLVM)
        return
    facts = _last_json_line(done.stdout)
    if done.returncode or facts is None:
        said = (done.stderr.strip() or "no message").splitlines()[-1]
        ended = f"signal {-done.returncode}" if done.returncode < 0 else f"status {done.returncode}"
        yield Check("path solve", False, f"the test process ended with {ended}: {said}", _REMEDY_LLVM)
        return
    yield Check("Mitsuba variant", facts["variant"] == VARIANT, str(facts["variant"]), _REMEDY_PACKAGES)
    yield Check("Dr.Jit threads", facts["threads"] == 1, str(facts["threads"]), "report this: it should be 1")
    yield Check(
        "path solve",
        facts["found"] == facts["expected"],
        f"{facts['found']} of {facts['expected']} paths in {facts['seconds']:.1f} s",
        f"the ray tracer runs but loses paths; {_REMEDY_PACKAGES}",
    )


def _last_json_line(text: str) -> dict[str, Any] | None:
    for line in reversed(text.splitlines()):
        if line.startswith("{"):
            return dict(json.loads(line))
    return None


def _packaged_llvm() -> LlvmChoice | None:
    """The library of karellen-llvm-core where that package installed it (moved, it would not load)."""
    try:
        package = metadata.distribution(_PACKAGE)
    except metadata.PackageNotFoundError:
        return None
    if _major(package.version) < MINIMUM_LLVM:
        return None
    for file in package.files or ():
        if file.name == "libLLVM.so":
            path = Path(os.path.normpath(str(package.locate_file(file))))
            if path.is_file():
                return LlvmChoice(path, package.version, _PACKAGE)
    return None


def _named_llvm(path: Path) -> LlvmChoice:
    wrong = f"{_VARIABLE}: expected libLLVM of version {MINIMUM_LLVM} or newer, got {path}"
    if not path.is_file():
        raise BackendError(f"{wrong}, which is no file; unset it, or {_REMEDY_LLVM}")
    version = _version_of(path)
    if _major(version) < MINIMUM_LLVM:
        raise BackendError(f"{wrong}, which is version {version}; unset it, or {_REMEDY_LLVM}")
    return LlvmChoice(path, version, _VARIABLE)


def _system_llvms(folders: Sequence[str]) -> Iterator[tuple[Path, str]]:
    """The system's LLVM libraries with their versions, each file once."""
    seen: set[Path] = set()
    for pattern in folders:
        top = Path(pattern)
        for folder in sorted(Path(top.anchor).glob(str(top.relative_to(top.anchor)))):
            for path in sorted([*folder.glob("libLLVM*.so*"), *folder.glob("libLLVM*.dylib")]):
                real = path.resolve()
                if real.is_file() and real not in seen:
                    seen.add(real)
                    yield path, _version_of(real)


def _version_of(path: Path) -> str:
    """Version of a libLLVM, asked from the library in a subprocess.

    The question, ``LLVMGetVersion``, exists since LLVM 16; of a library that does not
    know it the version is read off its name. ``"unusable"`` if it cannot be loaded.
    """
    try:
        done = subprocess.run(
            [sys.executable, "-I", "-c", _ASK_VERSION, str(path)],
            capture_output=True,
            text=True,
            timeout=30,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "unusable"
    if done.returncode or not done.stdout.strip():
        return "unusable"
    if done.stdout.strip() != "old":
        return done.stdout.strip()
    number = re.search(r"LLVM[-.a-z]*(\d+(?:\.\d+)*)", path.resolve().name)
    return number.group(1) if number and _major(number.group(1)) < MINIMUM_LLVM else "older than 16"


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", version))


def _major(version: str) -> int:
    """Leading number of a version, 0 for one that starts with a word."""
    return _numbers(version)[0] if version[:1].isdigit() else 0


def _loaded_llvm() -> Path | None:
    """The libLLVM that this process has mapped (Linux tells), if any."""
    try:
        lines = Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return None
    for line in lines:
        path = line.partition("/")[2]
        if "libLLVM" in path.rpartition("/")[2] and Path("/" + path).is_file():
            return Path("/" + path)
    return None
