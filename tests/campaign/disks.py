"""No room: a file system of random size, or a limit to the size of a file; then room, and the same command again."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from campaign import oracle
from campaign.case import Case, Result, finish_again
from campaign.world import NAMES, PATIENCE_S

_WORDS = ("No space left", "space", "full", "too large", "size limit", "file size", "room", "disk")
_MIB = 1 << 20


def can_mount(folder: Path) -> bool:
    """May file systems be mounted here?"""
    folder.mkdir(parents=True, exist_ok=True)
    if os.geteuid() != 0 or not _mount(folder, _MIB):
        return False
    return _unmount(folder)


def _mount(folder: Path, size: int, *options: str) -> bool:
    words = ["mount", "-t", "tmpfs", "-o", ",".join([*options, f"size={size}"]), "tmpfs", str(folder)]
    return subprocess.run(words, capture_output=True, check=False).returncode == 0


def _unmount(folder: Path) -> bool:
    return subprocess.run(["umount", "-l", str(folder)], capture_output=True, check=False).returncode == 0


def run(case: Case) -> Result:
    """One full disk (where mounting is allowed, every second case) or limit to the size of files."""
    if case.index % 2 == 0 and can_mount(case.folder / "disk"):
        return _full(case)
    return _limited(case)


def _start(case: Case) -> tuple[str, str]:
    k = case.rng.randrange(len(NAMES))
    return NAMES[k], NAMES[k - 1] if k else ""


def _full(case: Case) -> Result:
    stage, before = _start(case)
    disk = case.folder / "disk"
    held = _size(case.world.clean[before]) if before else 0
    grown = _size(case.world.clean[NAMES[-1]]) - held
    size = held + 65536 + int(case.rng.random() ** 2 * 0.9 * grown)
    what = f"a disk of {size / _MIB:.2f} MiB from {stage} on"
    if not _mount(disk, 256 * _MIB):
        return case.result("disk", what, oracle.Verdict(oracle.STUCK, "mounting failed"))
    try:
        out = case.world.after(before, disk / "out")
        _mount(disk, size, "remount")
        command = case.world.command(out, "--pool", case.rng.choice(("local:2", "serial")))
        ended = case.server.run(command, case.folder, PATIENCE_S)
        verdict = oracle.refusal(ended, _WORDS) if ended.code != 0 else oracle.Verdict(oracle.HARMLESS, "it had room")
        if verdict.name not in oracle.GOOD:
            return case.result("disk", what, verdict, ended.text)
        _mount(disk, 512 * _MIB, "remount")
        after, text = finish_again(case, command, out, {})
        return case.result("disk", what, after or verdict, text)
    finally:
        _unmount(disk)


def _limited(case: Case) -> Result:
    stage, before = _start(case)
    limit = int(10 ** case.rng.uniform(3.0, 6.6))
    what = f"files of {limit} bytes at most from {stage} on"
    out = case.world.after(before, case.folder / "out")
    command = case.world.command(out, "--pool", case.rng.choice(("local:2", "serial")))
    ended = case.server.run(command, case.folder, PATIENCE_S, file_bytes=limit)
    verdict = oracle.refusal(ended, _WORDS) if ended.code != 0 else oracle.Verdict(oracle.HARMLESS, "it had room")
    if verdict.name not in oracle.GOOD:
        return case.result("limit", what, verdict, ended.text)
    after, text = finish_again(case, command, out, {})
    return case.result("limit", what, after or verdict, text)


def _size(folder: Path) -> int:
    """Bytes on a disk of pages of 4 KiB."""
    return sum(-(-p.lstat().st_size // 4096) * 4096 for p in folder.rglob("*"))
