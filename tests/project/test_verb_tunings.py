"""Constants of verbs without a run folder come from a file that --tuning names."""

import re

import pytest

from tiegraph.errors import SettingsError
from tiegraph.project.settings import Tunings
from tiegraph.project.verbtunings import VerbTunings, read_tunings


def test_a_file_changes_what_it_names(tmp_path):
    path = tmp_path / "tuning.toml"
    path.write_text("[tuning.stations.precision]\nbands = 4\n[tuning.scene.blocks]\nown = 300\n")
    found = read_tunings(path)
    assert found.stations.precision.bands == 4 != VerbTunings().stations.precision.bands
    assert found.calibrate == VerbTunings().calibrate
    assert found.changed() == {"stations": {"precision": {"bands": 4}}, "scene": {"blocks": {"own": 300}}}
    assert found.of_stages() == {"scene": {"blocks": {"own": 300}}}
    assert read_tunings(None).changed() == {}


def test_every_engine_with_constants_is_in_reach():
    """Of the stages by a run's tiegraph.toml, of the others by --tuning."""
    from pathlib import Path

    import tiegraph

    rooms = {p.parent.name for p in Path(tiegraph.__file__).parent.glob("*/tuning.py")}
    rooms |= {p.parent.parent.name for p in Path(tiegraph.__file__).parent.glob("*/tuning/__init__.py")}
    assert len(rooms) > 15 and rooms == set(VerbTunings.model_fields)
    assert set(Tunings.model_fields) < rooms


@pytest.mark.parametrize(
    "text, said",
    [
        ("[tuning.stations.precision]\nband = 4\n", "unknown setting 'tuning.stations.precision.band': .*'bands'"),
        ("[tuning.station]\n", "unknown setting 'tuning.station': .*'stations'"),
        ("[masks]\nsource = 'none'\n", "unknown setting 'masks'"),
        ("[tuning.stations.precision]\nbands = 0\n", "tuning.stations.precision.bands = 0: "),
        ("[tuning.stations", "not valid TOML"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, text, said):
    path = tmp_path / "tuning.toml"
    path.write_text(text)
    with pytest.raises(SettingsError, match=f"{re.escape(str(path))}: {said}"):
        read_tunings(path)
    with pytest.raises(SettingsError, match="--tuning .*there.toml: not there"):
        read_tunings(tmp_path / "there.toml")
