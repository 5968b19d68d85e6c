"""The mesh of the smallest survey: files that open, near the cloud, resumed, and errors that are named."""

import io
import json
import shutil

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial import cKDTree

import here
import tiegraph
from tiegraph.errors import InputError, ReconstructionError
from tiegraph.pipeline import mesh as glue
from tiegraph.pipeline.files import world_origin
from tiegraph.project.inputs import Inputs
from tiegraph.project.run import Run
from tiegraph.project.settings import merged

pytestmark = pytest.mark.slow

FILES = {"mesh.glb", "mesh.obj", "mesh.mtl", "mesh.ply", "offset.json", "texture0.jpg"}


def run_of(folder, **settings):
    return Run(folder, Inputs(folder / "images"), merged({"mesh": settings}), pool="serial")


@pytest.fixture(scope="module")
def made(finished, server, tmp_path_factory):
    """A run folder after the report, with its mesh, by a child process for COLMAP's surface as users have it."""
    folder = finished.after("report", tmp_path_factory.mktemp("meshed") / "run")
    ended = server.run(["mesh", folder, "--pool", "serial", "--quiet"], folder.parent / "said", 200)
    assert ended.good, ended
    return folder


@pytest.fixture(autouse=True)
def surface_here(monkeypatch):
    """Its child is a function in the other tests: to start one costs more than the surface."""
    monkeypatch.setattr(glue, "run_in_child", here.here)


def turned(xyz):
    """z up, as in the world."""
    return np.stack([xyz[:, 0], -xyz[:, 2], xyz[:, 1]], axis=1)


def test_the_mesh_lies_on_the_cloud_and_its_files_agree(made):
    assert {p.name for p in (made / "mesh").iterdir()} == FILES
    ply = trimesh.load(made / "mesh" / "mesh.ply", process=False)
    whole = trimesh.load(made / "mesh" / "mesh.glb", process=False)
    text = trimesh.load(made / "mesh" / "mesh.obj", process=False)
    parts = whole.dump()
    counts = json.loads((made / "receipts" / "mesh.json").read_text())["counts"]
    assert len(ply.faces) == len(text.faces) == sum(len(p.faces) for p in parts) == counts["faces"] > 100
    corners = turned(np.concatenate([p.triangles.reshape(-1, 3) for p in parts]))
    for other in (corners, text.vertices):
        assert cKDTree(ply.vertices).query(other)[0].max() < 0.001
        assert cKDTree(other).query(ply.vertices)[0].max() < 0.001
    project = tiegraph.open(out=made)
    cloud = project.cloud()
    off = cKDTree(cloud.xyz_m).query(ply.vertices)[0]
    voxel = project.receipt("cloud")["counts"]["voxel"]
    assert np.median(off) < 2 * voxel and off.max() < 50 * voxel
    assert project.mesh()["glb"] == made / "mesh" / "mesh.glb" and set(project.mesh()) == {"glb", "obj", "ply", "json"}


def test_what_leads_to_the_crs_is_said(made):
    said = json.loads((made / "mesh" / "offset.json").read_text())
    origin = world_origin(made)
    assert said["crs"] == origin.crs and said["shift"] == list(origin.shift_m) and said["unit"] == "m"
    local = np.append(np.asarray(trimesh.load(made / "mesh" / "mesh.ply", process=False).vertices[0]), 1.0)
    assert np.allclose((np.array(said["crs_from_local"]) @ local)[:3], local[:3] + origin.shift_m)
    head = (made / "mesh" / "mesh.ply").read_bytes()[:1000].decode("latin-1")
    assert f"comment crs {origin.crs}, unit m" in head and "accuracy predicted" in head
    assert f"# crs {origin.crs}, unit m" in (made / "mesh" / "mesh.obj").read_text()[:300]
    whole = trimesh.load(made / "mesh" / "mesh.glb", process=False)
    assert whole.metadata is not None and said["accuracy"].startswith("accuracy predicted")


def test_textures_show_what_the_points_show(made):
    """Faces have the colours of the points beside them, which are those of the images."""
    cloud = tiegraph.open(out=made).cloud()
    tree, off = cKDTree(cloud.xyz_m), []
    for part in trimesh.load(made / "mesh" / "mesh.glb", process=False).dump():
        picture = np.asarray(part.visual.material.baseColorTexture)[..., :3].astype(float)
        uv = part.visual.uv[part.faces].mean(axis=1)
        pixel = picture[((1 - uv[:, 1]) * picture.shape[0]).astype(int), (uv[:, 0] * picture.shape[1]).astype(int)]
        near = tree.query(turned(part.triangles_center), 4)[1]
        off.append(np.abs(pixel - cloud.rgb[near].mean(axis=1)).mean(axis=1))
    assert np.median(np.concatenate(off)) < 20


def test_it_is_up_to_date_and_only_the_mesh_runs_again(made, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(made, folder, symlinks=True)
    project = tiegraph.open(out=folder, pool="serial")
    before = (folder / "mesh" / "mesh.ply").stat().st_mtime_ns
    project.run("mesh")
    assert (folder / "mesh" / "mesh.ply").stat().st_mtime_ns == before
    few = tiegraph.open(out=folder, pool="serial", settings={"mesh": {"faces": 100}})
    few.run("mesh")
    assert few.receipt("mesh")["counts"]["faces"] <= 100
    assert all(not why for _, why, _ in few.status())


def test_the_pool_does_not_change_a_byte(finished, made, server, tmp_path):
    folder = finished.after("report", tmp_path / "run")
    assert server.run(["mesh", folder, "--pool", "local:2", "--quiet"], tmp_path / "said", 200).good
    assert [n for n in FILES if (made / "mesh" / n).read_bytes() != (folder / "mesh" / n).read_bytes()] == []


def test_what_is_finished_stays_when_it_is_stopped(made, tmp_path, monkeypatch):
    folder = tmp_path / "run"
    shutil.copytree(made, folder, symlinks=True)
    shutil.rmtree(folder / "mesh")
    calls = []

    def counted(name, right):
        return lambda *args: calls.append(name) or right(*args)

    def stop(*args):
        raise KeyboardInterrupt

    for module, name in ((glue.surface, "mesh_of"), (glue.views, "seen_by"), (glue.views, "chosen")):
        monkeypatch.setattr(module, name, counted(name, getattr(module, name)))
    cut_out = glue.texture.cut_out
    monkeypatch.setattr(glue.texture, "cut_out", stop)
    with pytest.raises(KeyboardInterrupt):
        glue.mesh(run_of(folder))
    first = list(calls)
    assert {"mesh_of", "seen_by", "chosen"} == set(first)
    monkeypatch.setattr(glue.texture, "cut_out", cut_out)
    glue.mesh(run_of(folder))
    assert calls == first
    assert (folder / "mesh" / "mesh.glb").read_bytes() == (made / "mesh" / "mesh.glb").read_bytes()


def test_what_cannot_be_meshed_is_said(made, tmp_path, monkeypatch):
    folder = tmp_path / "run"
    shutil.copytree(made, folder, symlinks=True)
    shutil.rmtree(folder / "mesh")
    with pytest.raises(InputError, match=r"mesh.glb is not there yet: run\(until='mesh'\) makes it"):
        tiegraph.open(out=folder).mesh()
    with pytest.raises(ReconstructionError, match=r"raise --mesh.max-sigma-m \(1e-09\)"):
        glue.mesh(run_of(folder, max_sigma_m=1e-9))
    nothing = glue.views.Seen(np.zeros(0, int), np.zeros(0, np.float32))
    monkeypatch.setattr(glue.views, "seen_by", lambda *args: nothing)
    with pytest.raises(ReconstructionError, match="no image sees the surface"):
        glue.mesh(run_of(folder))


def test_textures_are_pictures(made):
    with Image.open(io.BytesIO((made / "mesh" / "texture0.jpg").read_bytes())) as picture:
        assert picture.format == "JPEG" and max(picture.size) <= 8192 and np.asarray(picture).std() > 5
