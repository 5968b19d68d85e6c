"""All models of a survey in one world, including those that no tie joined for the mapper.

The largest model that positions or control points place defines the world; without one, the largest model. For a
further model, two sources are tried in the order of reliability. First the *matches* between its images and those
already in the world (``ties``): they need no positions, and a similarity confirmed by held-out matches is beyond
doubt. Then its own *positions* and control points (``georeferencing``). A model that neither places, or whose
rotation about a straight track is undetermined, is named with the reason and stays out: nothing is guessed. (ICP
between the points of models placed no model of any survey.) If matches and positions contradict each other, a
contradiction says so.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pycolmap

from tiegraph.scene.composed import merged
from tiegraph.scene.evidence import LIMIT
from tiegraph.scene.scene import Scene
from tiegraph.sfm.ties import TEST_COLUMNS, Joining, TieFit, TieTest, apart, moved
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.verified import VerifiedMatches
from tiegraph.sfm.world.fixes import Measurements
from tiegraph.sfm.world.georef import Georeference
from tiegraph.sfm.world.upright import RIGHT_ANGLE_DEG
from tiegraph.text import known_to

COLUMNS = [
    "model", "images", "in the world by", *TEST_COLUMNS, "positions differ m", "positions differ deg", "sigma m",
    "why not",
]  # fmt: skip


@dataclass(frozen=True)
class Joined:
    """How a further model came into the world, or why it did not.

    ``by``: matches, positions, or "". ``test``: of its matches, lengths in metres of the world, where there were any;
    ``off``: metres and degrees between matches and positions; ``sigma_m``: sigma of its place from positions.
    """

    number: int
    images: int
    by: str = ""
    test: TieTest | None = None
    off: tuple[float, float] | None = None
    sigma_m: float | None = None
    why_not: str = ""

    def row(self) -> list:
        """A row of the table (``COLUMNS``)."""
        told = [None] * len(TEST_COLUMNS) if self.test is None else self.test.cells()
        off = (None, None) if self.off is None else (_rounded(self.off[0]), round(self.off[1], 3))
        return [f"sparse/{self.number}", self.images, self.by, *told, *off, _rounded(self.sigma_m), self.why_not]

    def note(self, metric: bool) -> str:
        """A sentence for the notes."""
        name = f"model {self.number} ({self.images} images, in sparse/{self.number})"
        unit = "m" if metric else "model units"
        if self.by == "matches" and self.test is not None:
            test = self.test
            return (
                f"{name} joined to the others by {test.ties} matches over {test.pairs} image pairs; two halves of "
                f"these matches differ by {test.jump:.3f} {unit} and {test.turn_deg:.2f} deg"
            )
        if self.by:
            return (
                f"{name} placed by its own positions, with a sigma of about {self.sigma_m:.3f} m; no match ties it to "
                "the others"
            )
        return f"{name} is not in the world and not in the cloud: {self.why_not}"


@dataclass(frozen=True)
class OneWorld:
    """The georeference of the model that defines the world (``first``), the ``model`` of all that came into it (None:
    it is on disk), and the others one by one."""

    first: Georeference
    model: pycolmap.Reconstruction | None
    others: tuple[Joined, ...] = ()
    contradictions: tuple[str, ...] = ()

    def notes(self) -> list[str]:
        """The notes on the first model and on the others."""
        metric = self.first.scale_source != "none"
        return [*self.first.findings.notes, *(o.note(metric) for o in self.others)]

    def by_hand(self) -> list[str]:
        """A note on models that would need positions, for the papers' recipes, which join models by hand."""
        out = [o.images for o in self.others if not o.by]
        lost = [] if self.first.placed else ["no model is placed by its positions"]
        lost += [f"{sum(out)} images of {len(out)} models are not in the world frame"] if out else []
        why = "the recipe has no such step: its authors joined the models by hand"
        return [f"{', and '.join(lost)}: {why}"] if lost else []

    def table(self) -> dict[str, dict]:
        """How each further model came into the world; {} if there is only one model."""
        rows = [o.row() for o in self.others]
        return {"models in one world": {"columns": COLUMNS, "rows": rows}} if rows else {}

    def records(self) -> list[dict]:
        """The same for world.json: by what each model was placed, and with which evidence."""
        return [dict(zip(COLUMNS, o.row())) for o in self.others]


def one_world(
    models: Sequence[pycolmap.Reconstruction],
    scene: Scene,
    verified: VerifiedMatches,
    similarity: Callable[[pycolmap.Reconstruction, Measurements], Georeference],
    whole: Callable[[pycolmap.Reconstruction, Measurements], tuple[Georeference, pycolmap.Reconstruction]],
    given: Measurements,
    tuning: Tuning,
) -> OneWorld:
    """Bring the largest model that its positions place into the world, then the others, one after another: by
    matches, else by their own positions. ``given`` belongs to the first of ``models``.

    Two functions place a model by its own positions: ``similarity`` alone, and ``whole`` with the steps that follow
    it.
    """
    first, world = whole(models[0], given)
    if len(models) == 1:
        return OneWorld(first, world)
    blind = replace(given, shape=None, model_scale_sigma=float("nan"))
    alone = {k: similarity(models[k], blind) if k else first for k in range(len(models))}
    carrier = next((k for k, found in alone.items() if found.placed), 0)
    if carrier:
        first, world = whole(models[carrier], blind)
    joining = Joining(scene, verified, tuning.placement, models, {carrier: world})
    others: dict[int, Joined] = {}
    said: list[str] = []
    while left := [k for k in alone if k != carrier and k not in others]:
        if (tied := joining.strongest(left)) is not None:
            number, fit, test = tied
            off, sigma, why = _against_positions(number, first, alone[number], fit)
            said += why
            others[number] = Joined(
                number, models[number].num_reg_images(), "matches", test=test, off=off, sigma_m=sigma
            )
            joining.add(number, moved(models[number], fit.first_from_second))
            continue
        tried = [_by_positions(k, models[k], first, alone[k], joining.tests.get(k), tuning) for k in left]
        found = next((j for j in tried if j.by), None)
        if found is None:
            others |= {j.number: j for j in tried}
            break
        others[found.number] = found
        joining.add(found.number, whole(models[found.number], blind)[1])
    return OneWorld(
        first=first,
        model=merged([joining.world[k] for k in sorted(joining.world)]),
        others=tuple(others[k] for k in sorted(others)),
        contradictions=tuple(said),
    )


def _by_positions(
    number: int,
    model: pycolmap.Reconstruction,
    first: Georeference,
    own: Georeference,
    test: TieTest | None,
    tuning: Tuning,
) -> Joined:
    """Place by its positions a model that no match joins."""
    out = Joined(number, model.num_reg_images(), test=test)
    loose = "no match joins it to the others" if test is None else (
        f"{test.total} matches run between it and the others, of which {test.ties} agree with one similarity"
    )  # fmt: skip
    if not own.placed or own.placing is None:
        return replace(out, why_not=f"{loose}, and it has too few positions of its own")
    if not first.placed:
        return replace(out, why_not=f"{loose}, and the model that defines the world has no positions for comparison")
    roll = own.placing.fit.roll_sigma_deg
    if roll > tuning.world.up.lone_sigma_deg:
        known = known_to(roll, RIGHT_ANGLE_DEG, f"{roll:.0f} deg only")
        return replace(
            out, why_not=f"{loose}, and its positions do not determine the rotation about its track ({known})"
        )
    return replace(out, by="positions", sigma_m=_sigma(own))


def _against_positions(
    number: int, first: Georeference, own: Georeference, fit: TieFit
) -> tuple[tuple[float, float] | None, float | None, list[str]]:
    """(metres, degrees) between matches and positions, the sigma of the latter, and whether they contradict each
    other."""
    if not (first.placed and own.placed):
        return None, None, []
    off, sigma = apart(fit.first_from_second, own.world_from_model, fit), float(np.hypot(_sigma(own), _sigma(first)))
    if off[0] <= LIMIT * sigma:
        return off, sigma, []
    said = (
        f"model {number}: its matches with the others and its own positions differ by {off[0]:.2f} m, "
        f"{off[0] / sigma:.1f} sigmas; the matches were used"
    )
    return off, sigma, [said]


def _sigma(placed: Georeference) -> float:
    sigma = placed.uncertainty.sigma
    return float(np.hypot(sigma["position_m"], sigma["height_m"]))


def _rounded(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), 4)
