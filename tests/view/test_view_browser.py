"""The page of a finished run in a real browser."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from tiegraph.api import open_project
from tiegraph.errors import EngineMissing
from tiegraph.pipeline.pages import ViewServer
from tiegraph.pipeline.view import open_view
from tiegraph.report.pdf import find_browser

if TYPE_CHECKING:
    from campaign.world import World

SIZE = (1000, 700)


@pytest.mark.slow
def test_a_browser_draws_the_cloud_of_a_run(finished: World, tmp_path: Path) -> None:
    try:
        browser = find_browser()
    except EngineMissing:
        pytest.skip("no browser of the Chromium family on the PATH")
    viewed = open_view(open_project(None, finished.after("report", tmp_path / "run")).as_run())
    said = viewed.layers()
    assert said["ties"] and said["cameras"] and viewed.points > 1000
    for k in range(len(said["sheets"])):
        rows, columns = viewed.mesh(k)[:2]
        assert len(viewed.mesh(k)) == 2 + 3 * rows * columns and viewed.picture(k)[1:4] == b"PNG"
    server = ViewServer(viewed)
    Thread(target=server.serve_forever, daemon=True).start()
    place = ",".join(f"{v:.3f}" for v in viewed.middle)
    shot = tmp_path / "shot.png"
    command = [browser, "--headless=new", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-first-run"]
    command += ["--no-sandbox"] if os.geteuid() == 0 else []
    command += [f"--user-data-dir={tmp_path / 'profile'}", f"--window-size={SIZE[0]},{SIZE[1]}"]
    command += ["--virtual-time-budget=20000", f"--screenshot={shot}", f"{server.url}#{place}"]
    try:
        subprocess.run(command, capture_output=True, timeout=240, check=True)
    finally:
        server.shutdown()
        server.server_close()
    drawn = cv2.imread(str(shot))[:, 340:]
    off = np.abs(drawn.astype(int) - drawn[5, 5]).max(axis=2) > 20
    assert 0.03 < off.mean() < 0.95 and len(np.unique(drawn[off], axis=0)) > 200
