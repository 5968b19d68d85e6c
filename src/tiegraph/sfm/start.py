"""A model started from approximate poses instead of mapped from nothing: the preparation of the poses.

The start takes the poses of the coarse model, converts the rigs to their units, triangulates the full-resolution
matches from them and adjusts in rounds (``run``).

Before that, the length of the path is compared with a rig that must not change (``length_of_path``): the matches
determine it, else the positions; if neither does, the start is refused. The same test follows every mapper. In a
model made of few ties both can be right except for their ratio: cameras that look away from each other hardly
determine it (PandaSet's previews: wrong by factors of 16 to 40 000, which no residual shows and no adjustment
corrects). The scale is one number, and every match between frames votes for it: by the angle of its ray to the other
ray's epipolar plane, as a function of the scale. If the path is too long or too short by a quarter, it is mapped
again from its own poses with the length corrected.

Finally, a start model given by the user is compared with the model that the images gave (``check_start``): it may be
bent, rotated in one half, or of another survey. The reference is its largest consistent part: the rotation between
the two worlds that most images share, then the similarity of their positions. An image disagrees if it is rotated
relative to that part by more than the tuning allows, or is off by more than a share of the distance to the surface it
sees. World and unit of both models are free, so a model of another size agrees.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import LEAST_PLACES, angle_deg, cross, l1_mean_rotation, off_plane, robust_umeyama
from tiegraph.scene.colmapmodel import rigid3d
from tiegraph.scene.evidence import LIMIT
from tiegraph.scene.graph import parts
from tiegraph.scene.rig import Rig, rays_or_axis
from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import distances, frame_poses, relative_poses, rig_from_sensor
from tiegraph.sfm.tuning import StartCheckTuning, Tuning
from tiegraph.sfm.tuning.placement import ScaleTuning
from tiegraph.sfm.verified import VerifiedMatches

ONE_CENTRE = 1e-6  # metres: shorter baselines count as zero
_NAMED = 3  # images named in a sentence


Cost = Callable[[float, float], float]
"""Mean angle between rays and epipolar planes for a scale of the path, cut at a cap (rad) and in units of it."""


def length_of_path(
    world_from_rig: np.ndarray, scene: Scene, held: Collection[int], verified: VerifiedMatches, tuning: Tuning
) -> tuple[float, str] | None:
    """The scale that the path of frames (F, 4, 4) needs to agree with the rigs (indices ``held``) that must not
    change (1 = none, NaN = not determined), and what determines it: matches, else prior positions. None where nothing
    can be compared: panoramas, loose photographs."""
    cam_from_rig = transforms.invert(rig_from_sensor(scene))
    if not held or np.nanmax(np.linalg.norm(cam_from_rig[:, :3, 3], axis=1), initial=0.0) < ONE_CENTRE:
        return None
    agreement, bounds = tuning.placement.agreement, tuning.start.scale
    cost = _cost(scene, cam_from_rig, world_from_rig, verified, agreement.matches_a_pair)
    for cap_rad in (agreement.tolerance_rad / 3, agreement.tolerance_rad):  # the wide one next, for poor poses
        if cost is not None and (scale := _by_matches(cost, cap_rad, bounds)) is not None:
            return scale, "its matches"
    placed = _by_positions(scene, world_from_rig[:, :3, 3], bounds)
    return (float("nan"), "nothing") if placed is None else (placed, "the positions")


def _cost(
    scene: Scene, cam_from_rig: np.ndarray, world_from_rig: np.ndarray, verified: VerifiedMatches, most: int
) -> Cost | None:
    """``most``: number of matches of a pair of images that vote."""
    rng = np.random.default_rng(0)
    known = np.all(np.isfinite(cam_from_rig) & np.isfinite(world_from_rig[scene.frame]), axis=(1, 2))
    centre = transforms.centre(cam_from_rig)
    rows: list[Sequence[np.ndarray]] = []
    for (i, j), matches in zip(verified.pairs.tolist(), verified.matches):
        if scene.frame[i] == scene.frame[j] or not (known[i] and known[j]) or len(matches) == 0:
            continue
        if len(matches) > most:
            matches = matches[rng.choice(len(matches), most, replace=False)]
        poses, rays = [world_from_rig[scene.frame[k]] for k in (i, j)], []
        for k, pose, xy in zip((i, j), poses, (verified.xy[i][matches[:, 0]], verified.xy[j][matches[:, 1]])):
            camera = cast(pycolmap.Camera, scene.sensor_of(k).camera)  # the scan gave each sensor one
            rays.append(rays_or_axis(camera, xy) @ (cam_from_rig[k][:3, :3] @ pose[:3, :3].T))
        lever = poses[1][:3, :3] @ centre[j] - poses[0][:3, :3] @ centre[i]
        steps = [np.tile(step, (len(matches), 1)) for step in (poses[1][:3, 3] - poses[0][:3, 3], lever)]
        rows.append((rays[0], cross(*rays), *steps))
    if not rows:
        return None
    a, normal, path, lever = (np.concatenate(column) for column in zip(*rows))

    def cost(scale: float, cap_rad: float) -> float:
        return float(np.minimum(off_plane(scale * path + lever, a, normal), cap_rad).mean() / cap_rad)

    return cost


def _by_matches(cost: Cost, cap_rad: float, tuning: ScaleTuning) -> float | None:
    most, near = np.log(tuning.range), np.log(tuning.near)
    grid = np.linspace(-most, most, 1 + 2 * int(np.ceil(1.5 * most / near)))  # of steps no path is mapped again for
    for _ in range(2):
        costs = np.array([cost(float(np.exp(x)), cap_rad) for x in grid])
        best = float(grid[np.argmin(costs)])
        step = float(grid[1] - grid[0])
        grid = np.linspace(best - step, best + step, 21)  # scales tried around the best of them
    lowest = float(costs.min())
    beside = min(cost(float(np.exp(best + x)), cap_rad) for x in (-near, near))
    return float(np.exp(best)) if beside - lowest > tuning.dip * max(lowest, 1e-9) else None


def _by_positions(scene: Scene, centre: np.ndarray, tuning: ScaleTuning) -> float | None:
    """Scale from the positions, 1 where they confirm the length of the path; None if both are within the noise.

    Its sigma is that of one long distance, because the errors of a receiver are correlated. A vehicle that hardly
    moves has no distance above the noise, but a path a hundred times as long is still refuted.
    """
    apart, own, noise = distances(scene, centre, tuning)
    far = np.maximum(apart, own) > LIMIT * noise
    if far.sum() < tuning.least_distances:
        return None
    apart, own, noise = apart[far], own[far], noise[far]
    scale = float(np.median(np.maximum(apart, noise / LIMIT) / own))
    known_to = float(np.median(noise / np.maximum(apart, own)))
    clear = max(np.log(tuning.near), LIMIT * known_to)
    return scale if abs(np.log(scale)) > clear else 1.0


@dataclass(frozen=True)
class Start:
    """Approximate poses, prepared for a mapper.

    ``rigs`` by index: rigs that may change have extrinsics from the poses, rigs that must not change have their own;
    ``world_from_rig`` (F, 4, 4) and ``cam_from_world`` (N, 4, 4), for images without a rig, in one unit; NaN =
    unknown.
    """

    rigs: dict[int, Rig]
    world_from_rig: np.ndarray
    cam_from_world: np.ndarray
    notes: tuple[str, ...] = ()


def start_from(
    cam_from_world: np.ndarray,
    scene: Scene,
    given: Collection[int],
    held: Collection[int],
    verified: VerifiedMatches,
    tuning: Tuning,
) -> Start | None:
    """A start from poses (N, 4, 4) of the images, NaN = unknown, with the rigs ``given`` (indices), of which those
    ``held`` keep their extrinsics.

    None if the length of the path relative to a held rig is unknown: the poses may come from a model that did not use
    the rig.
    """
    most, rigs = tuning.start.max_lever_off, scene.rigs
    fitted = {k: rigs[k] if k in held else rig_of_poses(scene, k, cam_from_world, most) for k in given}
    scene = scene.with_(rigs=tuple(fitted.get(k, r) for k, r in enumerate(scene.rigs)))
    frames = frame_poses(cam_from_world, scene)
    found = length_of_path(frames, scene, held, verified, tuning)
    if found is None:
        return Start(fitted, frames, cam_from_world)
    scale, by = found
    if not np.isfinite(scale):
        return None
    frames[:, :3, 3] *= scale
    images = cam_from_world.copy()
    images[:, :3, 3] *= scale
    note = f"its path was scaled by {scale:.3g}, by {by}"
    return Start(
        rigs=fitted,
        world_from_rig=frames,
        cam_from_world=images,
        notes=() if f"{scale:.2g}" == "1" else (note,),
    )


def largest_component(cam_from_world: np.ndarray, scene: Scene, rigs: Collection[int], pairs: np.ndarray) -> np.ndarray:
    """(N,) bool: images of the component with most known poses, connected by verified pairs (P, 2) and by the mounted
    cameras of rigs. Images outside it would stay where a rough model had them, untested, and drift."""
    mounted = np.array([s.sensor_from_rig is not None for s in scene.all_sensors])[scene.sensor_key]
    bound = np.isin(scene.rig[scene.frame], list(rigs)) & (mounted | (scene.sensor == 0))
    node = np.where(bound, scene.frame, scene.frames + np.arange(len(scene)))
    label = parts(node[pairs[:, 0]], node[pairs[:, 1]], scene.frames + len(scene))[node]
    known = np.isfinite(cam_from_world).all(axis=(1, 2))
    largest = np.bincount(label[known]).argmax() if known.any() else -1
    return label == largest


def rig_of_poses(scene: Scene, index: int, cam_from_world: np.ndarray, max_lever_off: float) -> Rig:
    """The rig with the extrinsics of the poses, averaged over the frames; a sensor that no frame shows together with
    the reference keeps its own extrinsics, in the units of the others. One without extrinsics keeps none: it may not be
    rigid.

    ``max_lever_off``: largest relative deviation of the poses from a given lever arm; beyond it the given one stays.
    """
    rig = scene.rigs[index]
    shown = {
        b: transforms.rigid(l1_mean_rotation(steps[:, :3, :3]), np.median(steps[:, :3, 3], axis=0))
        for (a, b), steps in relative_poses(scene, index, [cam_from_world]).items()
        if a == 0 and rig.sensors[b].sensor_from_rig is not None
    }
    found = replace(rig, sensors=tuple(replace(s, sensor_from_rig=shown.get(k)) for k, s in enumerate(rig.sensors)))
    sensors = [rig.sensors[0]]
    for place, given in enumerate(rig.scaled(found.units(rig)).sensors[1:], start=1):
        pose, own = shown.get(place, given.sensor_from_rig), given.sensor_from_rig
        length = 0.0 if own is None else float(np.linalg.norm(own[:3, 3]))
        if pose is not None and own is not None and length > 0:
            # A camera with few ties may be anywhere (canal's up camera: three times too far).
            if np.linalg.norm(pose[:3, 3] - own[:3, 3]) > max_lever_off * length:
                pose = transforms.rigid(pose[:3, :3], own[:3, 3])
        sensors.append(replace(given, sensor_from_rig=pose))
    return replace(rig, sensors=tuple(sensors))


def place_frames(model: pycolmap.Reconstruction, scene: Scene, start: Start) -> None:
    """Set and register the frames of a model without poses."""
    for frame_id, frame in list(model.frames.items()):
        names = [model.image(d.id).name for d in frame.image_ids]
        rows = [scene.image_index[n] for n in names if n in scene.image_index]
        if not rows:
            continue
        index = frame.rig_id - 1
        if index in start.rigs:
            place = model.rig(frame.rig_id).ref_sensor_id.id - 1 - scene.first_sensor(index)
            extrinsics = start.rigs[index].sensors[place].sensor_from_rig
            reference = np.eye(4) if extrinsics is None else extrinsics
            pose = reference @ transforms.invert(start.world_from_rig[scene.frame[rows[0]]])
        else:
            pose = start.cam_from_world[rows[0]]
        if np.isfinite(pose).all():
            model.frame(frame_id).rig_from_world = rigid3d(pose)
            model.register_frame(frame_id)


@dataclass(frozen=True)
class StartCheck:
    """For N images: which have both poses, ``turned_deg`` (N,) relative to the consistent part, ``off`` (N,) distance
    from the place that this part predicts over the distance to the surface (NaN = unknown), ``bad`` (N,) images that
    disagree."""

    both: np.ndarray
    turned_deg: np.ndarray
    off: np.ndarray
    bad: np.ndarray


def check_start(given: np.ndarray, made: np.ndarray, reach: float, tuning: StartCheckTuning) -> StartCheck:
    """Poses ``given`` (N, 4, 4) compared with those of a model ``made`` (N, 4, 4), world_from_camera, NaN = none;
    ``reach``: typical distance of the model's cameras to the surface, model units."""
    both = np.all(np.isfinite(given[:, :3]) & np.isfinite(made[:, :3]), axis=(1, 2))
    rows = np.flatnonzero(both)
    turned, off = np.full(len(given), np.nan), np.full(len(given), np.nan)
    if len(rows) < LEAST_PLACES:
        return StartCheck(both=both, turned_deg=turned, off=off, bad=np.zeros(len(given), bool))
    between = made[rows, :3, :3] @ np.swapaxes(given[rows, :3, :3], 1, 2)
    tried = between[:: max(1, len(rows) // 300)]  # images whose rotations are tried: bounds the time
    votes = [int(np.sum(angle_deg(between, one) <= tuning.turn_deg)) for one in tried]
    first = angle_deg(between, tried[int(np.argmax(votes))]) <= tuning.turn_deg
    turned[rows] = angle_deg(between, l1_mean_rotation(between[first]))
    alike = rows[turned[rows] <= tuning.turn_deg]
    if len(alike) >= LEAST_PLACES:
        places = given[alike, :3, 3], made[alike, :3, 3]
        fit, _ = robust_umeyama(*places, sigma=tuning.off / 3 * reach)  # its limit is three sigmas
        off[rows] = np.linalg.norm(fit(given[rows, :3, 3]) - made[rows, :3, 3], axis=1) / reach
    bad = both & ~((turned <= tuning.turn_deg) & (off <= tuning.off))
    return StartCheck(both=both, turned_deg=turned, off=off, bad=bad)


def start_told(found: StartCheck, scene: Scene, tuning: StartCheckTuning) -> tuple[str, bool]:
    """The agreement of a start model in a sentence, and whether it contradicts the images."""
    count, bad = int(found.both.sum()), np.flatnonzero(found.bad)
    if count < LEAST_PLACES:
        return f"start model: {count} of its images are in the model, too few to test it", False
    good = found.both & ~found.bad
    agree = (
        f"{good.sum()} of {count} images agree with it, to {np.median(found.turned_deg[good]):.2g} deg and "
        f"{np.median(found.off[good]):.2g} of the distance to the surface (median)"
        if good.any()
        else f"none of {count} images agrees with it"
    )
    if not len(bad):
        return f"start model: {agree}", False
    names = ", ".join(scene.names[k] for k in bad[:_NAMED]) + (" ..." if len(bad) > _NAMED else "")
    share = len(bad) / count
    turned, off = np.median(found.turned_deg[bad]), found.off[found.bad & np.isfinite(found.off)]
    where = f" and {np.median(off):.2g} of that distance off" if len(off) else ""
    text = (
        f"{len(bad)} images do not: they are rotated relative to the others by {turned:.2g} deg{where} (median), such "
        f"as {names}"
    )
    why = "is it of another survey, or are names different?" if share > 0.5 else "is it bent there?"
    contradicts = share > tuning.share
    ending = f"; its poses were used only to choose pairs: {why}" if contradicts else ""
    return f"start model and images: {agree}; {text}{ending}", contradicts
