"""Measurements and estimates keep every bit as text."""

from __future__ import annotations

import json
from dataclasses import fields

import numpy as np

from estimator.measurements import AnchorPaths, Epoch, GaussianVrp, MeasurementSet, Odometry
from estimator.slam import Prior, epoch_rng
from estimator.slam.run import config_for, engine_for
from service.messages.documents import epoch_text, estimate_document, read_epoch, read_estimate
from service.messages.epochs import EpochsRequest
from service.messages.requests import epoch_entry
from service.messages.terms import SessionTerms


def _random_epoch(seed: int) -> Epoch:
    """An epoch with every kind of entry and doubles of all sizes."""
    rng = np.random.default_rng(seed)

    def paths(count: int, powers: bool, angles: bool) -> AnchorPaths:
        positive = 10.0 ** rng.uniform(-9, -6, size=(2, count))
        return AnchorPaths(
            *positive,
            gain_db=rng.normal(size=count) if powers else None,
            azimuth_rad=rng.normal(size=count) if angles else None,
            azimuth_std_rad=rng.random(count) + 1e-3 if angles else None,
        )

    root = rng.normal(size=(2, 2))
    sweep = (GaussianVrp(rng.normal(size=2), root @ root.T + np.eye(2)),)
    heard = paths(5, True, False), paths(0, False, False), paths(3, True, True)
    asked = (True, False, True) if seed % 2 else None
    moved = Odometry(rng.normal(size=2), rng.normal(), np.diag(rng.random(3))) if seed % 3 else None
    return Epoch(7, rng.normal(), heard, sweep, False, asked, moved)


def _same(one: Epoch, two: Epoch) -> bool:
    names = ("index", "time_s", "heading_held", "asked")
    scalars = all(getattr(one, name) == getattr(two, name) for name in names)
    columns = all(
        np.array_equal(getattr(a, entry.name), getattr(b, entry.name))
        for a, b in zip(one.paths, two.paths, strict=True)
        for entry in fields(AnchorPaths)
        if getattr(a, entry.name) is not None
    )
    walls = all(
        np.array_equal(a.mean_m, b.mean_m) and np.array_equal(a.covariance_m2, b.covariance_m2)
        for a, b in zip(one.sweep, two.sweep, strict=True)
    )
    return scalars and columns and walls and _same_odometry(one.odometry, two.odometry)


def _same_odometry(one: Odometry | None, two: Odometry | None) -> bool:
    if one is None or two is None:
        return one is two
    return all(
        np.array_equal(getattr(one, entry.name), getattr(two, entry.name)) for entry in fields(Odometry)
    )


def test_epochs_survive_log_and_request() -> None:
    """Text of the log and body of a request give back every field, bit for bit."""
    anchors = ("a", "b", "c")
    for seed in range(20):
        epoch = _random_epoch(seed)
        assert _same(epoch, read_epoch(epoch_text(epoch)))
        body = json.dumps({"epochs": [epoch_entry(anchors, epoch)]})
        request = EpochsRequest.model_validate(json.loads(body))
        again = request.epochs[0].estimator_epoch(SessionTerms(anchors))
        assert _same(epoch, again)
        assert epoch_text(again) == epoch_text(epoch)


def test_estimates_survive_their_document(walk: MeasurementSet) -> None:
    """What the service shows of an estimate is all of it; unknown anchors are null, not NaN."""
    config = config_for(walk).but(clock_bias_std_m=0.5, height2_std_m2=1.0)
    engine = engine_for("hybrid", "gaussian", config)
    state = engine.start(Prior.of(walk), epoch_rng(0, -1))
    for epoch in (None, *walk.epochs[:12]):
        if epoch is not None:
            state = engine.step(state, epoch, epoch_rng(0, epoch.index))
        estimate = engine.estimate(state)
        document = json.loads(json.dumps(estimate_document(0, 0.0, walk.anchors, estimate), allow_nan=False))
        again = read_estimate(document)
        assert estimate.candidates
        parts = ((estimate, again), (estimate.integrity, again.integrity))
        for one, two in (*parts, *zip(estimate.candidates, again.candidates, strict=True)):
            for entry in fields(one):
                if entry.name not in ("candidates", "integrity", "state", "reasons"):
                    kept, shown = np.asarray(getattr(one, entry.name)), getattr(two, entry.name)
                    assert np.array_equal(kept, np.asarray(shown), equal_nan=True), entry.name
        told = estimate.integrity, again.integrity
        assert told[0].state == told[1].state
        assert told[0].reasons == told[1].reasons
    assert 0.0 < document["anchors"][0]["clock_bias_std_m"] <= 0.5
    assert document["anchors"][0]["height_std_m"] > 0.0
