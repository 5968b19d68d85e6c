"""The results in a run folder, to compare two runs byte for byte."""

from pathlib import Path

# Tell when and how long, or which pool: different by nature. ``images`` are links.
_OF_THE_RUN = ("receipts", "log.txt", "report.html", "report.json", ".lock", "tiegraph.toml", "images")


def artefacts(out: Path) -> dict[str, bytes]:
    """Bytes of every file that is a result, by its path below the run folder."""
    found = {p.relative_to(out): p for p in out.rglob("*") if p.is_file()}
    return {n.as_posix(): p.read_bytes() for n, p in found.items() if n.parts[0] not in _OF_THE_RUN}
