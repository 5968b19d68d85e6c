"""The exposure that cameras write reaches the decision between bridge and open sky."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scan_worlds import exif_of, picture, scan

from tiegraph.network.passes import find_passes
from tiegraph.network.sections.sections import find_sections
from tiegraph.network.tuning import SectionsTuning
from tiegraph.pipeline.preview import up_light
from tiegraph.project.settings import Settings

FRAMES, BRIDGE, GREY, SKY = 16, range(6, 11), 118.0, 0.5


def survey(folder: Path) -> Path:
    """A camera and one that looks up, whose automatic exposure makes the deck of a bridge as bright as the sky."""
    for k in range(FRAMES):
        under = k in BRIDGE
        shown = exif_of(exposure=1 / 60 if under else 1 / 500, f_number=2.8, iso=400 if under else 100)
        picture(folder / "cam0" / f"{k:04d}.jpg", exif=exif_of(exposure=1 / 250, f_number=2.8, iso=100))
        picture(folder / "up" / f"{k:04d}.jpg", exif=shown)
    return folder


def test_sections_by_the_exposure_that_the_camera_wrote(tmp_path: Path) -> None:
    scene = scan(survey(tmp_path / "images"))
    assert scene.exposure is not None
    up = np.array([scene.sensor_of(k).role == "up" for k in range(len(scene))])
    assert scene.exposure[~up] == pytest.approx(100 / 250 / 2.8**2)
    assert sorted(set(scene.exposure[up])) == pytest.approx([100 / 500 / 2.8**2, 400 / 60 / 2.8**2])
    run = SimpleNamespace(settings=Settings(), folder=tmp_path, map=lambda _, names, *__: [(GREY, SKY)] * len(names))
    light = up_light(run, scene)
    found = find_sections(scene, find_passes(scene), light, SectionsTuning())
    bridge = [f for s in found.sections if s.kind == "bridge" for f in s.frames]
    assert bridge == list(BRIDGE), found.notes


def test_a_fixed_aperture_may_be_left_away(tmp_path: Path) -> None:
    for k in range(2):
        picture(tmp_path / "images" / f"{k}.jpg", exif=exif_of(exposure=0.01) if k else exif_of(iso=100))
    exposure = scan(tmp_path / "images").exposure
    assert exposure is not None and np.isnan(exposure[0]) and exposure[1] == pytest.approx(0.01)


def test_images_without_exposure_have_none(tmp_path: Path) -> None:
    for k in range(2):
        picture(tmp_path / "images" / f"{k}.jpg")
    assert scan(tmp_path / "images").exposure is None
