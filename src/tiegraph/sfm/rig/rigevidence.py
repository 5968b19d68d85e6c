"""Statements of rig file and images on the rig, and sentences on their contradictions."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import model_rigs
from tiegraph.scene.evidence import LIMIT, Contradiction, Statement
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.sfm.rig.priortest import Group, PriorTest

GIVEN, IMAGES = "rig as given", "images"
_ONE_CAUSE = (
    "is it the file of another rig, do focal lengths or distortions differ from their calibration, or is the model "
    "torn?"
)


@dataclass(frozen=True)
class RigEvidence:
    """Statements on each camera of a rig, sentences on those that contradict each other, and ``misfit``: the
    contradicted deviations of the cameras relative to their lever arms (root mean square of all)."""

    statements: tuple[Statement, ...]
    contradictions: tuple[str, ...]
    misfit: float = 0.0


@dataclass(frozen=True)
class _Pair:
    """One quantity of a sensor as given and from the images, and the sentence for a contradiction of both."""

    sensor: int
    given: Statement
    found: Statement
    culprit: str

    def contradiction(self) -> list[str]:
        """The sentence, if they contradict each other."""
        sigmas = abs(self.given.value - self.found.value) / float(np.hypot(self.given.sigma, self.found.sigma))
        return [Contradiction(self.given, self.found, sigmas).text(self.culprit)] if sigmas > LIMIT else []


def statements(
    test: PriorTest, scene: Scene, index: int, refined: pycolmap.Reconstruction | None = None
) -> RigEvidence:
    """Place, rotation, lens of each camera and times: as given, and from the images.

    ``refined``: a model adjusted with the freed mountings; its deviations are more accurate than those of a first
    step.
    """
    rig = scene.rigs[index]
    mounted: list[_Pair] = []
    pairs: list[_Pair] = []
    for sensor in range(len(rig.sensors)):
        if ("mount", sensor) in test.freed:
            own = _mounting(test, scene, index, sensor, refined)
            mounted += own
            pairs += own
        if ("lens", sensor) in test.freed:
            pairs.append(_focal(test, scene, index, sensor))
    elsewhere = [p for p in mounted if p.contradiction()]
    times = _times(test, rig) if rig.synchronised else []
    return RigEvidence(
        statements=tuple(s for p in (*pairs, *times) for s in (p.given, p.found)),
        contradictions=(
            *_beyond_telling(test, rig),
            *(line for p in pairs for line in p.contradiction()),
            *_one_cause({p.sensor for p in elsewhere}, rig),
            *(line for p in times for line in p.contradiction()),
        ),
        misfit=_misfit({p.sensor: abs(p.found.value) for p in elsewhere if p.found.unit == "m"}, rig),
    )


def _beyond_telling(test: PriorTest, rig: Rig) -> list[str]:
    """Sentences on deviations so large that no figure is given."""
    if not test.beyond:
        return []
    if len(rig.sensors) == 1:
        return [
            f"camera {rig.sensors[0].name}: the images contradict its calibration by so much that no figure can be "
            "given: is it the focal length or distortion of another lens, zoom or image size?"
        ]
    names = ", ".join(rig.sensors[k].name for k in test.beyond)
    return [f"rig {rig.name}: the images contradict it by so much that no figures can be given ({names}): {_ONE_CAUSE}"]


def _one_cause(sensors: Collection[int], rig: Rig) -> list[str]:
    """A sentence for several deviating cameras: a bent model hardly shows which camera it is."""
    if len(sensors) < 2:
        return []
    many = f"{len(sensors)} of its {len(rig.sensors)} cameras"
    return [f"rig {rig.name}: {many} are mounted differently from its file: {_ONE_CAUSE}"]


def _times(test: PriorTest, rig: Rig) -> list[_Pair]:
    """The firing times of the cameras of a rig that is given as synchronised."""
    timed, held_to = test.system.timed, test.known.tuning.confront.held_to_time
    unit, factor = ("ms", 1000.0) if timed else ("% of the frame interval", 100.0)
    out = []
    for sensor, (late, sigma) in test.times_s().items():
        name, source = f"time of {rig.sensors[sensor].name}", "rig file (synchronised)"
        given = Statement(quantity=name, source=source, value=0.0, sigma=held_to, unit=unit, used=True)
        found = Statement(quantity=name, source=IMAGES, value=factor * late, sigma=factor * sigma, unit=unit)
        culprit = "the cameras do not fire at one instant"
        out.append(_Pair(sensor=sensor, given=given, found=found, culprit=culprit))
    return out


def _misfit(off_m: Mapping[int, float], rig: Rig) -> float:
    """Root mean square of the deviations of the cameras of a rig relative to their lever arms, metres by sensor."""
    if not off_m:
        return 0.0
    poses = np.stack([np.eye(4) if s.sensor_from_rig is None else s.sensor_from_rig for s in rig.sensors])
    lever = np.linalg.norm(transforms.centre(poses), axis=1)
    lever[0] = np.median(lever[1:])  # the reference has no lever arm
    off = np.array([off_m.get(k, 0.0) for k in range(len(lever))])
    return float(np.sqrt(np.sum((off / np.maximum(lever, 1e-3)) ** 2) / (len(lever) - 1)))


def _mounting(
    test: PriorTest, scene: Scene, index: int, sensor: int, refined: pycolmap.Reconstruction | None
) -> list[_Pair]:
    """Place and rotation along the axis with the largest deviation, as given (0) and from the images, in the frame of
    the rig."""
    system, camera, held_to = test.system, scene.rigs[index].sensors[sensor], test.known.tuning.confront
    solution = test.until(("mount", sensor))
    sigma = solution.sigma()
    out = []
    culprit = f"camera {camera.name} is mounted differently from the rig file, or was moved"
    culprit += _or_late(test, ("mount", sensor))
    found = None if refined is None else _moved(refined, scene, index, sensor, system.metres_per_unit)
    for what, given, factor, unit in (
        ("place", max(camera.sigma_m or 0.0, held_to.held_to_m), 1.0, "m"),
        ("turn", max(camera.sigma_deg or 0.0, held_to.held_to_deg), 180 / np.pi, "deg"),
    ):
        at = [k for k in system.where(what) if system.keys[k][1] == sensor]
        values = factor * solution.value[at] if found is None else found[what]
        wide = np.hypot(factor * sigma[at], given)
        axis = int(np.argmax(np.abs(values) / wide))
        name = f"{what} of {camera.name} ({('right', 'down', 'forward')[axis]})"
        own = float(factor * sigma[at][axis])
        out.append(
            _Pair(
                sensor=sensor,
                given=Statement(quantity=name, source=GIVEN, value=0.0, sigma=given, unit=unit, used=True),
                found=Statement(quantity=name, source=IMAGES, value=float(values[axis]), sigma=own, unit=unit),
                culprit=culprit,
            )
        )
    return out


def _or_late(test: PriorTest, group: Group) -> str:
    """A remark on times, if these would explain at least half as much as the freed values."""
    system, known = test.system, test.known
    none, own, late = (
        system.solve(known.sigma(system, freed, times)).gain
        for freed, times in (((), False), ((group,), False), ((), True))
    )
    return (
        ("; or cameras fire at different times, which has nearly the same effect here")
        if late - none > (own - none) / 2
        else ""
    )


def _moved(
    model: pycolmap.Reconstruction, scene: Scene, index: int, sensor: int, metres_per_unit: float
) -> dict[str, np.ndarray]:
    """Deviation of a camera of the model's rig from the file: place (m) and rotation (deg) in the rig frame."""
    rig = model_rigs(model, scene)[index]
    own, given = rig.sensors[sensor].sensor_from_rig, scene.rigs[index].sensors[sensor].sensor_from_rig
    assert own is not None and given is not None
    metric = transforms.rigid(own[:3, :3], metres_per_unit * own[:3, 3])
    there, told = transforms.invert(metric), transforms.invert(given)
    turned = np.degrees(Rotation.from_matrix(there[:3, :3] @ told[:3, :3].T).as_rotvec())
    return {"place": there[:3, 3] - told[:3, 3], "turn": turned}


def _focal(test: PriorTest, scene: Scene, index: int, sensor: int) -> _Pair:
    """The calibrated focal length."""
    system, camera = test.system, scene.rigs[index].sensors[sensor]
    assert camera.camera is not None
    at = next(k for k in system.where("lens") if system.keys[k][1:] == (sensor, 0))
    focal = float(camera.camera.mean_focal_length())
    name = f"focal length of {camera.name}"
    solution = test.until(("lens", sensor))
    own = float(solution.sigma()[at])
    held_to = test.known.tuning.confront.held_to_lens * focal
    return _Pair(
        sensor=sensor,
        given=Statement(quantity=name, source="calibration", value=focal, sigma=held_to, unit="px", used=True),
        found=Statement(quantity=name, source=IMAGES, value=focal + float(solution.value[at]), sigma=own, unit="px"),
        culprit=f"camera {camera.name} has another lens than its calibration, or was zoomed"
        + _or_late(test, ("lens", sensor)),
    )
