"""The first steps of a process, before anyone waits for them: compiled code is made or loaded by them."""

from __future__ import annotations

from estimator.measurements import GaussianVrp
from service.documents import dump, epoch_text, sweep_text
from service.example import example
from service.fold import Job, fold
from service.schemas import SessionRequest, SiEpoch

__all__ = ["warm_up"]

_EPOCHS = 40  # of the example: anchors are found in them, and walls are born


def warm_up() -> None:
    """Step the beginning of the shipped example."""
    shipped = example(1)
    wanted = SessionRequest.model_validate(shipped["session"])
    walls = [GaussianVrp(wall["vrp_m"], wall["covariance_m2"]) for wall in shipped["sweep"]["walls"]]
    epochs = [
        SiEpoch.model_validate(entry).estimator_epoch(wanted.anchors) for entry in shipped["epochs"][:_EPOCHS]
    ]
    fold(Job("", dump(wanted.config()), (sweep_text(0, walls),), None, tuple(map(epoch_text, epochs))))
