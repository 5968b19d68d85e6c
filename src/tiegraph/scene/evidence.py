"""Statements of sources about a survey, with their sigmas, and contradictions between them.

A *statement* is one source's value of one quantity: the scale by the rig's file, by the images, by the positions.
Statements of one quantity are tested against each other; residuals are tested against noise (``trend``): a
line, a curve or a step is not noise.

Two statements contradict each other beyond 3.29 sigmas, a chance of 0.1 %. ``trend`` tests residuals for a line, a
curve, a step and an offset by generalised least squares over a first-order process. ``sparse`` states times,
mountings and lenses (rig as given, images); ``georef`` scale, heading, tilt, place, height and clock (positions,
control points, rig, gravity, orientations); ``evaluate`` its references. A contradiction is a sentence in
``Outcome.contradictions``: a line with ``!`` in the terminal, a box in the report, whose verdict is then *doubtful*.
The tests decide which sources are used (``sfm.world.weighing``): the baseline of a rig gives way to positions that fit
without a trend; if no test decides which source is right, the sigma of the scale covers both.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import fdtrc, ndtri, stdtr

from tiegraph.geometry.transforms import MAD

# The limit of a contradiction, everywhere: by the probability, for each test, that agreement is called one.
CHANCE = 0.001
LIMIT = float(-ndtri(CHANCE / 2))  # 3.29 sigmas
ENOUGH = 8  # values that tell a trend or a verdict from noise
FEW = 3  # values on either side of a step, or for a majority
RARELY = f"which chance does once in {1 / CHANCE:.0f} surveys at most"  # follows the result of a test below


def fits_better(before: float, after: float, free: int) -> bool:
    """Whether another interpretation of the same values leaves errors (root mean squares) smaller than by chance:
    the ratio of their squares against Fisher's distribution. ``free``: values less unknowns; for correlated errors of
    neighbours, no more than the effective number of values."""
    return free > 0 and bool(fdtrc(free, free, (before / max(after, 1e-12)) ** 2) <= CHANCE)


def mostly_more(differences: np.ndarray, tries: int) -> bool:
    """Whether paired differences (K,) are above zero by more than chance (Student's t), the best of several tries."""
    count = len(differences)
    if count < 2 or not np.mean(differences) > 0:
        return False
    error = max(float(np.std(differences, ddof=1)) / np.sqrt(count), 1e-12)
    return tries * float(stdtr(count - 1, -np.mean(differences) / error)) <= CHANCE


@dataclass(frozen=True)
class Statement:
    """The value of one source for a quantity. ``value`` and ``sigma`` in ``unit``; ``used``: the result rests on it."""

    quantity: str  # "scale", "heading", "tilt", "clock", "place of cam1", "focal length of cam0", ...
    source: str  # "rig as given", "images", "GNSS positions", "control points", "EXIF", "gravity", ...
    value: float
    sigma: float
    unit: str
    used: bool = False


@dataclass(frozen=True)
class Contradiction:
    """Two statements of one quantity that differ by more than chance allows."""

    first: Statement
    second: Statement
    sigmas: float  # the difference in its own sigmas

    def text(self, culprit: str = "") -> str:
        """One sentence with the figures, and the likeliest culprit in words."""
        a, b = self.first, self.second
        said = f"{a.quantity}: {_said(a)} and {_said(b)} contradict each other by {self.sigmas:.1f} sigmas"
        return f"{said}: {culprit}" if culprit else said


def contradictions(statements: Sequence[Statement]) -> list[Contradiction]:
    """Contradictory statements of one quantity, the worst first; those without a sigma are not tested."""
    known = [s for s in statements if np.isfinite([s.value, s.sigma]).all() and s.sigma > 0]
    pairs = ((a, b) for a, b in combinations(known, 2) if a.quantity == b.quantity and a.source != b.source)
    told = [Contradiction(a, b, abs(a.value - b.value) / float(np.hypot(a.sigma, b.sigma))) for a, b in pairs]
    return sorted((c for c in told if c.sigmas > LIMIT), key=lambda c: -c.sigmas)


def table(statements: Sequence[Statement]) -> dict:
    """Table of a receipt, one statement a row; contradicting ones in the last column."""
    found = contradictions(statements)
    rows = []
    for s in statements:
        against = [c.second if c.first is s else c.first for c in found if s is c.first or s is c.second]
        other = against[0].source if against else ""
        rows.append([s.quantity, s.source, s.value, s.sigma, s.unit, "yes" if s.used else "", other])
    return {"columns": ["quantity", "source", "value", "sigma", "unit", "used", "contradicted by"], "rows": rows}


@dataclass(frozen=True)
class Trend:
    """Form of residuals along the path that noise does not have: from ``start`` to ``end``, a curve by ``bow`` off the
    straight line between; a step after the share ``at`` of them. ``chance``: its probability in noise; ``sigmas``: half
    its size in sigmas of the values, of an offset its size."""

    form: str  # line, curve, step, offset
    start: float
    end: float
    bow: float
    at: float
    chance: float
    sigmas: float

    @property
    def size(self) -> float:
        """From its lowest to its highest; of an offset twice that."""
        return 2 * abs(self.start) if self.form == "offset" else max(abs(self.end - self.start), abs(self.bow))

    def text(self, unit: str = "m") -> str:
        """The form in words, with its figures; follows "the residuals"."""
        if self.form == "offset":
            return f"stand off by {self.start:+.2g} {unit} all the time"
        if self.form == "line":
            return f"run in a line from {self.start:+.2g} {unit} to {self.end:+.2g} {unit}"
        if self.form == "curve":
            return f"run in a curve: the middle is {self.bow:+.2g} {unit} off the ends"
        return f"jump by {self.end - self.start:+.2g} {unit} after {self.at:.0%} of the way"


def trend(values: np.ndarray, tests: int = 1, offset: bool = False, sigma: np.ndarray | float = 1.0) -> Trend | None:
    """The line, curve or step that values (K,) in order of time follow beyond chance, None if there is none.

    ``offset``: or the constant, if they should be about zero. A step may have a line beside it: residuals of a
    fit follow a step by rotating.

    Noise is taken to be a first-order process: its correlation, estimated about the form itself and raised by two of
    its own sigmas (short series look less correlated than they are), sets how many of the values count (generalised
    least squares and Student's t). Single bad values are left out, and few values give no result. ``tests``: number of
    tested series, so that all together alarm at 0.1 %. ``sigma`` (K,): of values of unequal accuracy.
    """
    y = np.asarray(values, float)
    x, sigma = np.linspace(-1.0, 1.0, len(y)), np.broadcast_to(np.asarray(sigma, float), y.shape)
    keep = np.flatnonzero(np.isfinite(y))
    if len(keep) >= ENOUGH:  # without values far from the middle between their neighbours
        told = (y / sigma)[keep]
        off = np.abs(told[1:-1] - 0.5 * (told[:-2] + told[2:]))
        keep = keep[np.r_[True, off <= 6 * MAD * float(np.median(off)) + 1e-12, True]]
    x, y, sigma = x[keep], y[keep], sigma[keep]
    if len(y) < ENOUGH or np.ptp(y) == 0:
        return None
    one = np.ones(len(y))
    shapes = [("line", x[:, None]), ("curve", np.stack([x, x**2], axis=1))]
    shapes += [("step", _best_step(y, beside, sigma)) for beside in (one[:, None], np.stack([one, x], axis=1))]
    if offset:
        shapes.append(("offset", np.zeros((len(y), 0))))
    places = len(y) - 2 * FEW + 1  # of a step
    tries = {"step": tests * len(shapes) * places}
    found = [_tested(y, sigma, n, s, tries.get(n, tests * len(shapes))) for n, s in shapes]
    best = min(found, key=lambda t: t.chance)
    return best if best.chance < CHANCE else None


def _best_step(y: np.ndarray, beside: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """The step that divides values (K,) best beside a form (K, P) that begins with a constant, which is omitted: (K, P)
    with the step as its last column."""
    cuts = np.arange(FEW, len(y) - FEW + 1)
    steps = (np.arange(len(y))[:, None] >= cuts).astype(float)
    y, told = y / sigma, steps / sigma[:, None]
    base = np.linalg.qr(beside / sigma[:, None])[0]
    off, free = y - base @ (base.T @ y), told - base @ (base.T @ told)
    best = int(np.argmax((off @ free) ** 2 / np.sum(free**2, axis=0)))
    return np.column_stack([beside[:, 1:], steps[:, best]])


def _tested(y: np.ndarray, sigma: np.ndarray, form: str, shape: np.ndarray, tries: int) -> Trend:
    """A form (K, P) fitted to values (K,), and the chance of its last column times the number of tries."""
    design = np.column_stack([np.ones(len(y)), shape])
    count, unknowns = design.shape
    told, seen = design / sigma[:, None], y / sigma
    plain = np.linalg.lstsq(told, seen, rcond=None)[0]
    r = _correlation(seen - told @ plain, unknowns)
    white = [np.vstack([np.sqrt(1 - r * r) * a[:1], a[1:] - r * a[:-1]]) for a in (told, seen[:, None])]
    normal = np.linalg.pinv(white[0].T @ white[0])
    best = normal @ white[0].T @ white[1][:, 0]
    free = count - unknowns - 1  # the correlation is one more
    rest = float(np.sum((white[1][:, 0] - white[0] @ best) ** 2)) / free
    known_to = float(np.sqrt(max(rest * normal[-1, -1], 1e-300)))
    chance = min(1.0, 2 * tries * float(stdtr(free, -abs(best[-1]) / known_to)))
    line = design[:, -1] * plain[-1] if form == "step" else design @ plain
    bow = float(-plain[-1]) if form == "curve" else 0.0
    at = float(1 - shape[:, -1].mean()) if form == "step" else float("nan")
    about = 0.0 if form == "offset" else float(np.average(line, weights=1 / sigma**2))
    off = (line - about) / sigma
    sigmas = float(np.abs(off).max() if form == "offset" else np.ptp(off) / 2)
    return Trend(form=form, start=float(line[0]), end=float(line[-1]), bow=bow, at=at, chance=chance, sigmas=sigmas)


def _correlation(rest: np.ndarray, unknowns: int) -> float:
    """Lag-one correlation of residuals about a form, without bias and raised by some sigmas; from 0, below 1."""
    count = len(rest)
    r = float(rest[1:] @ rest[:-1]) / max(float(rest @ rest), 1e-300)
    r += (unknowns + (unknowns + 2) * r) / count
    r += 2 * float(np.sqrt(max(1 - r * r, 0.0) / count))
    return float(np.clip(r, 0.0, 0.98))


def figures(value: float, sigma: float) -> str:
    """A value to two digits of its sigma."""
    digits = int(np.clip(1 - np.floor(np.log10(sigma)), 0, 9)) if sigma > 0 and np.isfinite(sigma) else 6
    return f"{round(value, digits) + 0.0:.{digits}f}"


def _said(s: Statement) -> str:
    return f"{s.source} {figures(s.value, s.sigma)} +- {s.sigma:.2g} {s.unit}".rstrip()
