"""`tiegraph stations`: shots without poses joined to the truth, strangers left out, and what it refuses."""

import json

import numpy as np
import pytest
from scipy.spatial import cKDTree

from stations.stations_world import bumpy, error_m, views, write_view
from tiegraph.cli.main import main
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import ENU, Origin
from tiegraph.pipeline.stations import pose_numbers
from tiegraph.scan.priors.trajectory import write_tum
from tiegraph.scene.cloudfile import read_cloud
from tiegraph.scene.posefile import read_poses

ANGLES = (0.0, 30.0, 60.0, 95.0)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Four stations and two of another object, as `tiegraph shots` leaves them; joined."""
    folder = tmp_path_factory.mktemp("stations")
    some = views(ANGLES)
    for k, view in enumerate([*some, *views([0.0, 30.0], seed=3)]):
        write_view(view, folder / "run" / "shots" / f"walk_{k:06d}.ply")
    (folder / "fewer.toml").write_text("[tuning.stations.precision]\nbands = 4\n")
    more = ["--tuning", str(folder / "fewer.toml"), "--quiet"]
    assert main(["stations", str(folder / "run"), "-o", str(folder / "out"), *more]) == 0
    return folder, some, json.loads((folder / "out" / "stations.json").read_text())


@pytest.mark.slow
def test_shots_are_joined_to_a_third_of_their_noise(made):
    folder, some, told = made
    found = read_poses(folder / "out" / "stations.tum")
    assert found.time_s.tolist() == [0, 1, 2, 3] and 0.00001 < error_m(found.poses, some) < 0.0002
    np.testing.assert_allclose(found.poses[0], np.eye(4), atol=1e-8)
    assert told["frame"] == "that of walk_000000"
    sigma = [c["sigma_m"] for c in told["clouds"][:4]]
    assert sigma[0] == 0 and all(0.000005 < s < 0.0002 for s in sigma[1:])


@pytest.mark.slow
def test_a_stranger_is_left_out_and_named(made):
    told = made[2]
    assert [c["joined"] for c in told["clouds"]] == [True] * 4 + [False] * 2
    assert told["clouds"][4]["why_not"] == "hangs on none of the others (only on 1 that do not either)"
    believed = {(p["first"][-1], p["second"][-1]) for p in told["pairs"] if p["believed"]}
    assert {("0", "1"), ("1", "2"), ("2", "3")} <= believed
    assert {ends for ends in believed if set(ends) & {"4", "5"}} == {("4", "5")}
    for pair in told["pairs"]:
        if pair["believed"]:
            assert 0.2 < pair["overlap"] < 0.9 and 0.0002 < pair["residual_m"] < 0.0008
            assert 1e-6 < pair["sigma_m"] < 0.0002 and pair["loop_after_m"] < 0.0003
        else:
            assert pair["why_not"]


@pytest.mark.slow
def test_precision_grows_with_the_distance_as_the_noise_does(made):
    bands = made[2]["precision"]
    assert len(bands) == 4 and made[2]["tuning"] == {"stations": {"precision": {"bands": 4}}}
    assert bands[0]["from_m"] > 0.4 and bands[-1]["to_m"] < 0.8
    measured, stated = (np.array([b[k] for b in bands]) for k in ("sigma_m", "stated_m"))
    assert measured[-1] > 1.3 * measured[0] and (np.diff(stated) > 0).all()
    assert (0.6 < measured / stated).all() and (measured / stated < 1.5).all()


@pytest.mark.slow
def test_the_cloud_is_the_object_without_duplicates(made):
    folder, some, told = made
    cloud = read_cloud(folder / "out" / "cloud.laz")
    assert len(cloud) == told["cloud"]["points"] and 0.3 < len(cloud) / sum(len(v.xyz) for v in some) < 1
    world = transforms.apply(some[0].world_from_station, cloud.xyz_m)
    off = np.linalg.norm(world, axis=1) - np.linalg.norm(bumpy(world, 0), axis=1)
    assert 0.0001 < np.sqrt(np.mean(off**2)) < 0.0009
    nearest = cKDTree(cloud.xyz_m).query(cloud.xyz_m, k=2)[0][:, 1]
    assert np.median(nearest) > 0.3 * told["voxel_m"]


@pytest.mark.slow
def test_prior_poses_are_the_start_and_the_frame(made, tmp_path):
    """Poses 3 mm off: joined as well as without, and the frame is that of the priors on the average."""
    folder, some, _ = made
    rng = np.random.default_rng(0)
    poses = np.array([v.world_from_station for v in some])
    poses[:, :3, 3] += 0.003 * rng.normal(size=(4, 3))
    write_tum(tmp_path / "prior.tum", np.arange(4.0), poses)
    clouds = [str(folder / "run" / "shots" / f"walk_{k:06d}.ply") for k in range(4)]
    asked = ["stations", *clouds, "--poses", str(tmp_path / "prior.tum"), "-o", str(tmp_path / "out"), "--quiet"]
    assert main(asked) == 0
    found = read_poses(tmp_path / "out" / "stations.tum").poses
    assert error_m(found, some) < 0.0002
    off = np.array([f[:3, 3] - p[:3, 3] for f, p in zip(found, poses)])
    assert np.abs(off.mean(axis=0)).max() < 0.0001 < 0.001 < np.abs(off).max()


def refused(capsys, *arguments):
    """What the verb says when it refuses."""
    assert main(["stations", *map(str, arguments), "--quiet"]) != 0
    return capsys.readouterr().err


def test_bad_input_is_named(tmp_path, capsys):
    out, one = tmp_path / "out", tmp_path / "a.ply"
    (view,) = views([0.0], points=300)
    write_view(view, one)
    assert "the only cloud" in refused(capsys, one, "-o", out)
    (tmp_path / "empty").mkdir()
    assert "no clouds in it" in refused(capsys, tmp_path / "empty", "-o", out)
    assert "give a folder of clouds" in refused(capsys, tmp_path / "no.xyz", "-o", out)
    write_view(view, tmp_path / "other" / "a.ply")
    assert "two clouds have this name" in refused(capsys, one, tmp_path / "other" / "a.ply", "-o", out)
    assert "--voxel-m -1" in refused(capsys, one, one, "-o", out, "--voxel-m", "-1")
    b = tmp_path / "b.ply"
    nothing = type(view)(*(v[:0] for v in (view.xyz, view.true, view.normal, view.sigma_m)), view.world_from_station)
    write_view(nothing, b)
    assert "b.ply: it has no points" in refused(capsys, one, b, "-o", out)
    write_view(view, b)
    (tmp_path / "p.tum").write_text("7 0 0 0 0 0 0 1\n8 1 0 0 0 0 0 1\n")
    assert "no cloud has the number 7" in refused(capsys, one, b, "-o", out, "--poses", tmp_path / "p.tum")
    assert not out.exists()


def test_clouds_of_two_worlds_are_refused(tmp_path, capsys):
    (view,) = views([0.0], points=300)
    for k, name in enumerate("ab"):
        write_view(view, tmp_path / f"{name}.ply", Origin(35.0 + k, 139.0, 0.0, ENU))
    said = refused(capsys, tmp_path / "a.ply", tmp_path / "b.ply", "-o", tmp_path / "out")
    assert "b.ply is in ENU about 36" in said and "bring all into one CRS" in said


def test_numbers_of_poses():
    assert pose_numbers(["up_000007", "up_000012"]) == [7, 12]
    assert pose_numbers(["7_up", "12_up"]) == [7, 12]
    assert pose_numbers(["a1", "b1"]) == pose_numbers(["left", "right"]) == [0, 1]
