"""Which LLVM is chosen, what is said when none can be, and what the doctor sees."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from estimator.errors import BackendError
from raytrace.propagation import backend
from raytrace.propagation.backend import (
    MINIMUM_LLVM,
    SYSTEM_FOLDERS,
    Check,
    LlvmChoice,
    choose_llvm,
    diagnose,
)

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def no_package(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine without the package that ships LLVM."""
    monkeypatch.setattr(backend, "_packaged_llvm", lambda: None)


def old_system_llvms() -> list[Path]:
    return [
        path
        for number in (14, 15, 16)
        for path in Path("/usr/lib").glob(f"*-linux-gnu/libLLVM-{number}*.so*")
        if path.is_file()
    ]


def fake_libraries(folder: Path, monkeypatch: pytest.MonkeyPatch, versions: dict[str, str]) -> None:
    for name in versions:
        (folder / name).write_bytes(b"not a library")
    monkeypatch.setattr(backend, "_version_of", lambda path: versions[path.name])


def test_package_is_chosen_before_the_system() -> None:
    """The library of karellen-llvm-core is taken where it lies, with its version."""
    choice = choose_llvm(environment={})
    if choice.source != "karellen-llvm-core":
        pytest.skip("karellen-llvm-core is not installed here")
    assert choice.path.is_file()
    assert not choice.path.is_symlink() or choice.path.resolve().parent == choice.path.parent
    assert int(choice.version.split(".")[0]) >= MINIMUM_LLVM


@pytest.mark.usefixtures("no_package")
def test_newest_system_library_is_chosen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Among the system's libraries the newest counts by number, not by spelling, and old ones never."""
    versions = {
        "libLLVM-14.so.1": "14",
        "libLLVM-16.so.1": "16.0.6",
        "libLLVM.so.9": "9.0.1",
        "libLLVM.so.19.1": "19.1.7",
        "libLLVM-18.so": "18.1.8",
    }
    fake_libraries(tmp_path, monkeypatch, versions)
    assert choose_llvm({}, [str(tmp_path)]) == LlvmChoice(tmp_path / "libLLVM.so.19.1", "19.1.7", "system")


@pytest.mark.usefixtures("no_package")
@pytest.mark.parametrize("version", ["14", "15", "16.0.6", "unusable", "older than 16"])
def test_old_system_libraries_are_never_chosen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, version: str
) -> None:
    """LLVM 14 is refused by Dr.Jit, 15 and 16 abort the process: a message, not a choice."""
    fake_libraries(tmp_path, monkeypatch, {"libLLVM-x.so": version})
    with pytest.raises(BackendError, match=r"expected version 17 or newer, found .*libLLVM-x.so.*; install"):
        choose_llvm({}, [str(tmp_path)])


@pytest.mark.usefixtures("no_package")
def test_no_llvm_at_all(tmp_path: Path) -> None:
    """Without any library the message says so and what to install."""
    with pytest.raises(BackendError, match="none at all") as caught:
        choose_llvm({}, [str(tmp_path)])
    assert "karellen-llvm-core" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("no_package")
def test_real_system_libraries_are_judged() -> None:
    """The libraries of this machine, whichever they are, are read and old ones refused."""
    try:
        choice = choose_llvm({}, SYSTEM_FOLDERS)
    except BackendError as error:
        for path in old_system_llvms():
            assert f"libLLVM-{path.name.split('-')[1][:2]}" in str(error)  # noqa: PT017
    else:
        assert int(choice.version.split(".")[0]) >= MINIMUM_LLVM


def test_named_library_that_is_too_old_is_refused() -> None:
    """A user who names the system's old LLVM gets an error in place of an aborted process."""
    old = old_system_llvms()
    if not old:
        pytest.skip("this machine has no LLVM 14 to 16")
    for path in old:
        with pytest.raises(BackendError, match="DRJIT_LIBLLVM_PATH: expected .*; unset it"):
            choose_llvm({"DRJIT_LIBLLVM_PATH": str(path)})


def test_named_library_must_exist_and_load(tmp_path: Path) -> None:
    """A wrong path, and a file that is no library, are told apart."""
    with pytest.raises(BackendError, match="which is no file"):
        choose_llvm({"DRJIT_LIBLLVM_PATH": str(tmp_path / "libLLVM.so")})
    (tmp_path / "libLLVM.so.19").write_bytes(b"not a library")
    with pytest.raises(BackendError, match="which is version unusable"):
        choose_llvm({"DRJIT_LIBLLVM_PATH": str(tmp_path / "libLLVM.so.19")})


def test_named_library_is_asked_for_its_version() -> None:
    """Naming the packaged library explicitly is accepted, and its version comes from the library."""
    packaged = choose_llvm({})
    version = backend._version_of(packaged.path)
    assert version.split(".")[:2] == packaged.version.split(".")[:2]
    assert choose_llvm({"DRJIT_LIBLLVM_PATH": str(packaged.path)}).path == packaged.path


def run_python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    inherited = {name: value for name, value in os.environ.items() if name != "DRJIT_LIBLLVM_PATH"}
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env={**inherited, "PYTHONPATH": str(ROOT), **environment},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_prepare_is_idempotent_and_uses_the_chosen_library() -> None:
    """After two calls Dr.Jit has mapped just the chosen library, one thread, and the variant for Sionna."""
    done = run_python(
        "from raytrace.propagation.backend import prepare, _loaded_llvm, VARIANT\n"
        "first, second = prepare(), prepare()\n"
        "import drjit, mitsuba\n"
        "assert first == second, (first, second)\n"
        "assert drjit.thread_count() == 1 and mitsuba.variant() == VARIANT\n"
        "assert _loaded_llvm().samefile(first.path), _loaded_llvm()\n"
    )
    assert done.returncode == 0, done.stderr


def test_import_of_another_llvm_before_is_reported(tmp_path: Path) -> None:
    """If Dr.Jit already runs on another LLVM, prepare says so instead of going on with it."""
    done = run_python(
        "from raytrace.propagation import backend\n"
        "from pathlib import Path\n"
        "from estimator.errors import BackendError\n"
        "backend.prepare()\n"
        f"other = Path({str(tmp_path / 'libLLVM.so')!r}); other.write_bytes(b'')\n"
        "backend.choose_llvm = lambda: backend.LlvmChoice(other, '19', 'system')\n"
        "try:\n"
        "    backend.prepare()\n"
        "except BackendError as error:\n"
        "    print(error)\n"
    )
    assert "imported before" in done.stdout, done.stderr


@pytest.mark.parametrize("missing", ["drjit", "mitsuba", "sionna"])
def test_missing_ray_tracer_is_an_error_with_a_remedy(missing: str) -> None:
    """Where a part of the ray tracer is not installed, prepare raises BackendError and says what to do."""
    done = run_python(
        "import sys\n"
        "from raytrace.propagation import backend\n"
        "from raytrace.propagation.backend import prepare\n"
        f"if {missing!r} == 'sionna':\n"
        "    backend.find_spec = lambda name: None\n"
        "else:\n"
        f"    sys.modules[{missing!r}] = None\n"
        "from estimator.errors import BackendError\n"
        "try:\n"
        "    prepare()\n"
        "except BackendError as error:\n"
        "    print(error)\n"
    )
    assert "pip install 'hapslam[raytrace]'" in done.stdout, done.stderr


def test_doctor_finds_this_machine_healthy() -> None:
    """All checks pass here, none has a remedy, and the traced paths are all there are."""
    checks = {check.name: check for check in diagnose()}
    assert all(check.ok for check in checks.values()), checks
    assert not any(check.remedy for check in checks.values())
    assert checks["path solve"].value.startswith("10 of 10 paths")
    assert checks["Mitsuba variant"].value == backend.VARIANT
    json.dumps([vars(check) for check in checks.values()])


@pytest.mark.usefixtures("no_package")
def test_doctor_without_llvm_gives_the_remedy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No LLVM: a failed check with its remedy, no exception, and no path solve attempted."""
    monkeypatch.setattr(backend, "choose_llvm", lambda: choose_llvm({}, [str(tmp_path)]))
    checks = {check.name: check for check in diagnose()}
    assert not checks["LLVM"].ok
    assert "karellen-llvm-core" in checks["LLVM"].remedy
    assert "path solve" not in checks


def test_doctor_without_mitsuba(monkeypatch: pytest.MonkeyPatch) -> None:
    """Missing packages are reported one by one with the command that installs them."""
    monkeypatch.setattr(
        backend, "_package_check", lambda name: Check(name, False, "not installed", "pip install it")
    )
    checks = {check.name: check for check in diagnose()}
    assert not checks["mitsuba"].ok
    assert checks["mitsuba"].remedy == "pip install it"
    assert "path solve" not in checks


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGABRT)", "signal 6"),
        ("raise SystemExit('no such thing')", "status 1: no such thing"),
        ("import time; time.sleep(60)", "no answer in 2 s"),
    ],
)
def test_doctor_survives_what_a_bad_llvm_does(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, code: str, said: str
) -> None:
    """An abort, an error and a hang of the test process become a failed check, not ours."""
    stub = tmp_path / "python"
    stub.write_text(f'#!/bin/sh\nexec {sys.executable} -c "{code}"\n')
    stub.chmod(0o755)
    monkeypatch.setattr(backend.sys, "executable", str(stub))
    monkeypatch.setattr(backend, "_PROBE_SECONDS", 2.0)
    (check,) = backend._probe(LlvmChoice(Path("/nowhere"), "19", "system"))
    assert not check.ok
    assert said in check.value
    assert "LLVM" in check.remedy
