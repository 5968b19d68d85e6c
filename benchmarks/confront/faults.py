"""What users do wrong or suffer, each at three sizes: functions from what is handed over to what is wrong in it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from benchmarks.confront.given import Given, Picture, Positions
from tiegraph.geometry import transforms
from tiegraph.scene.rig import Rig, Sensor

SIZES = (0, 1, 2)
NOTHING = ("georef",)  # stages to run again where only positions changed; the tool's own receipts say what follows
RIG = ("network", "features")  # the rig and its lenses stand in the network's scene and in the database
EVERYTHING = ("scan",)


@dataclass(frozen=True)
class Wronged:
    """A survey with a fault. ``what``: in words. ``held``: quantity -> by how much what is handed over is wrong there:
    a result that keeps it states it (``scale``: a share; ``place:cam``: m; ``turn:cam``: deg; ``focal:cam``: a share).
    """

    given: Given
    what: str
    held: Mapping[str, float]


@dataclass(frozen=True)
class Fault:
    """``sizes``: three, small to large; ``make(given, size)`` -> Wronged, None where the survey has nothing to spoil.

    ``input``: which input is wrong (positions, clock, rig, camera, time, order, images); ``redo``: the first stages
    that see it.
    """

    sizes: tuple
    make: Callable[[Given, float], Wronged | None]
    input: str
    redo: tuple[str, ...]


# --- positions ------------------------------------------------------------------------------------------------------


def _moved(change: Callable[[Positions, float], Positions], words: str) -> Callable[[Given, float], Wronged | None]:
    def make(given: Given, size: float) -> Wronged | None:
        if given.positions is None:
            return None
        return Wronged(replace(given, positions=change(given.positions, size)), f"GNSS {words} {size:g}", {})

    return make


def extent_m(p: Positions) -> float:
    """Largest side of the box about the positions."""
    return float(np.ptp(p.enu_m, axis=0).max())


def _scaled(p: Positions, size: float) -> Positions:
    middle = p.enu_m.mean(axis=0)
    return replace(p, enu_m=middle + (1 + size) * (p.enu_m - middle))


def _sideways(p: Positions) -> np.ndarray:
    """Unit vector (3,), level, at right angles to the main direction of the positions."""
    plan = p.enu_m[:, :2] - p.enu_m[:, :2].mean(axis=0)
    along = np.linalg.svd(plan, full_matrices=False)[2][0]
    return np.array([-along[1], along[0], 0.0])


def _drifting(p: Positions, size: float) -> Positions:
    """Off sideways and upwards, growing with the square of the time, to ``size`` extents at the end."""
    share = (p.time_s - p.time_s[0]) / max(float(np.ptp(p.time_s)), 1e-9)
    order = _rank(share)  # passes minutes apart: the drift grows with the rows, not in the gap
    off = size * extent_m(p) * order[:, None] ** 2 * (_sideways(p) + [0, 0, 0.7])
    return replace(p, enu_m=p.enu_m + off)


def _rank(values: np.ndarray) -> np.ndarray:
    return np.argsort(np.argsort(values, kind="stable"), kind="stable") / max(len(values) - 1, 1)


def _stepped(p: Positions, size: float) -> Positions:
    """A step by ``size`` extents, sideways and upwards, from the middle row on (a wrong fix of the ambiguities)."""
    late = _rank(p.time_s) >= 0.5
    return replace(p, enu_m=p.enu_m + late[:, None] * size * extent_m(p) * (_sideways(p) + [0, 0, 0.7]))


def _lagging(p: Positions, size: float) -> Positions:
    return replace(p, time_s=p.time_s + size)


def _exchanged(p: Positions, size: float) -> Positions:
    """0: east and north exchanged, 1: east counted to the west, 2: height and north exchanged."""
    columns, sign = {0: ((1, 0, 2), (1, 1, 1)), 1: ((0, 1, 2), (-1, 1, 1)), 2: ((0, 2, 1), (1, 1, 1))}[int(size)]
    return replace(p, enu_m=p.enu_m[:, columns] * np.array(sign, float))


def _floating(p: Positions, size: float) -> Positions:
    """As a receiver without fixed ambiguities gives and states them: slow errors of ``size`` metres (60 s)."""
    rng, steps = np.random.default_rng(7), np.diff(p.time_s, prepend=p.time_s[0])
    off = rng.normal(size=(len(p.time_s), 3))
    for k in range(1, len(off)):
        kept = np.exp(-abs(steps[k]) / 60)
        off[k] = kept * off[k - 1] + np.sqrt(1 - kept**2) * off[k]
    sigma = size * np.array([1.0, 1.5])
    return replace(p, enu_m=p.enu_m + off * sigma[[0, 0, 1]], sigma_m=np.tile(sigma, (len(off), 1)))


# --- rig and cameras ------------------------------------------------------------------------------------------------


def _levered(rig: Rig, factor: float) -> Rig:
    """The rig with all lever arms longer by a factor."""
    sensors = []
    for s in rig.sensors:
        pose = s.sensor_from_rig
        if pose is not None:
            pose = transforms.rigid(pose[:3, :3], factor * pose[:3, 3])
        sensors.append(replace(s, sensor_from_rig=pose))
    return replace(rig, sensors=tuple(sensors))


def _usable(given: Given) -> Rig | None:
    """The rig if it has several sensors whose places are known."""
    rig = given.rig
    return rig if rig is not None and len(rig.sensors) > 1 and rig.known() else None


def differences(wrong: Rig, right: Rig) -> dict[str, float]:
    """By how much each camera of a rig stands elsewhere than in another: place m, turn deg."""
    out = {}
    for a, b in zip(wrong.sensors[1:], right.sensors[1:]):
        if a.sensor_from_rig is None or b.sensor_from_rig is None:
            continue
        place = np.linalg.norm(transforms.centre(a.sensor_from_rig) - transforms.centre(b.sensor_from_rig))
        turn = transforms.angle_deg(a.sensor_from_rig[:3, :3], b.sensor_from_rig[:3, :3])
        out |= {f"place:{a.name}": float(place)} if place > 1e-6 else {}
        out |= {f"turn:{a.name}": float(turn)} if turn > 1e-4 else {}
    return out


def _with_rig(given: Given, rig: Rig, what: str, scale: float = 0.0) -> Wronged:
    assert given.rig is not None
    held = {} if rig.nominal else differences(rig, given.rig)
    return Wronged(replace(given, rig=rig), what, held | ({"scale": scale} if scale and not rig.nominal else {}))


def _baseline(given: Given, size: float) -> Wronged | None:
    rig = _usable(given)
    what = f"baselines of the rig longer by {size:.0%}"
    return None if rig is None else _with_rig(given, _levered(rig, 1 + size), what, size)


def _turned(given: Given, size: float) -> Wronged | None:
    rig = _usable(given)
    if rig is None:
        return None
    sensors = list(rig.sensors)
    pose = sensors[-1].sensor_from_rig
    assert pose is not None
    turn = Rotation.from_euler("y", size, degrees=True).as_matrix()  # in the camera: its centre stays
    sensors[-1] = replace(sensors[-1], sensor_from_rig=transforms.rigid(turn @ pose[:3, :3], turn @ pose[:3, 3]))
    return _with_rig(given, replace(rig, sensors=tuple(sensors)), f"camera {sensors[-1].name} turned by {size:g} deg")


def _other_rig(given: Given, size: float) -> Wronged | None:
    """0: of the same head, 30 % larger; 1: cameras counted the other way round; 2: both, and angles a tenth smaller."""
    rig = _usable(given)
    if rig is None:
        return None
    wrong = _levered(rig, 1.3) if size != 1 else rig
    if size >= 1:
        poses = [s.sensor_from_rig for s in wrong.sensors]
        order = [0, *range(len(poses) - 1, 0, -1)]
        if len(poses) == 2:  # a pair: the second camera on the other side
            poses = [poses[0], transforms.invert(np.asarray(poses[1]))]
            order = [0, 1]
        wrong = replace(
            wrong, sensors=tuple(replace(s, sensor_from_rig=poses[k]) for s, k in zip(wrong.sensors, order))
        )
    if size == 2:
        wrong = replace(wrong, sensors=tuple(_narrowed(s) for s in wrong.sensors))
    words = ("30 % larger", "numbered the other way", "larger, other numbers, other angles")[int(size)]
    return _with_rig(given, wrong, f"rig file of another rig ({words})", 0.3 if size == 0 else 0.0)


def _narrowed(sensor: Sensor) -> Sensor:
    pose = np.asarray(sensor.sensor_from_rig)
    turn = Rotation.from_rotvec(0.9 * Rotation.from_matrix(pose[:3, :3]).as_rotvec()).as_matrix()
    return replace(sensor, sensor_from_rig=transforms.rigid(turn, -turn @ transforms.centre(pose)))


def _swapped(given: Given, size: float) -> Wronged | None:
    """Folders of cameras exchanged: 0 the last two, 1 the first and the last, 2 all turned on by one."""
    rig = given.rig
    if rig is None or len(rig.sensors) < 2 or (size and len(rig.sensors) == 2):
        return None  # of a pair there is one exchange
    names = [s.folder for s in rig.sensors]
    to = dict(zip(names, names))
    if size == 2:
        to = dict(zip(names, names[1:] + names[:1]))
    else:
        a, b = (names[-2], names[-1]) if size == 0 else (names[0], names[-1])
        to |= {a: b, b: a}
    poses = {s.folder: s for s in rig.sensors}
    wrong = replace(
        rig, sensors=tuple(replace(s, sensor_from_rig=poses[to[s.folder]].sensor_from_rig) for s in rig.sensors)
    )
    changed = [n for n in names if to[n] != n]
    first = wrong.sensors[0].sensor_from_rig
    if first is not None:  # its first camera is the rig's frame
        moved = [
            replace(
                s, sensor_from_rig=None if s.sensor_from_rig is None else s.sensor_from_rig @ transforms.invert(first)
            )
            for s in wrong.sensors
        ]
        wrong = replace(wrong, sensors=tuple(moved))
    cameras = [poses[to[s.folder]].camera for s in rig.sensors]
    wrong = replace(wrong, sensors=tuple(replace(s, camera=c) for s, c in zip(wrong.sensors, cameras)))
    return _with_rig(given, wrong, f"cameras exchanged: {', '.join(changed)}")


def _focal(given: Given, size: float) -> Wronged | None:
    rig = given.rig
    if rig is None or any(s.camera is None for s in rig.sensors):
        return None
    sensors, held = [], {}
    for s in rig.sensors:
        assert s.camera is not None
        camera = pycolmap.Camera(s.camera.todict())
        params = np.array(camera.params)
        params[list(camera.focal_length_idxs())] *= 1 + size
        camera.params = params.tolist()
        camera.has_prior_focal_length = True
        sensors.append(replace(s, camera=camera))
        held[f"focal:{s.name}"] = abs(size)
    return Wronged(replace(given, rig=replace(rig, sensors=tuple(sensors))), f"focal length {size:+.0%}", held)


def _bent(given: Given, size: float) -> Wronged | None:
    """The pictures of the last camera bent by a keystone, which its calibration does not know."""
    if given.rig is None or len(given.rig.sensors) < 2 or given.rig.sensors[-1].camera is None:
        return None
    folders, last = given.folders(), given.rig.sensors[-1].folder
    images = {n: replace(p, keystone_px=size) if folders[n] == last else p for n, p in given.images.items()}
    return Wronged(replace(given, images=images), f"{last} bent by a keystone of {size:g} px", {})


# --- times and images -----------------------------------------------------------------------------------------------


def _order(given: Given, size: float) -> Wronged | None:
    """Frames named in a wrong order: 0 two neighbours exchanged, 1 a third of them backwards, 2 all shuffled."""
    renamed: dict[str, str] = {}
    for track in sorted({t for t, _ in given.in_order()}):
        frames = [f for t, f in given.in_order() if t == track]
        order = _disorder(len(frames), int(size))
        if order is None:
            return None
        other = {f: frames[order[k]] for k, f in enumerate(frames)}
        for name in given.images:
            if given.frame_of(name)[0] == track:
                renamed[name] = name[: len(name) - len(given.frame_of(name)[1])] + other[given.frame_of(name)[1]]
    images = {new: given.images[old] for old, new in renamed.items()}
    truth = {new: given.truth.cam_from_world[old] for old, new in renamed.items() if old in given.truth.cam_from_world}
    words = ("two neighbours exchanged", "a third backwards", "all shuffled")[int(size)]
    changed = replace(given, images=dict(sorted(images.items())), truth=replace(given.truth, cam_from_world=truth))
    return Wronged(changed, f"order of the frames: {words}", {})


def _disorder(count: int, size: int) -> np.ndarray | None:
    order = np.arange(count)
    if count < 6:
        return None
    third = count // 3
    if size == 0:
        order[[third, third + 1]] = order[[third + 1, third]]
    elif size == 1:
        order[third : 2 * third] = order[third : 2 * third][::-1].copy()
    else:
        order = np.random.default_rng(3).permutation(count)
    return order


def strangers(pictures: list[Picture]) -> Callable[[Given, float], Wronged | None]:
    """The last ``size`` frames of the first camera are photographs of another place (the pictures, in turn)."""

    def make(given: Given, size: float) -> Wronged | None:
        folders = given.folders()
        first = given.rig.sensors[0].folder if given.rig else ""
        own = [n for n in given.images if folders[n] == first]
        if len(own) < 3 * size or not pictures:
            return None
        taken = own[len(own) // 2 : len(own) // 2 + int(size)]
        images = dict(given.images) | {n: pictures[k % len(pictures)] for k, n in enumerate(taken)}
        truth = {n: p for n, p in given.truth.cam_from_world.items() if n not in taken}
        changed = replace(
            given, images=images, truth=replace(given.truth, cam_from_world=truth), strangers=tuple(taken)
        )
        return Wronged(changed, f"{int(size)} photographs of another place", {})

    return make


def _blurred(given: Given, size: float) -> Wronged | None:
    frames = given.in_order()
    half = set(frames[::2])
    images = {n: replace(p, blur_px=size) if given.frame_of(n) in half else p for n, p in given.images.items()}
    return Wronged(replace(given, images=images), f"half of the frames blurred over {size:g} px", {})


def apart(given: Given, late_s: Mapping[str, float], stamp_s: Mapping[str, float]) -> Given:
    """Cameras that fire ``late_s`` (folder -> seconds, either sign) after the frame, by interpolation between the
    frames before and after; first and last frames, which have none, stay. ``stamp_s``: image -> seconds."""
    folders, images, truth = given.folders(), dict(given.images), dict(given.truth.cam_from_world)
    for folder, late in late_s.items():
        for track in {given.frame_of(n)[0] for n in given.images}:
            own = sorted(n for n in given.images if folders[n] == folder and given.frame_of(n)[0] == track)
            poses = np.stack([transforms.invert(given.truth.cam_from_world[n]) for n in own])
            times = np.array([stamp_s[n] for n in own])
            for k, name in enumerate(own):
                other = k + (1 if late > 0 else -1)
                if late and 0 <= other < len(own):
                    share = abs(late) / abs(times[other] - times[k])
                    images[name] = Picture(given.images[name].file, after=given.images[own[other]].file, share=share)
                    there = transforms.interpolate(times, poses, times[k : k + 1] + late)[0]
                    truth[name] = transforms.invert(there)
    return replace(given, images=images, truth=replace(given.truth, cam_from_world=truth))


def amplitudes(folders: list[str], size_s: float) -> dict[str, float]:
    """Camera -> seconds: from -size to +size, the first at 0."""
    others = np.linspace(-size_s, size_s, max(len(folders) - 1, 1)) if len(folders) > 2 else np.array([size_s])
    return {folders[0]: 0.0, **{f: float(v) for f, v in zip(folders[1:], others)}}


FAULTS: dict[str, Fault] = {
    "gnss_scale": Fault((0.01, 0.03, 0.1), _moved(_scaled, "too long by a share of"), "positions", NOTHING),
    "gnss_drift": Fault((0.01, 0.03, 0.1), _moved(_drifting, "drifts, by shares of the extent,"), "positions", NOTHING),
    "gnss_step": Fault((0.01, 0.03, 0.1), _moved(_stepped, "steps, by shares of the extent,"), "positions", NOTHING),
    "gnss_lag": Fault((0.1, 0.3, 1.0), _moved(_lagging, "lags, seconds:"), "clock", NOTHING),
    "gnss_axes": Fault((0, 1, 2), _moved(_exchanged, "axes exchanged, kind"), "positions", NOTHING),
    "gnss_float": Fault((0.1, 0.3, 1.0), _moved(_floating, "floats, metres:"), "positions", NOTHING),
    "rig_baseline": Fault((0.01, 0.03, 0.1), _baseline, "rig", RIG),
    "rig_turned": Fault((0.2, 0.5, 2.0), _turned, "rig", RIG),
    "rig_other": Fault((0, 1, 2), _other_rig, "rig", RIG),
    "rig_swapped": Fault((0, 1, 2), _swapped, "rig", RIG),
    "focal": Fault((0.01, 0.05, 0.2), _focal, "camera", RIG),
    "keystone": Fault((0.5, 1.5, 3.0), _bent, "camera", EVERYTHING),
    "order": Fault((0, 1, 2), _order, "order", EVERYTHING),
    "blurred": Fault((3.0, 8.0, 20.0), _blurred, "images", EVERYTHING),
}
"""``apart`` and ``stranger`` need more than the survey itself: the sets add them (``sets.faults_of``)."""

APART_S = (0.01, 0.03, 0.05)
STRANGERS = (1, 2, 4)
