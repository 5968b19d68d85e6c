"""Glue of georef: a child that dies, and a control file that does not fit."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from tiegraph.errors import ChildDied, InputError, UnreadableArtefact
from tiegraph.pipeline import georef
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.world.georeferencing import GeorefRequest
from tiegraph.sfm.world.worldadjust import ConstantParameters


def _request(target: Path) -> GeorefRequest:
    return GeorefRequest(
        folders=(),
        target=target,
        scene="",
        settings=GeorefSettings(adjust="yes"),
        measurements=None,  # type: ignore[arg-type]
        constant=ConstantParameters(),
        tuning=Tuning(),
        database=target,
    )


@pytest.mark.parametrize("deadly", [("yes",), ("yes", "no")])
def test_georef_is_tried_once_more_without_the_adjustment(tmp_path: Path, monkeypatch, deadly: tuple[str, ...]) -> None:
    run, tried = SimpleNamespace(log=tmp_path / "log.txt"), []

    def child(function, request, **how):
        assert not request.target.exists(), "nothing of the first try is left"
        request.target.mkdir()
        tried.append(request.settings.adjust)
        if request.settings.adjust in deadly:
            raise ChildDied("georeferencing: the native library ended its process (signal SIGSEGV)")
        return "the world"

    monkeypatch.setattr(georef, "run_in_child", child)
    if deadly == ("yes",):
        found, said = georef._georeferenced(run, _request(tmp_path / "world"))
        assert found == "the world" and "not adjusted" in said[0] and "SIGSEGV" in said[0]
    else:
        with pytest.raises(ChildDied):
            georef._georeferenced(run, _request(tmp_path / "world"))
    assert tried == ["yes", "no"]


@pytest.mark.parametrize("error", [InputError("none of its 4 coded targets is seen"), UnreadableArtefact("a", "b")])
def test_control_points_that_do_not_fit_are_not_used_and_said(monkeypatch, error: InputError) -> None:
    def fails(*arguments):
        raise error

    monkeypatch.setattr(georef, "control_file", lambda run: SimpleNamespace(targets=(), points=()))
    monkeypatch.setattr(georef, "target_marks", fails)
    if isinstance(error, UnreadableArtefact):
        with pytest.raises(UnreadableArtefact):
            georef._measured_in_images(None, None)  # type: ignore[arg-type]
        return
    found, _, unfit = georef._measured_in_images(None, None)  # type: ignore[arg-type]
    assert found.control is None and found.bars is None and "coded targets" in unfit[0]
