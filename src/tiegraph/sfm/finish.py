"""What a mapped model still needs, inside a child process: adjustment, rig diagnostics, colours, sigmas, files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pycolmap

from tiegraph.scene.atomic import claim
from tiegraph.scene.colmapmodel import read_model
from tiegraph.scene.evidence import table as statement_table
from tiegraph.scene.scene import Scene
from tiegraph.sfm import shutter
from tiegraph.sfm.adjustment import constraints
from tiegraph.sfm.adjustment.adjust import final_adjustment, free_cameras, robust_cost
from tiegraph.sfm.adjustment.rigpriors import nominal_geometry, rig_priors
from tiegraph.sfm.covariance import Mounting, PositionSigma, position_sigma
from tiegraph.sfm.placement.doubtful import PlacementCheck, leave_out_doubtful
from tiegraph.sfm.relativesigma import between_frames, own_paths
from tiegraph.sfm.rig import cameramatches
from tiegraph.sfm.rig.support import place_as_given, units_per_metre
from tiegraph.sfm.rigcheck import Checked, FinishRequest, checked_rig
from tiegraph.sfm.tuning import SigmaTuning
from tiegraph.sfm.verified import image_observations, read_verified
from tiegraph.text import known_to


@dataclass(frozen=True)
class FinishResult:
    """What the finishing of a model has to say of it."""

    sigma: PositionSigma | None
    notes: list[str]
    tables: dict[str, dict] = field(default_factory=dict)
    dropped: list[tuple[str, str]] = field(default_factory=list)  # images left out for their place
    contradictions: list[str] = field(default_factory=list)


def finish_model(request: FinishRequest, send: Callable[[Any], None]) -> FinishResult:
    """Final adjustment, rig diagnostics, colours and position sigmas of one model; writes it to its target folder."""
    scene = Scene.from_json(request.scene)
    model = read_model(request.folder)
    mapped, placed = _placed(model, scene, request)
    claim(request.target)
    request.target.mkdir(parents=True, exist_ok=True)
    checked = _without_rolling(_finished(mapped, scene, request), mapped, scene, request)
    model, tables, notes = checked.model, checked.tables, placed.notes + checked.notes
    if checked.statements:
        tables["what was given, and the images"] = statement_table(checked.statements)
    _ties_between(checked, scene, request, notes)
    if request.held.unsupported:
        place_as_given(model, scene, request.held.unsupported, request.tuning.rig.support)
    try:
        if request.images is not None:
            model.extract_colors_for_all_images(request.images)
    except (RuntimeError, ValueError) as error:
        notes.append(f"the points have no colours: {error}")
    model.write(request.target)
    if placed.table is not None:
        tables["placement"] = placed.table
    sigma = _sigma(checked, scene, request, notes)
    if sigma is not None:
        sigma = replace(sigma, mounting=_in_their_time(sigma.mounting, checked.levers))
        if checked.misfit:  # a rig that is contradicted by so much gives no scale better than that
            sigma = replace(sigma, scale=max(sigma.scale or 0.0, checked.misfit))
        names = {k + 1: s.name for k, s in enumerate(scene.all_sensors)}
        tables |= {**sigma.tables(names), **between_frames(model, sigma, request.tuning.sigma.between_pairs)}
        tables |= own_paths(model, sigma, names) if checked.ties else {}
        notes += _open_notes(sigma, names, request.tuning.sigma)
    return FinishResult(
        sigma=sigma, notes=notes, tables=tables, dropped=placed.dropped, contradictions=checked.contradictions
    )


def _placed(
    model: pycolmap.Reconstruction, scene: Scene, request: FinishRequest
) -> tuple[pycolmap.Reconstruction, PlacementCheck]:
    """The model without the frames whose place is doubtful, and what is to be said of them."""
    if request.matched is None:
        return model, PlacementCheck()
    tested = pycolmap.Reconstruction(model)
    try:
        return tested, leave_out_doubtful(tested, scene, request.matched, request.preview, request.tuning.placement)
    except (RuntimeError, ValueError, np.linalg.LinAlgError) as error:
        return model, PlacementCheck([f"the place of the frames could not be tested: {error}"])


def _finished(mapped: pycolmap.Reconstruction, scene: Scene, request: FinishRequest) -> Checked:
    """A mapped model adjusted, its rigs checked."""
    model: pycolmap.Reconstruction = mapped
    notes: list[str] = []
    try:
        if not request.rough:
            model = _adjusted(mapped, scene, request, notes)
    except (RuntimeError, ValueError) as error:
        notes.append(f"the final adjustment failed, the mapper's own stays: {error}")
    checked = checked_rig(model, mapped, scene, request, notes)
    checked.notes = notes
    return checked


def _without_rolling(
    checked: Checked, mapped: pycolmap.Reconstruction, scene: Scene, request: FinishRequest
) -> Checked:
    """The same, or made anew of key points without what a rolling shutter did to them: as given, else if found."""
    given, tuning = request.held.readout_ms, request.tuning.shutter

    def anew(last: Checked, seconds: float) -> Checked:
        return _finished(shutter.unrolled(mapped, last.model, scene, seconds, tuning), scene, request)

    if given == 0 or request.rough or (given is None and not request.covariance_frames):
        return checked
    if given is None:
        return _with_found(checked, anew, scene, request)
    if not shutter.image_motion(checked.model, scene, tuning):
        checked.notes.append(
            f"sparse.readout_ms = {given:g} is not used: that needs frames of a pass with times (--times, video, EXIF) "
            "and images that are no views of panoramas or fisheye images"
        )
        return checked
    checked = anew(checked, given / 1000)
    checked.notes.append(
        f"rolling shutter, {given:g} ms as given: key points are where the middle row's pose sees them"
    )
    return checked


def _with_found(
    checked: Checked, anew: Callable[[Checked, float], Checked], scene: Scene, request: FinishRequest
) -> Checked:
    """The same, or ``anew`` with the readout that explains the images best, if they show one."""
    fixed, tuning = [k + 1 for k in request.held.fixed], request.tuning
    found = shutter.find_readout(checked.model, scene, fixed, tuning)
    if found is None or not found.there(tuning.shutter):
        return checked
    checked.notes.append(
        f"a rolling shutter of {found} would explain the images better, by {100 * found.gain:.1f} % of the robust sum "
        f"of squares: not used; to use it give --sparse.readout-ms {1000 * found.seconds:.0f}"
    )
    if not found.clear(tuning.shutter):
        return checked
    last, seconds = checked, 0.0
    for _ in range(tuning.shutter.rounds):
        seconds += found.step
        last = anew(last, seconds)
        found = shutter.find_readout(last.model, scene, fixed, tuning)
        if found is None or abs(found.seconds) < found.sigma:
            break
    cost, before = (robust_cost(c.model, tuning.adjust.robust_px) for c in (last, checked))
    if found is None or cost > (1 - tuning.shutter.used_gain) * before:
        return checked
    last.notes.append(
        f"rolling shutter of {replace(found, seconds=seconds)}, by the motion from frame to frame: key points are "
        f"where the middle row sees them, and the robust sum of squares fell by {100 * (1 - cost / before):.1f} %"
    )
    return last


def _adjusted(
    model: pycolmap.Reconstruction, scene: Scene, request: FinishRequest, notes: list[str]
) -> pycolmap.Reconstruction:
    rig = request.tuning.rig
    known = rig_priors(model, scene, (), rig.priors)
    fixed = [k + 1 for k in request.held.fixed]
    if request.held.soft and constraints.available():
        scale = 1 / units_per_metre(model, scene, rig.support)
        model.transform(pycolmap.Sim3d(scale, pycolmap.Rotation3d(), np.zeros(3)))
        known = rig_priors(model, scene, request.held.soft, rig.priors)
    elif request.held.soft:
        fixed += [k + 1 for k in request.held.soft]
        notes.append("the rig's sigmas are not used, its extrinsics stay as mapped: the package pyceres is missing")
    adjustment = final_adjustment(model, fixed, request.held.cameras, known, tuning=request.tuning.adjust)
    notes.append(adjustment.note)
    return adjustment.model


def _ties_between(checked: Checked, scene: Scene, request: FinishRequest, notes: list[str]) -> None:
    """Say whether the verified matches between the cameras of rigs agree with the model as it is in the end."""
    if request.matched is None or request.rough or not request.held.rigs:
        return
    try:
        seen = image_observations(checked.model, scene, request.tuning.placement.agreement)
        verified = read_verified(request.matched.database, scene, request.matched.refused)
        found = cameramatches.camera_matches(verified, seen, scene, request.tuning.rig.camera_matches)
    except (RuntimeError, ValueError, np.linalg.LinAlgError) as error:
        notes.append(f"the matches between cameras could not be checked: {error}")
        return
    if found:
        checked.tables["matches between cameras"] = cameramatches.table(found, scene)
    checked.contradictions += cameramatches.sentence(found, scene)


def _in_their_time(mounting: Mapping[int, Mounting], levers: Mapping[int, float]) -> dict[int, Mounting]:
    """Lever arms with sigmas that know that a camera's time and its place along the motion can be one unknown."""
    return {k: replace(m, sigma=max(m.sigma, levers.get(k, 0.0))) for k, m in mounting.items()}


def _open_notes(sigma: PositionSigma, names: Mapping[int, str], tuning: SigmaTuning) -> list[str]:
    return [
        f"the lever arm of {names.get(camera, camera)} is "
        f"{known_to(share, 1.0, f'{100 * share:.0f} % of its length only')}, for hardly a point ties it to the other "
        "cameras; measured and given in a rig file it would place its images"
        for camera, share in sigma.open_mountings(tuning).items()
    ]


def _sigma(checked: Checked, scene: Scene, request: FinishRequest, notes: list[str]) -> PositionSigma | None:
    model = checked.model
    frames = model.num_reg_frames()
    if frames > request.covariance_frames:
        if request.covariance_frames > 0:
            notes.append(f"position sigmas not computed: {frames} frames, more than sparse.covariance_frames")
        return None
    try:
        free = free_cameras(model, request.tuning.adjust) - set(request.held.cameras)
        rigs = set(model.rigs) - {k + 1 for k in request.held.fixed}
        return position_sigma(
            model, free, rigs, checked.ties, nominal_geometry(model, scene), checked.off, tuning=request.tuning
        )
    except (ValueError, RuntimeError, np.linalg.LinAlgError) as error:
        notes.append(f"position sigmas could not be computed: {error}")
        return None
