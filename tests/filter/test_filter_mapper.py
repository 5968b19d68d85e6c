"""What the mapper gets to see: a refused pair is gone from its copy, the database of `match` stays whole."""

from __future__ import annotations

import sqlite3

import numpy as np
import pycolmap
from filter_world import rig

from tiegraph.scene.colmaprows import create_database
from tiegraph.scene.scene import simple_scene
from tiegraph.sfm.database import ViewGraph, write_working_copy


def test_refused_pairs_are_left_out(tmp_path):
    scene = simple_scene(rig(1, 0.0), ["a.jpg", "b.jpg", "c.jpg"], np.arange(3), np.zeros(3, int))
    source, target = tmp_path / "database.db", tmp_path / "copy.db"
    create_database(source, scene)
    matches = np.column_stack([np.arange(30)] * 2).astype(np.uint32)
    with pycolmap.Database.open(source) as database:
        for i, j in ((1, 2), (1, 3), (2, 3)):
            geometry = pycolmap.TwoViewGeometry()
            geometry.inlier_matches = matches
            database.write_two_view_geometry(i, j, geometry)
    write_working_copy(source, target, scene, {}, None, refused=[(2, 0)])
    count = "SELECT count(*) FROM two_view_geometries"
    with sqlite3.connect(target) as copy, sqlite3.connect(source) as original:
        assert copy.execute(count).fetchone() == (2,)
        assert original.execute(count).fetchone() == (3,)
    assert ViewGraph(source, scene, 15, refused=[(0, 2)]).pairs.tolist() == [[0, 1], [1, 2]]
    assert len(ViewGraph(source, scene, 15).pairs) == 3
