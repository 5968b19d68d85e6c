"""`tiegraph report OUT --language ja --pdf`: the stage, then the page printed."""

import pytest

from tiegraph.cli import report
from tiegraph.errors import EngineMissing


@pytest.fixture
def asked(monkeypatch):
    """What the stage is run with, and what is printed."""
    calls = []
    monkeypatch.setattr(report.run, "main_stage", lambda stage, arguments, *_: calls.append((stage, arguments)) or 0)
    monkeypatch.setattr(report, "find_browser", lambda: "chromium")
    monkeypatch.setattr(report, "print_pdf", lambda page, target: calls.append((page.name, target)))
    return calls


def test_language_is_the_setting_and_pdf_prints_after_the_stage(asked, tmp_path, capsys):
    assert report.main([str(tmp_path), "--language", "ja", "--pdf"]) == 0
    assert asked == [
        ("report", [str(tmp_path), "--report.language", "ja"]),
        ("report.html", tmp_path / "report.pdf"),
    ]
    assert f"printed: {tmp_path / 'report.pdf'}" in capsys.readouterr().out
    report.main([str(tmp_path), "--language=en"])
    assert asked[2:] == [("report", [str(tmp_path), "--report.language=en"])]


def test_what_is_missing_is_said_before_the_work(asked, monkeypatch, tmp_path):
    def none():
        raise EngineMissing("no browser")

    monkeypatch.setattr(report, "find_browser", none)
    with pytest.raises(EngineMissing, match="no browser"):
        report.main([str(tmp_path), "--pdf"])
    assert asked == []
