"""Glue of watch: step by step, files that have arrived become previews, ties and poses; the page shows the state.

``watchmodel`` makes previews and matches them as the stages preview and candidates do, and the coarse model in a child
process, one at a time. The run folder keeps previews, ties and the last page: a second run continues from
there.
"""

import json
import logging
import statistics
import time
from collections import deque
from dataclasses import replace
from functools import partial
from typing import Any

import cv2
import numpy as np

from tiegraph.child import end_helpers
from tiegraph.design.coverage import VERDICTS
from tiegraph.errors import InputError
from tiegraph.pipeline import STAGES, watchmodel
from tiegraph.pipeline.features import preview_of, preview_path
from tiegraph.pipeline.files import load_npz, save_npz
from tiegraph.pipeline.foundrig import rig_of_run
from tiegraph.pipeline.inputs import check_given
from tiegraph.pipeline.pages import PageServer, WatchHandler
from tiegraph.project.folder import working_in
from tiegraph.project.run import Run, check_run
from tiegraph.project.stages import write_atomic
from tiegraph.scan.scan import ScanInputs, build_scene, probe_image
from tiegraph.scene.images import Probe
from tiegraph.scene.names import clean_names
from tiegraph.scene.pairs import PreviewMatches
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.watch.onsite import Arrivals, Known, page, place_frames
from tiegraph.watch.tuning import Tuning

KEPT, PAGE = "watch.npz", "watch.html"
_BATCH = 8  # images of a step: a full folder already shows its first poses soon

log = logging.getLogger(__name__)


def watch(run: Run, port: int, tuning: Tuning) -> None:
    """Watch ``run.inputs.images`` until interrupted, which is the normal end: the state is kept then.

    Raises InputError before anything is written: wrong inputs, a run folder that is not ours, no such port.
    """
    check_run(STAGES, run)
    check_given(STAGES, run)
    cv2.setNumThreads(1)  # the second core is for the model
    server = PageServer(WatchHandler, {}, port)
    try:
        with working_in(run.folder):
            watched = Watched(run, tuning)
            server.about = watched.state()
            server.start()
            run.reporter.say(f"watching {run.inputs.images}: {server.url} shows what arrives; Ctrl-C ends it")
            run.reporter.event("watching", page=server.url, folder=str(run.inputs.images))
            try:
                while True:
                    if watched.step(time.monotonic()):
                        server.about = watched.state()
                    time.sleep(watched.tuning.arrivals.look_s)
            except KeyboardInterrupt:
                end_helpers()
                watched.keep()
    finally:
        server.close()
    said = f"{len(watched.scene or ())} images, {len(watched.poses)} with a pose; {run.folder / PAGE} shows them"
    run.reporter.say(f"stopped: {said}; the same command continues")


class Watched:
    """The state of a folder; ``step`` reads it again. Names are those of the scene, whose order is that of names."""

    def __init__(self, run: Run, tuning: Tuning) -> None:
        self.run, self.tuning = run, tuning
        self.arrivals = Arrivals(run.inputs.images, tuning.arrivals)
        self.scene: Scene | None = None
        self.poses: dict[str, np.ndarray] = {}
        self.said: list[str] = []
        self.times: deque[float] = deque(maxlen=100)  # images of the median time
        self._trouble = ""
        self._probes: dict[str, Probe] = {}
        self._file_of: dict[str, str] = {}  # its name in the file system
        self._digest: dict[str, str] = {}  # of the file whose preview exists
        self._ties: dict[tuple[str, str], np.ndarray] = {}
        self._rigs: tuple[Rig, ...] = ()
        self._rig_text = rig_of_run(run.inputs.rig)
        self._tried: dict[str, int] = {}  # frame -> matches to images with a pose when its resection failed
        self._models = watchmodel.CoarseModels(run)
        self._unsaved, self._last, self._saved = True, 0.0, 0.0
        self._recall()

    def step(self, now: float) -> bool:
        """Process newly arrived files and the model's result; whether anything is new."""
        before, was_busy = (self.arrivals.trouble, self._trouble), self._models.busy
        names = self.arrivals.look(now)[:_BATCH]
        new = self._taken_in(names, now) if names else []
        made = self._models.result()
        if made is not None:
            self._take_model(made)
        if new or made is not None:
            self._tie(new)
            self._place()
            self._last = now if new else self._last
        for name in new:
            assert self.scene is not None
            source = self.scene.source_name(self.scene.image_index[name])
            self.times.append(time.monotonic() - self.arrivals.came(self._file_of[source]))
            self.run.reporter.event(
                "image", name=source, seconds=round(self.times[-1], 3), waiting=self.arrivals.waiting(),
                pose=name in self.poses, cpu_s=round(time.process_time(), 3),
            )  # fmt: skip
        self._model_if_due(now)
        news = bool(names) or made is not None or before != (self.arrivals.trouble, self._trouble)
        self._unsaved = self._unsaved or news
        if self._unsaved and now - self._saved > 10.0:  # seconds between two writings
            self.keep()
            self._saved = now
        return news or was_busy != self._models.busy

    def _taken_in(self, files: list[str], now: float) -> list[str]:
        """Open files, sort all known ones into the scene, and make the previews; names of the new images."""
        root = self.arrivals.root
        for file in files:
            probe = probe_image(root / file)
            if probe.reason and (file not in self._probes or self._probes[file].reason != probe.reason):
                self.run.reporter.say(f"not used: {file}: {probe.reason}")
            self._probes[file] = probe
            self.arrivals.opened(file, not probe.reason, now)
        self._sort()
        if self.scene is None:
            return []
        new, failed = [], False
        for image, name in enumerate(self.scene.names):
            file = self._file_of[self.scene.source_name(image)]
            digest = self._probes[file].digest
            if self._digest.get(name) == digest and preview_path(self.run.folder, name).exists():
                if file in files:
                    new.append(name)
                continue
            self._digest.pop(name, None)  # results of an image that was replaced are removed
            self.poses.pop(name, None)
            self._ties = {pair: matches for pair, matches in self._ties.items() if name not in pair}
            try:
                watchmodel.make_preview(self.scene, image, root / file, self.run.folder, self.run.settings)
                self._digest[name] = digest
                new.append(name)
            except (InputError, OSError) as error:  # gone or broken since it was opened
                log.warning("%s: %s", file, error)
                self._probes[file] = Probe(reason=f"cannot be read any more: {error}")
                self.arrivals.opened(file, False, now)
                failed = True
        if failed:
            self._sort()
        return [name for name in new if self.scene is not None and name in self.scene.image_index]

    def _sort(self) -> None:
        """All known files as a scene; if they do not fit, ``_trouble`` is set and the scene stays unchanged."""
        given, settings = self.run.inputs, self.run.settings
        files = sorted(self._probes)
        if sum(not p.reason for p in self._probes.values()) < 2:
            return
        text = None if self._rig_text is None else self._rig_text.text
        inputs = ScanInputs(
            images=given.images, rig=given.rig, rig_text=text, camera=given.camera, gnss=given.gnss, times=given.times
        )
        try:
            probes = [self._probes[f] for f in files]
            names = clean_names(files)
            self.scene = build_scene(inputs, names, probes, settings.scan, settings.tuning.scan)
            self._file_of = dict(zip(names, files))
            self._trouble = ""
        except InputError as error:
            if str(error) != self._trouble:
                self.run.reporter.say(f"waiting, because the present files do not fit: {error}")
            self._trouble = str(error)

    def _tie(self, new: list[str]) -> None:
        scene = self.scene
        if scene is None or not new:
            return
        pairs = watchmodel.neighbours(scene, self.tuning.neighbours, self.run.settings)
        missing = [(a, b) for a, b in pairs.tolist() if (scene.names[a], scene.names[b]) not in self._ties]
        missing = [(a, b) for a, b in missing if scene.names[a] in self._digest and scene.names[b] in self._digest]
        self._remember(scene, watchmodel.matched(np.reshape(missing, (-1, 2)).astype(int), scene, self.run.folder,
                                      self.run.settings))  # fmt: skip

    def _remember(self, scene: Scene, ties: PreviewMatches) -> None:
        for t, (a, b) in enumerate(zip(ties.i.tolist(), ties.j.tolist())):
            self._ties.setdefault((scene.names[a], scene.names[b]), ties.of(t))

    def ties(self, scene: Scene) -> PreviewMatches:
        """All ties, of the images of a scene."""
        index = scene.image_index
        there = [(index[a], index[b], m) for (a, b), m in self._ties.items() if a in index and b in index]
        ends = np.array([(min(a, b), max(a, b)) for a, b, _ in there], int).reshape(-1, 2)
        return PreviewMatches.make(ends[:, 0], ends[:, 1], [m if a < b else m[:, ::-1] for a, b, m in there])

    def _place(self) -> None:
        """Poses for frames that have none, if ties to images with one have come since the last try."""
        scene = self.scene
        if scene is None or not self.poses:
            return
        ties, known = self.ties(scene), self._known(scene)
        size_px = self.run.settings.preview.size_px
        how = partial(watchmodel.resect_previews, size_px=size_px)
        for _ in range(2):  # a frame may depend on one that comes after it
            without = ~known.placed()
            across = without[ties.i] != without[ties.j]
            loose = np.where(without[ties.i], ties.i, ties.j)[across]
            matches = np.bincount(scene.frame[loose], ties.counts()[across], scene.frames).astype(int)
            weight = matches + np.bincount(scene.frame[without], minlength=scene.frames)
            frames = np.unique(scene.frame[without])
            todo = [int(f) for f in frames if weight[f] > self._tried.get(scene.frame_names[f], 0)]
            if not todo:
                return
            self._tried.update({scene.frame_names[f]: int(weight[f]) for f in todo})
            poses = place_frames(scene, ties, known, todo, how)
            known = replace(known, poses=poses)
            self.poses.update({n: poses[k] for k, n in enumerate(scene.names) if np.isfinite(poses[k]).all()})

    def _known(self, scene: Scene) -> Known:
        shape = [len(r.sensors) for r in scene.rigs]
        rigs = self._rigs if [len(r.sensors) for r in self._rigs] == shape else scene.rigs
        nowhere = np.full((4, 4), np.nan)
        poses = np.array([self.poses.get(name, nowhere) for name in scene.names]).reshape(-1, 4, 4)
        cameras = [rigs[scene.rig[f]].sensors[s].camera for f, s in zip(scene.frame, scene.sensor)]
        return Known(poses, cameras, keypoints=lambda k: preview_of(self.run.folder, scene.names[k]).xy, rigs=rigs)

    def _model_if_due(self, now: float) -> None:
        scene, tuning = self.scene, self.tuning.model
        if scene is None or self._models.busy or len(scene) < tuning.first or set(scene.names) - self._digest.keys():
            return
        if self.arrivals.waiting() > max(_BATCH, len(scene) // 4):  # a folder that was full already: read it first
            return
        new = len(scene) - self._models.images
        idle = now - self._last > tuning.idle_s
        if new >= max(1, tuning.more * self._models.images) or (idle and (new or self._models.ties < len(self._ties))):
            self._models.start(scene, self.ties(scene))
            self._models.ties = len(self._ties)

    def _take_model(self, made: watchmodel.Modelled) -> None:
        scene = self._models.scene
        self._remember(scene, made.ties)
        if made.poses is None:
            return
        self.poses = {n: made.poses[k] for k, n in enumerate(scene.names) if np.isfinite(made.poses[k]).all()}
        self._rigs, self._tried = made.rigs, {}
        self._models.of = frozenset(self.poses)
        said = f"model of {len(self.poses)} of {len(scene)} images in {self._models.seconds:.0f} s"
        if made.surface is not None and len(made.surface):
            said += f"; {made.surface.shares()[VERDICTS[0]]:.0f} % of the surface well covered"
            said += f", {len(made.places)} weak places"
        self.run.reporter.say(said)
        self.run.reporter.event("model", images=len(self.poses), of=len(scene), seconds=round(self._models.seconds, 2))

    def state(self) -> dict[str, Any]:
        """Content of the page."""
        scene, trouble, making = self.scene, self.arrivals.trouble or self._trouble, self._models.busy
        now = f"watching; making a model of {self._models.images} images" if making else "watching"
        broken = {f: p.reason for f, p in sorted(self._probes.items()) if p.reason}
        out: dict[str, Any] = {
            "folder": str(self.run.inputs.images), "trouble": trouble, "now": trouble or now, "notes": [], "untied": [],
            "latency_s": statistics.median(self.times) if self.times else None, "frames": [], "ties": [],
            "metric": False, "counts": {"images": 0, "tied": 0, "posed": 0},
        }  # fmt: skip
        if scene is None:
            out["surface"] = watchmodel.shown_surface(self._models, np.eye(4), 1.0)
        else:
            least = self.run.settings.candidates.min_matches
            poses = self._known(scene).poses
            out |= watchmodel.shown_scene(scene, self.ties(scene), poses, self._models, least)
            broken = {**{d.name: d.reason for d in scene.dropped}, **broken}
            out["notes"] = list(scene.notes)
        out["broken"] = [[name, why] for name, why in sorted(broken.items())]
        out["counts"] |= {"broken": len(broken), "waiting": self.arrivals.waiting()}
        return out

    def keep(self) -> None:
        """Write ties, digests and the page."""
        self._unsaved = False
        numbers = {name: k for k, name in enumerate(sorted(self._digest))}
        there = {e: m for e, m in self._ties.items() if numbers.keys() >= set(e)}
        ends = np.array([(numbers[a], numbers[b]) for a, b in there], int).reshape(-1, 2)
        ties = PreviewMatches.make(ends[:, 0], ends[:, 1], list(there.values()))
        known = json.dumps([[name, self._digest[name]] for name in numbers])
        save_npz(self.run.path(KEPT), known=np.array(known), **ties.to_npz())
        write_atomic(self.run.path(PAGE), page(self.state()))

    def _recall(self) -> None:
        """The stored state of an earlier run; unreadable parts are made again."""
        try:
            data = load_npz(self.run.path(KEPT))
            known = json.loads(str(data.pop("known")))
            ties = PreviewMatches.from_npz(data)
        except (InputError, KeyError, ValueError):
            return
        self._digest, pairs = dict(known), zip(ties.i.tolist(), ties.j.tolist())
        self._ties = {(known[a][0], known[b][0]): ties.of(t) for t, (a, b) in enumerate(pairs)}
