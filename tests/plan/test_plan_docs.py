"""The examples of docs/plan.md are what they say."""

import json
import re
import shlex
from pathlib import Path

import pytest

from tiegraph.cli.main import main

PAGE = Path(__file__).parents[2] / "docs" / "plan.md"
COMMANDS = [c for c in re.findall(r"```\n(tiegraph plan .*?)\n```", PAGE.read_text()) if "--compare" not in c]
SHAPES = [re.search(r"--shape (\w+)", c) for c in COMMANDS]


def run(command: str, folder: Path) -> dict:
    words = shlex.split(command)[1:]
    if "-o" in words:
        words[words.index("-o") + 1] = str(folder / "out")
    else:
        words += ["-o", str(folder / "out")]
    assert main(words) == 0
    return json.loads((folder / "out" / "plan.json").read_text())


def test_there_is_one_for_each_kind_of_user():
    assert [found and found[1] for found in SHAPES] == [None, "canal", "facade", "grid", "tunnel"]
    assert (PAGE.parent / "pictures" / "plan_grid.png").exists()


def test_the_table_of_the_paper(tmp_path):
    rows = run(COMMANDS[0], tmp_path)["stations"]
    for row in rows:
        assert f"{1000 * row['depth_sigma_2_rays_m']:.3f}" in PAGE.read_text()


@pytest.mark.slow
@pytest.mark.parametrize("number", range(1, 5))
def test_a_path_has_the_images_and_sigmas_that_the_page_says(number, tmp_path):
    path = run(COMMANDS[number], tmp_path)["path"]
    said = PAGE.read_text().split(COMMANDS[number])[1].split("```")[1]
    counted = re.search(r"(\d+) images", said)
    assert counted is None or int(counted[1]) == path["images"]
    bounds = [(0.6, 1.1), (1.5, 2.6), (10, 25), (2, 9)][number - 1]  # mm: cameras of the boat, else points
    figure = "position" if number == 1 else "point"
    assert bounds[0] < 1000 * path[f"{figure}_shape_sigma_median_m"] < bounds[1]
    world = [(38, 46), (4, 9), (18, 32), (6, 12)][number - 1]
    assert world[0] < 1000 * path[f"{figure}_world_sigma_median_m"] < world[1]
