"""What is kept of a file in memory goes when the file changes."""

import os

import pytest

from tiegraph.pipeline import design
from tiegraph.pipeline import features as previews
from tiegraph.scene.atomic import cached_by_file


def replace(path, text):
    path.with_suffix(".new").write_text(text)
    os.replace(path.with_suffix(".new"), path)


def test_a_file_is_read_once_and_again_when_replaced_or_changed(tmp_path):
    calls = []

    @cached_by_file(maxsize=2)
    def read(path, upper):
        calls.append(path)
        text = path.read_text()
        return text.upper() if upper else text

    path = tmp_path / "a.txt"
    replace(path, "one")
    assert [read(path, False), read(path, False), read(path, True)] == ["one", "one", "ONE"]
    assert len(calls) == 2
    replace(path, "two")
    assert read(path, False) == "two"
    path.write_text("three")
    assert read(path, False) == "three"
    read.cache_clear()
    path.unlink()
    with pytest.raises(FileNotFoundError):
        read(path, False)


@pytest.mark.parametrize(
    "read, below", [(previews.scene_of, ()), (design._checked, ("network",))], ids=["previews", "accuracy"]
)
def test_scene_of_a_run_folder_is_that_of_its_last_run(read, below, tmp_path, monkeypatch):
    monkeypatch.setattr(previews.Scene, "from_json", staticmethod(str))
    path = tmp_path.joinpath(*below, "scene.json")
    path.parent.mkdir(exist_ok=True)
    for text in ("first", "other"):
        replace(path, text)
        assert read(tmp_path) == text
