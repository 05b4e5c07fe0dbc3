"""Numbers that decide something are named settings: no other numeric constants stand at heads of modules."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
SLAM = ROOT / "estimator" / "slam"
ALLOWED = {
    # positions in the state vector, sizes and codes
    "models/state_vector.py": {"THETA", "ECHO_BIAS", "HEADING", "FIRST_ANCHOR", "PER_ANCHOR", "NOWHERE_M"},
    "models/features.py": {"MOST_ENTRIES"},
    "models/sweeps.py": {"FLASH_ENTRIES", "_LEAST_SHARE"},
    # of angles of which nothing is known: the variance of a uniform one
    "models/directions.py": {"_ANY_HEADING_RAD2"},
    "gaussian/sweep_update.py": {"_ANY_HEADING_RAD2", "_QUARTER"},
    # numerical floors
    "gaussian/integrity.py": {"_LEAST_STD_M", "_LEAST_DOUBT"},
    "gaussian/map_search.py": {"FAR"},
    "gaussian/relocation.py": {"_LEAST_M"},
    "gaussian/anchor_survey.py": {"_KNOWN_M2"},
    "gaussian/recalled_track.py": {"_ROUNDING_M2"},
    # rounding at which an iteration stops
    "association/belief_propagation.py": {"ITERATIONS", "_SETTLED"},
    # bounds: variances of what is not known, and directions of a quadrature
    "bounds/scenario.py": {"_ANY_CLOCK_M2", "_ANY_HEADING_RAD2", "_UNKNOWN_M2"},
    "bounds/posterior.py": {"_DIRECTIONS"},
    # anchor search: numerical floors and tolerances, the size of a table, derivatives of one path
    "anchors/initialise.py": {"_KNOWN_M2"},
    "anchors/joint_update.py": {"_LOG_2PI", "_PER_PATH"},
    "anchors/observations.py": {"_LEAST_LOSS_RATIO", "_BUCKETS"},
    "run.py": {"_STRETCH"},
    "anchors/refinement.py": {"_STILL_M", "_FLAT", "ITERATIONS"},
    "anchors/seeds.py": {"_SHORTEST_M"},
    "anchors/survey.py": {"_LEAST_M2"},
    # particles: places that mean nothing known, floors, sizes of what is worked on at a time, a polynomial
    "particle/anchors.py": {"_ANY_CARRIER_HZ"},
    "particle/births.py": {"_SMALLEST"},
    "particle/cloud.py": {"_LANES", "_PIECE"},
    "particle/config.py": {"_ANYWHERE_M"},
    "particle/exponential.py": {
        *("_C0", "_C1", "_C2", "_C3", "_C4", "_C5", "_LOG2_E", "_TO_WHOLE"),
        *("_LEAST", "EXP_RELATIVE_ERROR"),
    },
    "particle/pairings.py": {"_LANES", "_PIECE", "_SMALLEST"},
    # smoother: floors that keep it solvable, rounds of an iteration, entries of the agent
    "smoothing/association.py": {"_ROUNDS", "_SURE"},
    "smoothing/factors.py": {"_VAGUE"},
    "smoothing/linearise.py": {"_AGENT", "JITTER_M2"},
    "smoothing/map_evidence.py": {"_AGENT_ENTRIES"},
    # what kinds of settings take
    "models/settings.py": {"_RULES"},
    # what is told of an estimate
    "protocol.py": {"MOST", "LEAST_WEIGHT"},
}


def numeric_constants(file: Path) -> set[str]:
    """Names that a module gives numbers, or arrays of numbers, at its head."""
    found = set()
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign):
            names = [target.id for target in node.targets if isinstance(target, ast.Name)]
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names = [node.target.id]
        else:
            continue
        value = node.value
        numbers = value is not None and any(
            isinstance(part, ast.Constant)
            and isinstance(part.value, (int, float))
            and not isinstance(part.value, bool)
            for part in ast.walk(value)
        )
        sliced = isinstance(value, ast.Call) and ast.unparse(value.func) in {"slice", "TypeVar"}
        if numbers and not sliced:
            found.update(names)
    return found


def test_numeric_constants_are_those_of_the_list() -> None:
    """A threshold at the head of a module cannot be set, and nobody sees what it decides."""
    files = sorted(SLAM.rglob("*.py"))
    assert len(files) > 60
    for file in files:
        name = str(file.relative_to(SLAM))
        assert numeric_constants(file) <= ALLOWED.get(name, set()), name


def test_the_list_names_nothing_that_is_gone() -> None:
    """An entry without its constant would let another in."""
    for name, constants in ALLOWED.items():
        assert numeric_constants(SLAM / name) == constants, name
