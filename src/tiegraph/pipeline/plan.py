"""Glue of the planner: cameras as `scan` reads them, the covariance of `sparse`, the viewer of `report`; files.
And the resources that a run will need.
"""

import json
import shutil
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.features.settings import FeaturesSettings
from tiegraph.features.sift import most_features
from tiegraph.geometry import transforms
from tiegraph.plan.accuracy import Shape
from tiegraph.plan.figures import Effort, effort
from tiegraph.plan.network import MountedCamera, model_figures
from tiegraph.plan.planner import Plan, Rigged, Table, comparison, frames_apart, make_plan
from tiegraph.plan.request import CameraRequest, PlanRequest
from tiegraph.project.run import Run
from tiegraph.project.settings import VerbTunings
from tiegraph.project.stages import save_json, write_atomic
from tiegraph.report.cloudview import viewer_data, viewer_script
from tiegraph.report.html import environment
from tiegraph.report.maps import Scenery, Track, frame_positions
from tiegraph.report.runfolder import read_run
from tiegraph.report.summary import metric_values
from tiegraph.scan.cameras import FileFacts, calibrate
from tiegraph.scan.rigfiles.rigfile import read_rig_file
from tiegraph.scan.rigfiles.rigspec import AXES, RigSpec, SensorSpec, preset, preset_sizes
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import Tuning as ScanTuning
from tiegraph.scene.atomic import must_be_new
from tiegraph.scene.bags import is_bag, source_of
from tiegraph.scene.colmapmodel import read_model
from tiegraph.scene.decoding import EIGHT_BIT
from tiegraph.scene.images import find_images, find_videos, probe_image
from tiegraph.scene.rig import Rig, Sensor, calibrated
from tiegraph.sfm.adjustment.adjust import free_cameras
from tiegraph.sfm.covariance import planned_sigma
from tiegraph.sfm.systematic import AssumedErrors
from tiegraph.sfm.tuning import Tuning as SfmTuning

PLAN = "plan.json"
# What the observations of a run share, known from runs. Sigmas by the errors that the observations of a point share
# over those by independent ones: KITTI 1.8, canal 2.0, canal_demo 1.4, Herz-Jesus-P8 1.4.
_TRACKS = 1.6
# Of an adjusted lens, what it leaves: 0.02 to 0.18 px are found in canal and canal_demo, most of them smooth, which the
# lens's own unknowns take up; what is left does as much as this at a reach of a tenth of the image's diagonal (KITTI,
# Herz-Jesus-P8, canal_demo).
_LENS_PX, _REACH = 0.015, 0.1


def plan(request: PlanRequest, tunings: VerbTunings | None = None) -> Plan:
    """The plan for a request; its files, if a folder for them is named.

    Raises InputError for values that make no survey, and for an existing folder.
    """
    out = request.output.out
    if out is not None:
        must_be_new(out)
    tunings = tunings or VerbTunings()
    rigged = _cameras(request.camera, tunings.scan)
    propagate = partial(_propagate, rigged=rigged, calibration_px=request.camera.calibration_px, tuning=tunings.sfm)
    made = make_plan(request, rigged, propagate, FeaturesSettings().max_features)
    if out is not None:
        for name, data in made.files().items():
            write_atomic(out / name, data)
        save_json(out / PLAN, {**made.to_dict(), "tuning": tunings.changed()})
        if made.path is not None:
            write_atomic(out / "plan.html", _page(made))
    return made


def compare(folder: Path, planned: Path | None) -> Table:
    """The results of a run beside the planned values. Raises InputError for invalid files."""
    path = planned or folder / PLAN
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: no plan.json that can be read ({error}): `tiegraph plan --shape ... -o FOLDER` makes one; "
            "put it into the run folder, or name it by --planned"
        ) from None
    if not isinstance(data, dict):
        raise InputError(f"{path}: no plan.json of tiegraph: `tiegraph plan --shape ... -o FOLDER` makes one")
    return comparison(data, reached(folder))


def reached(folder: Path) -> dict[str, float | None]:
    """The figures of a finished run that a plan has, too; None or absent = not known."""
    run = read_run(folder, cloud_points=0)
    if run.scene is None or run.model is None:
        raise InputError(f"{folder}: no sparse model in it: run it to `sparse` or `georef`, then compare")
    model = read_model(folder / run.model.folder)
    world = run.world or {}
    base = frames_apart(frame_positions(run.scene, run.model.centres), run.scene.sequence, run.scene.sequence_index)
    out: dict[str, float | None] = {"images": int(run.model.images.registered.sum())}
    if not run.metric:
        return out | {k: v for k, v in model_figures(model).items() if k != "tie_gsd_m"}
    out |= model_figures(model)
    camera = next(iter(model.cameras.values()))
    if base is not None:
        out |= {"base_m": base, "overlap": max(0.0, 1 - base / (float(out["tie_gsd_m"] or 0) * camera.width))}
    inside, sigma = world.get("model_sigma") or {}, world.get("sigma") or {}
    shape = inside.get("median")
    out["position_shape_sigma_median_m"] = shape
    if shape is not None and "position_m" in sigma:
        out["place_world_sigma_median_m"] = float(np.hypot(shape, sigma["position_m"]))
        out["height_world_sigma_median_m"] = float(np.hypot(shape, sigma["height_m"]))
    out["ate_m"] = metric_values(run).get("ate_sim3_rmse")
    return out


def _propagate(
    model: pycolmap.Reconstruction, calibrated: bool, *, rigged: Rigged, calibration_px: float, tuning: SfmTuning
) -> Shape:
    """The values of the stage `sparse` for an adjusted model: rig and lenses unknown unless calibrated."""
    free = set() if calibrated else free_cameras(model, tuning.adjust) - set(rigged.held)
    here = set(model.cameras) if calibrated else free  # lenses that are adjusted or calibrated for this survey
    lens_px = {k: _LENS_PX if k in here else calibration_px for k in model.cameras}
    shared = AssumedErrors(lens_px=lens_px, reach=_REACH, tracks=_TRACKS)
    try:
        found = planned_sigma(model, free, not rigged.fixed, shared, tuning=tuning)
    except (ValueError, RuntimeError) as error:  # of an inverse too
        raise InputError(
            f"the network of this path cannot be adjusted ({error}): give more overlap or frames"
        ) from None
    return Shape(
        frames=np.array(found.frame_ids) - 1,
        covariance=np.asarray(found.covariance),
        scale=found.scale,
        pixel_sigma=found.pixel_sigma,
        points=np.array(list(found.points)),
        point_sigma=np.array(list(found.points.values())),
    )


def _cameras(request: CameraRequest, tuning: ScanTuning) -> Rigged:
    """The cameras of the rig. Raises InputError if their size, lens or pose is not known."""
    size, focal = request.image_size(), request.focal_length_px()
    sizes = preset_sizes(request.rig or "single", tuning.rig)
    if sizes:
        spec = preset(request.rig or "single", tuple(f"cam{k}" for k in range(sizes[0])), tuning.rig)
    else:
        spec, *more = read_rig_file(Path(request.rig or ""), tuning.rig)
        if more:
            raise InputError(f"--rig {request.rig}: it has {1 + len(more)} rigs; a plan is of one")
    sensors, mounted = [], []
    for sensor in spec.sensors:
        camera = _camera(sensor, spec, size, focal, tuning)
        if sensor.body_from_sensor is None:
            raise InputError(f"--rig {request.rig}: sensor {sensor.name!r} has no pose in the rig: a plan needs it")
        body = np.eye(4)
        body[:3, :3] = AXES[spec.axes]
        pose = transforms.invert(body @ sensor.body_from_sensor)
        sensors.append(Sensor(sensor.name, camera, pose, role=sensor.role, camera_sigma_px=sensor.camera_sigma_px,
                              sigma_deg=sensor.sigma_deg, sigma_m=sensor.sigma_m))  # fmt: skip
        mounted.append(MountedCamera(sensor.name, camera, pose))
    rig = Rig(spec.name, tuple(sensors), fixed=spec.fixed, nominal=spec.nominal, pairs=spec.pairs)
    firm = [s.camera is not None and (rig.fixed or calibrated(s.camera)) and not s.camera_sigma_px for s in sensors]
    held = tuple(k for k, is_held in enumerate(firm, 1) if is_held)
    return Rigged(mounted, held=held, fixed=rig.measured() and not rig.soft())


def _camera(
    sensor: SensorSpec, spec: RigSpec, size: tuple[int, int] | None, focal_px: float | None, tuning: ScanTuning
) -> pycolmap.Camera:
    known = sensor.params is not None or sensor.focal_px is not None or (sensor.hfov_deg is not None)
    size = sensor.size or size
    if size is None:
        raise InputError("the size of the images is unknown: give --size 2448x2050, or a --rig with cameras")
    if not known and focal_px is None:
        raise InputError(f"the focal length of {sensor.name} is not known: give --focal and --pixel, or --focal-px")
    facts = FileFacts(size, focal_px or float("nan"), upright=True, levels=EIGHT_BIT, loose=False)
    return calibrate(sensor, facts, spec.file, ScanSettings(), tuning.rig.camera)[0]


def _page(made: Plan) -> str:
    assert made.path is not None
    path, points = made.path.path, made.path.network.model.points3D.values()
    xyz = np.array([p.xyz for p in points])
    tracks = [Track(name, path.centres[path.leg == k], np.zeros((0, 3))) for k, name in enumerate(path.legs)]
    seen = Scenery(
        tracks=tracks, xyz=xyz, rgb=np.full(xyz.shape, 128), path=path.centres, unit="m", given=np.zeros((0, 3)),
        views=np.zeros(len(xyz)), north=False,
    )  # fmt: skip
    data = viewer_data(seen, 20_000)
    packed = json.dumps(data).replace("<", "\\u003c")
    page = environment().get_template("planned.html.jinja")
    return page.render(data=packed, script=viewer_script(), lines=(*made.path.worst, *made.advice))


@dataclass(frozen=True)
class Forecast:
    """The cost of a survey, and the disk of its run folder: bytes that exist already, and that are free."""

    cost: Effort
    there_bytes: int
    free_bytes: int

    def enough(self) -> bool:
        """Whether the disk has room for it."""
        # Files still to be written, with temporary ones
        return max(self.cost.run_bytes + self.cost.scratch_bytes - self.there_bytes, 0.0) < self.free_bytes

    def lines(self, folder: Path) -> list[str]:
        """For people."""
        cost = self.cost
        cpu = (cost.sparse_cpu_s / 3600, cost.dense_cpu_s / 3600)
        verdict = "enough" if self.enough() else "NOT ENOUGH: give -o on another disk, or stop before dense by --until"
        return [
            f"images: {cost.images}",
            f"disk: about {_gb(cost.model_bytes)} to georef, {_gb(cost.dense_bytes)} more with depth maps, cloud "
            f"and products (0.7 to 2.1 times what five sets took), and {_gb(cost.scratch_bytes)} for a while during "
            f"sparse; {_gb(self.there_bytes)} exist, {_gb(self.free_bytes)} free at {folder}: {verdict}",
            f"CPU time: about {cpu[0]:.2g} h to georef, {cpu[1]:.2g} h more with depth maps, cloud and products, "
            "of one core of an AMD EPYC (the larger part runs on all cores)",
        ]


def forecast(run: Run) -> Forecast | None:
    """The cost of a run by the sizes of some of its images; None if they are frames of videos or bags, which only
    `scan` counts. Nothing is written. Raises InputError for folders without images."""
    source = source_of(run.inputs.images)
    if is_bag(source) or find_videos(source):
        return None
    names = find_images(source)
    some = names[:: max(len(names) // 40, 1)]  # images whose size represents all
    probes = [probe_image(source / name) for name in some]
    sizes = [(p.width, p.height) for p in probes if not p.reason]
    if not sizes:
        return None
    megapixels = np.prod(sizes, axis=1) / 1e6
    settings = run.settings
    most = most_features(megapixels, settings.features.max_features, settings.tuning.features.sift)
    longest, with_products = (settings.features.max_image_size, settings.dense.max_image_size), settings.products.make
    every = (sizes * (len(names) // len(sizes) + 1))[: len(names)]
    cost = effort(every, 1, 0.0, None, float(most.mean()), longest, with_products != "none")
    where = next(p for p in (run.folder, *run.folder.parents) if p.exists())
    return Forecast(cost, _size(run.folder), shutil.disk_usage(where).free)


def _size(folder: Path) -> int:
    files = (p for p in folder.rglob("*") if p.is_file() and not p.is_symlink()) if folder.is_dir() else ()
    return sum(p.stat().st_size for p in files)


def _gb(size: float) -> str:
    return f"{size / 1e9:.2g} GB"
