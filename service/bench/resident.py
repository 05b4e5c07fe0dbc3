"""How much memory a piece of work needs on top of what the process holds."""

from __future__ import annotations

from pathlib import Path

__all__ = ["PeakMemory"]

_STATUS = Path("/proc/self/status")
_RESET = Path("/proc/self/clear_refs")


class PeakMemory:
    """Resident memory of this process: its peak since :meth:`begin`; needs Linux's ``/proc``."""

    def __init__(self) -> None:
        self.available = _RESET.exists()
        self._before_mib = 0.0

    def begin(self) -> None:
        """Forget the peak so far."""
        if self.available:
            try:
                _RESET.write_text("5", encoding="ascii")
            except OSError:
                self.available = False
            self._before_mib = self.resident_mib()

    def peak_mib(self) -> float:
        """Highest resident memory since the beginning, MiB; 0 where the system does not tell."""
        return _field_mib("VmHWM") if self.available else 0.0

    def growth_mib(self) -> float:
        """The peak above what was resident at the beginning, MiB; 0 where the system does not tell."""
        return max(self.peak_mib() - self._before_mib, 0.0)

    def resident_mib(self) -> float:
        """Resident memory now, MiB; 0 where the system does not tell."""
        return _field_mib("VmRSS") if self.available else 0.0


def _field_mib(name: str) -> float:
    for line in _STATUS.read_text(encoding="ascii").splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1]) / 1024.0
    return 0.0
