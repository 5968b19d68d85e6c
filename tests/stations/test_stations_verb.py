"""Stations: pairs judged by loops and free space, and the verb that joins shots without poses to the truth."""

import json

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from stations.stations_world import bumpy, error_m, hall, scans, views, write_view
from tiegraph.cli.main import main
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import ENU, Origin
from tiegraph.pipeline.shots import pose_numbers
from tiegraph.scene.cloudfile import read_cloud
from tiegraph.scene.posefile import read_poses, write_tum
from tiegraph.stations.loops import adjusted, contradicted, parts, taken_apart
from tiegraph.stations.pairs import Pair, Shot, common_side, looked_through, station_of
from tiegraph.stations.tuning import Tuning

POSES = [
    transforms.rigid(Rotation.random(random_state=k).as_matrix(), np.random.default_rng(k).normal(size=3))
    for k in range(9)
]
POINTS = [np.random.default_rng(9).normal(size=(50, 3))] * 9


def pair(i, j, off_m=0.0, overlap=0.5, sigma_m=0.001):
    """A pair that is right but for a shift."""
    true = transforms.invert(POSES[i]) @ POSES[j]
    true[:3, 3] += off_m * np.array([0.6, 0.0, 0.8])
    known = {"residual_m": 0.001, "middle": np.zeros(3), "information": np.eye(6) / sigma_m**2}
    return Pair(first=i, second=j, first_from_second=true, overlap=overlap, **known)


def test_the_one_wrong_pair_is_found():
    pairs = [pair(i, j, off_m=0.5 * ((i, j) == (1, 3))) for i in range(5) for j in range(i + 1, 5)]
    judged = contradicted(pairs, POINTS, 0.05)
    wrong = [p for p in judged if p.why_not]
    assert [(p.first, p.second) for p in wrong] == [(1, 3)]
    assert wrong[0].why_not == "3 loops of three contradict it and 0 bear it out"


def test_a_pair_without_loops_needs_more_overlap():
    judged = contradicted([pair(0, 1, overlap=0.25), pair(1, 2, overlap=0.4)], POINTS, 0.05)
    assert "no loop bears it out, and 25% overlap" in judged[0].why_not and not judged[1].why_not
    assert parts(5, judged)[1] == parts(5, judged)[2] != parts(5, judged)[0]


@pytest.mark.slow
def test_groups_that_are_joined_in_two_ways_are_taken_apart():
    """Groups 0 to 3 and 4 to 7, joined by two pairs of which one is wrong; 8 hangs on 7 alone."""
    groups = [(i, j) for first in (0, 4) for i in range(first, first + 4) for j in range(i + 1, first + 4)]
    pairs = [pair(i, j, off_m=0.5 * ((i, j) == (3, 6))) for i, j in [*groups, (0, 4), (3, 6), (7, 8)]]
    close = adjusted(list(range(9)), pairs, 9)
    left = {(p.first, p.second): row[1] for p, row in zip(close.pairs, close.loop_m)}
    judged = taken_apart(pairs, left, POINTS, 0.05)
    assert [(p.first, p.second) for p in judged if p.why_not] == [(0, 4), (3, 6)]
    assert "contradict each other by up to" in judged[-2].why_not
    hanging = parts(9, judged)
    assert set(hanging[:4]) != set(hanging[4:]) and len(set(hanging)) == 2
    assert taken_apart(pairs, dict.fromkeys(left, 0.01), POINTS, 0.05) == pairs


@pytest.mark.slow
def test_the_error_of_a_loop_is_distributed_by_what_is_known():
    """A ring that does not close by 40 mm: the pair known ten times worse takes nearly all of it."""
    ring = [pair(0, 1), pair(1, 2), pair(2, 3), pair(3, 4, sigma_m=0.01), pair(0, 4, off_m=0.04)]
    part = adjusted([0, 1, 2, 3, 4], ring, 5)
    np.testing.assert_allclose(part.poses[0], np.eye(4))
    before, after = part.loop_m.T
    assert before.max() == pytest.approx(0.04, abs=1e-6)
    assert after[3] > 0.03 and after[[0, 1, 2, 4]].max() < 0.003
    sigma = np.sqrt(np.trace(part.covariance[:, 3:, 3:], axis1=1, axis2=2) / 3)
    assert sigma[0] == 0 and sigma[1] < sigma[2] < sigma[3]


@pytest.mark.slow
def test_free_space_tells_one_bay_from_the_next():
    """Two stations near one end of a hall of equal bays: its shape repeats."""
    views = scans(hall(), [[1.2, 0.4, 1.5], [3.1, -0.5, 1.5]])
    shots = [Shot(str(k), v.xyz) for k, v in enumerate(views)]
    side = common_side(shots, Tuning())
    a, b = (station_of(s, side, Tuning()) for s in shots)
    world = [v.world_from_station for v in views]
    true = a.shift @ transforms.invert(world[0]) @ world[1] @ b.shift_back
    along = transforms.rigid(np.eye(3), -2.0 * world[0][0, :3])  # a bay along the hall's x, in the first one's frame
    assert looked_through(a, b, true) < 0.01 and 0.02 < looked_through(a, b, along @ true) < 0.3


ANGLES = (0.0, 30.0, 60.0)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Three stations and two of another object, as `tiegraph shots` leaves them; joined."""
    folder = tmp_path_factory.mktemp("stations")
    some = views(ANGLES, points=15_000)
    for k, view in enumerate([*some, *views([0.0, 30.0], seed=3, points=15_000)]):
        write_view(view, folder / "run" / "shots" / f"walk_{k:06d}.ply")
    (folder / "fewer.toml").write_text("[tuning.stations.precision]\nbands = 4\n")
    more = ["--tuning", str(folder / "fewer.toml"), "--quiet"]
    assert main(["stations", str(folder / "run"), "-o", str(folder / "out"), *more]) == 0
    return folder, some, json.loads((folder / "out" / "stations.json").read_text())


@pytest.mark.slow
def test_shots_are_joined_to_a_third_of_their_noise(made):
    folder, some, told = made
    found = read_poses(folder / "out" / "stations.tum")
    assert found.time_s.tolist() == [0, 1, 2] and 0.00001 < error_m(found.poses, some) < 0.0002
    np.testing.assert_allclose(found.poses[0], np.eye(4), atol=1e-8)
    assert told["frame"] == "that of walk_000000"
    sigma = [c["sigma_m"] for c in told["clouds"][:3]]
    assert sigma[0] == 0 and all(0.000005 < s < 0.0002 for s in sigma[1:])


@pytest.mark.slow
def test_a_stranger_is_left_out_and_named(made):
    told = made[2]
    assert [c["joined"] for c in told["clouds"]] == [True] * 3 + [False] * 2
    assert told["clouds"][3]["why_not"] == "hangs on none of the others (only on 1 that do not either)"
    believed = {(p["first"][-1], p["second"][-1]) for p in told["pairs"] if p["believed"]}
    assert {("0", "1"), ("1", "2")} <= believed
    assert {ends for ends in believed if set(ends) & {"3", "4"}} == {("3", "4")}
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
    poses[:, :3, 3] += 0.003 * rng.normal(size=(3, 3))
    write_tum(tmp_path / "prior.tum", np.arange(3.0), poses)
    clouds = [str(folder / "run" / "shots" / f"walk_{k:06d}.ply") for k in range(3)]
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


@pytest.mark.slow
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
