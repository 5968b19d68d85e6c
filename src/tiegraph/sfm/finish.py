"""The last steps for a mapped model, in a child process: adjustment, rig diagnostics, colours, sigmas, files.

Rolling shutters: a row is read ``readout`` x (row / height - 1/2) later than the middle row, whose time is that of
the pose (``motion``). The readout is one more unknown of the normal equations, with poses, points and all lenses
eliminated. Distortion that a lens model leaves out has the same effect where a vehicle drives straight on (KITTI, a
global shutter: 3 ms with a sigma of 0.3), so a readout too short for a real shutter, or one that explains next to
nothing, is not used. Two things are not modelled: motion that changes faster than the frames of a pass, and images
that were turned on their side (their rows are columns of the sensor).
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pycolmap
from scipy import sparse

from tiegraph.scene.atomic import claim
from tiegraph.scene.colmapmodel import read_model
from tiegraph.scene.evidence import LIMIT
from tiegraph.scene.evidence import table as statement_table
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment import lens
from tiegraph.sfm.adjustment.adjust import (
    final_adjustment,
    free_cameras,
    robust_cost,
    take_possible,
    without_outliers,
)
from tiegraph.sfm.adjustment.constraints import nominal_geometry
from tiegraph.sfm.adjustment.jacobians import Layout, of_time
from tiegraph.sfm.covariance import Linearised, PositionSigma, position_sigma
from tiegraph.sfm.model import ROUNDS, Findings
from tiegraph.sfm.motion import Lateness, Motion, at_one_instant, in_their_time
from tiegraph.sfm.placement import (
    confirmed_places,
    explained,
    frame_ids,
    leave_out_doubtful,
    named,
    part_places,
    rivals,
    rivals_told,
    steps_of_parts,
)
from tiegraph.sfm.rig.confront import times_open
from tiegraph.sfm.rig.diagnostics import MATCHES, camera_matches
from tiegraph.sfm.rig.rig import place_as_given, units_per_metre
from tiegraph.sfm.rigcheck import Checked, FinishRequest, checked_rig
from tiegraph.sfm.shape import Shape
from tiegraph.sfm.tuning import ShutterTuning, SigmaTuning, Tuning
from tiegraph.sfm.verified import tears
from tiegraph.text import known_to, some

_NAMED = 3  # frames that a sentence names
Steps = Sequence[Mapping[int, np.ndarray]]
"""The steps (3,) to alternative places of frames (COLMAP's ids), model units; those of one mapping go there all or
none."""


@dataclass
class FinishResult(Findings):
    """The findings of the finishing of a model, and its sigmas."""

    sigma: PositionSigma | None = None
    shape: Shape | None = None


def finish_model(request: FinishRequest, send: Callable[[Any], None]) -> FinishResult:
    """Finish one mapped model and write it to its target folder.

    Frames whose matches contradict their place are left out. The rest is adjusted robustly and its rigs are tested
    against the images; where there is a rolling shutter, its effect is first removed from the key points. The matches
    between cameras are compared with the result. Cameras with hardly any match are placed by their rig, points get
    colours, and the covariances of the adjustment are estimated.
    """
    out, scene, tuning = FinishResult(), request.scene, request.tuning
    mapped = _without_doubtful(out, read_model(request.folder), request)
    claim(request.target)
    request.target.mkdir(parents=True, exist_ok=True)
    checked = _without_rolling(_adjusted(mapped, request), mapped, request)
    out.add(checked)
    if checked.statements:
        out.tables["given values and images compared"] = statement_table(checked.statements)
    if request.held.unsupported:
        place_as_given(checked.model, scene, request.held.unsupported, tuning.start.scale)
    given = {k: s.camera for k, s in enumerate(scene.all_sensors, start=1) if s.camera is not None}
    out.notes += [
        f"{scene.all_sensors[k - 1].name} keeps its intrinsics, given or guessed: its points do not determine them"
        for k in take_possible(checked.model, given, tuning.adjust)
    ]
    model = checked.model
    if checked.late:
        motion = Motion(model, scene, tuning.shutter.max_gap_s)
        model = in_their_time(_as_seen(model, mapped), motion, Lateness(checked.late), scene)
        without_outliers(model, tuning.adjust)
    steps, torn = _matches(out, model, request)
    try:
        if request.images is not None:
            model.extract_colors_for_all_images(request.images)
    except (RuntimeError, ValueError) as error:
        out.notes.append(f"the points have no colours: {error}")
    model.write(request.target)
    if torn:
        out.notes.append("position sigmas are not stated: the model is torn")
    else:
        _precision(out, checked, request, steps)
    return out


def _as_seen(model: pycolmap.Reconstruction, mapped: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
    """A copy of a model with its key points where they are in the images."""
    out = pycolmap.Reconstruction(model)
    for image_id in out.reg_image_ids():
        for own, seen in zip(out.image(image_id).points2D, mapped.image(image_id).points2D):
            own.xy = seen.xy
    return out


def _without_doubtful(
    out: FinishResult, model: pycolmap.Reconstruction, request: FinishRequest
) -> pycolmap.Reconstruction:
    """The model without the frames at doubtful places."""
    if request.matched is None:
        return model
    tested = pycolmap.Reconstruction(model)
    try:
        out.add(leave_out_doubtful(tested, request.scene, request.matched, request.tuning.placement))
    except (RuntimeError, ValueError, np.linalg.LinAlgError) as error:
        out.notes.append(f"the places of the frames could not be tested: {error}")
        return model
    return tested


def _adjusted(mapped: pycolmap.Reconstruction, request: FinishRequest) -> Checked:
    """A mapped model adjusted, its rigs checked."""
    out, held = Checked(model=mapped), request.held
    if not request.rough:
        if "soft" in held.modes.values():  # to metres, for the rig's priors with their sigmas
            scale = 1 / units_per_metre(mapped, request.scene, request.tuning.start.scale)
            mapped.transform(pycolmap.Sim3d(scale, pycolmap.Rotation3d(), np.zeros(3)))
        known, tuning = request.known(mapped), request.tuning.adjust
        adjustment = final_adjustment(mapped, held.fixed(), held.cameras, known, tuning=tuning)
        out.model, out.notes = adjustment.model, [adjustment.note]
    return checked_rig(out, mapped, request)


def _without_rolling(checked: Checked, mapped: pycolmap.Reconstruction, request: FinishRequest) -> Checked:
    """The same, or a new result from key points corrected for a rolling shutter, whose readout is
    given or estimated."""
    given, tuning, scene = request.held.readout_ms, request.tuning.shutter, request.scene

    def anew(last: Checked, seconds: float) -> Checked:
        motion = Motion(last.model, scene, tuning.max_gap_s)
        return _adjusted(at_one_instant(mapped, last.model, motion, Lateness({}, seconds)), request)

    if given == 0 or request.rough or (given is None and not request.covariance_frames):
        return checked
    if given is None:
        return _with_found(checked, anew, request)
    if rows_in_time(checked.model, scene, tuning) is None:
        checked.notes.append(
            f"sparse.readout_ms = {given:g} is not used: it needs frames of a pass with times (--times, video, "
            "EXIF), and images that are not views of panoramas or fisheye images"
        )
        return checked
    checked = anew(checked, given / 1000)
    checked.notes.append(f"rolling shutter, {given:g} ms as given: key points are moved to the time of the middle row")
    return checked


def _with_found(checked: Checked, anew: Callable[[Checked, float], Checked], request: FinishRequest) -> Checked:
    """The same, or ``anew`` with the readout that explains the images best, if they show a rolling shutter."""
    scene, fixed, tuning = request.scene, request.held.fixed(), request.tuning
    found = find_readout(checked.model, scene, fixed, tuning)
    if found is None or not found.there(tuning.shutter):
        return checked
    checked.notes.append(
        f"a rolling shutter of {found} would explain the images better, by {100 * found.gain:.1f} % of the robust "
        f"sum of squares: it is not used; to use it, give --sparse.readout-ms {1000 * found.seconds:.0f}"
    )
    if not found.clear(tuning):
        return checked
    last, seconds = checked, 0.0
    for _ in range(ROUNDS):
        seconds += found.step
        last = anew(last, seconds)
        found = find_readout(last.model, scene, fixed, tuning)
        if found is None or abs(found.seconds) < found.sigma:
            break
    cost, before = (robust_cost(c.model, tuning.adjust.robust_px) for c in (last, checked))
    if found is None or cost > (1 - tuning.adjust.used_gain) * before:
        return checked
    last.notes.append(
        f"rolling shutter of {replace(found, seconds=seconds)}, by the motion from frame to frame: key points are "
        f"moved to the time of the middle row, and the robust sum of squares fell by {100 * (1 - cost / before):.1f} "
        "%"
    )
    return last


def _matches(out: FinishResult, model: pycolmap.Reconstruction, request: FinishRequest) -> tuple[Steps, bool]:
    """How many of the verified matches the final model explains, which frames their matches still contradict, and
    whether the matches between cameras of rigs agree; returns steps to alternative places of frames, and whether the
    model is torn."""
    if request.matched is None or request.rough:
        return [], False
    scene, tuning = request.scene, request.tuning.placement
    try:
        found = explained(model, scene, request.matched.read(scene), tuning)
        other, places = rivals(found), part_places(found.in_doubt(found.tuning.agrees), tuning)
    except (RuntimeError, ValueError, np.linalg.LinAlgError) as error:
        out.notes.append(f"the matches could not be checked against the model: {error}")
        return [], False
    out.tables["matches that the model explains: frames with the fewest"] = found.table()
    out.counts["matches_explained_percent"] = round(found.percent(), 1)
    if found.percent() < 100 * found.tuning.explains:
        out.contradictions.append(
            f"only {found.percent():.0f} % of the verified matches agree with the model, where "
            f"{100 * found.tuning.explains:.0f} % and more agree with models that are right: parts of it are probably "
            "at a wrong place, because different places look alike; compare it with measured positions or control "
            "points, and give the rig and the positions if they are known"
        )
    out.contradictions += rivals_told(other, scene)
    parts, (confirmed, sure) = steps_of_parts(found, places), confirmed_places(places, scene)
    alone = [part[0] for part in found.parts if len(part) == 1]
    torn = [] if parts else tears(found.verified, found.agreed, scene, alone, found.tuning)
    out.contradictions += _torn_told(torn, scene)
    out.notes += confirmed
    for part in parts:
        away = float(np.median([np.linalg.norm(step) for step in part.values()]))
        out.contradictions.append(
            f"the matches of {len(part)} frames together support a second place too, {away:.3g} model units away; "
            f"their sigmas cover both places ({named(part.keys(), scene)})"
        )
    inside = {f for part in parts for f in part}
    if lost := found.doubts.keys() - other.keys() - sure - inside:
        out.contradictions.append(
            f"most matches of {len(lost)} frames contradict their final place: their errors may be larger than "
            f"stated ({named(lost, scene)})"
        )
    if request.held.modes:
        rows, said = camera_matches(found.verified, found.seen, scene, request.tuning.rig.diagnostics)
        out.tables |= {"matches between cameras": {"columns": MATCHES, "rows": rows}} if rows else {}
        out.contradictions += said
    groups = [*parts, *({f: r.step} for f, r in other.items() if f not in inside)]
    return [{k: step for f, step in group.items() for k in frame_ids(model, scene, f)} for group in groups], bool(torn)


def _torn_told(torn: Sequence[tuple[int, int, int, int]], scene: Scene) -> list[str]:
    names = scene.frame_names
    each = [f"{names[a]} and {names[b]}: {right} of {all_} agree" for a, b, right, all_ in torn]
    said = (
        f"the model is torn, because most matches between frames that follow each other contradict it, at "
        f"{len(torn)} of the gaps ({some(each, _NAMED)}): the parts are not in their place relative to each other, "
        "probably because different places look alike"
    )
    return [said] if torn else []


def _precision(out: FinishResult, checked: Checked, request: FinishRequest, steps: Steps) -> None:
    """The sigmas of positions, lenses and mountings."""
    scene, tuning, frames = request.scene, request.tuning.sigma, checked.model.num_reg_frames()
    if frames > request.covariance_frames:
        if request.covariance_frames:
            out.notes.append(f"position sigmas not computed: {frames} frames, more than sparse.covariance_frames")
        return
    try:
        sigma = _position_sigma(checked, request)
        out.shape = Shape.of(checked.model, sigma, scene, steps)
        out.sigma = sigma.covering(steps)
    except (ValueError, RuntimeError, np.linalg.LinAlgError) as error:
        out.notes.append(f"position sigmas could not be computed: {error}")
        return
    names = {k + 1: s.name for k, s in enumerate(scene.all_sensors)}
    out.notes += _open_notes(out.sigma, names, tuning)
    out.tables |= out.sigma.tables(names)


def _position_sigma(checked: Checked, request: FinishRequest) -> PositionSigma:
    """From the covariance of the adjustment, and from the deviations of the rigs beyond it."""
    model, scene, tuning, held = checked.model, request.scene, request.tuning, request.held
    free = free_cameras(model, tuning.adjust) - set(held.cameras)
    rigs = set(model.rigs) - set(held.fixed())
    motion = Motion(model, scene, tuning.shutter.max_gap_s)
    times = motion, times_open(scene, motion.timed, tuning.rig)
    sigma = position_sigma(model, free, rigs, nominal_geometry(model, scene), checked.off, times, tuning=tuning)
    if checked.misfit:  # a rig contradicted by this share gives no better scale
        sigma = replace(sigma, scale=max(sigma.scale or 0.0, checked.misfit))
    return sigma


def _open_notes(sigma: PositionSigma, names: Mapping[int, str], tuning: SigmaTuning) -> list[str]:
    return [
        f"the lever arm of {names.get(camera, camera)} is "
        f"{known_to(share, 1.0, f'{100 * share:.0f} % of its length only')}, because hardly any point ties it to the "
        "other cameras; a lever arm measured and given in a rig file would place its images"
        for camera, share in sigma.open_mountings(tuning).items()
    ]


@dataclass(frozen=True)
class Readout:
    """Seconds from the first row of an image to the last (negative: from the last), and their sigma; ``gain``: the
    share by which it lowers the robust cost; ``step``: the largest change in seconds in one step, because the robust
    cost is less curved far from its minimum; ``gap_s``: median time between the images whose poses determine the
    motion."""

    seconds: float
    sigma: float
    gain: float
    step: float
    gap_s: float

    def there(self, tuning: ShutterTuning) -> bool:
        """Whether this is a rolling shutter and not noise or lens distortion."""
        least, most = tuning.range_s
        sure = abs(self.seconds) > LIMIT * self.sigma and self.gain > tuning.told_gain
        return sure and least <= abs(self.seconds) <= most

    def clear(self, tuning: Tuning) -> bool:
        """Whether it is clear enough to be used without the user's request."""
        return self.gain > tuning.adjust.used_gain and self.gap_s <= tuning.shutter.used_gap_s

    def __str__(self) -> str:
        """In milliseconds."""
        return f"{1000 * self.seconds:.1f} ms (sigma {1000 * self.sigma:.1f})"


def rows_in_time(model: pycolmap.Reconstruction, scene: Scene, tuning: ShutterTuning) -> Motion | None:
    """The paths of a model's images; None where frames have no times or nothing moves, and for views of panoramas,
    whose rows are not those of the camera."""
    if any(s.source is not None and s.source.rendered for s in scene.all_sensors):
        return None
    motion = Motion(model, scene, tuning.max_gap_s)
    return motion if motion.timed and len(motion.gaps) else None


def find_readout(
    model: pycolmap.Reconstruction, scene: Scene, fixed_rigs: Collection[int], tuning: Tuning
) -> Readout | None:
    """The readout of all cameras of a model from its residuals; None without times, motion or redundancy.

    All lenses are unknowns, including calibrated ones.
    """
    motion = rows_in_time(model, scene, tuning.shutter)
    if motion is None:
        return None
    free = free_cameras(model, tuning.adjust)
    loose = lens.extended(model, lens.extensible(model, free, ("RADIAL", *lens.UNDISTORTED)))
    layout = Layout(loose, free, set(model.rigs) - set(fixed_rigs))
    try:
        found = Linearised(loose, layout, {}, tuning, tuning.rig.most_points)
        seen = found.weighed.seen
        ids, number = np.unique(seen.camera, return_inverse=True)
        height = np.array([loose.camera(k).height for k in ids.tolist()])[number]
        late = np.repeat(seen.xy[:, 1] / height - 0.5, 2)
        told = found.weighed.score((sparse.diags(late) @ of_time(seen, motion, np.arange(len(seen.xy)))).tocsr())
    except (ValueError, RuntimeError, np.linalg.LinAlgError):
        return None
    information = float(told.information[0, 0])
    if information <= 0:
        return None
    square = np.sum(found.weighed.seen.residual.reshape(-1, 2) ** 2, axis=1)
    cost = tuning.adjust.robust_px**2 * float(np.sum(np.log1p(square / tuning.adjust.robust_px**2)))
    score = float(told.score[0])
    first, second = found.weights
    return Readout(
        seconds=-score / information,
        step=-score / information * float(second.sum() / first.sum()),
        sigma=float(np.sqrt(max(told.noise[0, 0], 0.0))) / information,
        gain=score**2 / information / max(cost, 1e-12),
        gap_s=float(np.median(motion.gaps)),
    )
