"""The artefacts of a run folder: which are up to date, which were lost or changed, and which files may be removed.

``tiegraph.project`` says when a stage is up to date and what becomes of its files. A file unchanged since it was made,
or one that a stage was writing when it ended, contains no user data and is removed.
"""

import dataclasses
import os
from collections.abc import Iterable, Sequence
from pathlib import Path, PurePosixPath

from tiegraph.errors import InputError, UnreadableArtefact
from tiegraph.project import stages
from tiegraph.scene.atomic import JOURNAL, is_temporary, remove
from tiegraph.text import some

_LET_GO = "files let go"
OTHER_KEY = "its inputs or settings changed"
LOST = "lost"  # in a receipt without a key: why its stage has no result
DIED = "died"  # beside it: a process had ended, which may not happen the next time
_SHOWN = 3


class Artefacts:
    """The artefacts that a table of stages makes below a run folder."""

    def __init__(self, folder: Path, table: Sequence[stages.Stage]) -> None:
        self.folder = folder
        self.receipts = stages.Receipts(folder)
        self._stages = tuple(table)
        self._troubles: dict[str, dict[str, str]] = {}

    def look(self, thorough: bool = False) -> bool:
        """Find files that were lost or changed since they were made; whether there are any. ``thorough``: also reads
        those with unchanged size and time."""
        self._troubles = {}
        for stage in self._stages:
            for name, what in () if self.is_let_go(stage) else self._differences(stage, thorough):
                for own in {stage.name, self._maker(name)} - {""}:
                    self._troubles.setdefault(own, {})[name] = what
        return bool(self._troubles)

    def damaged_by(self, error: Exception) -> bool:
        """Whether an error comes from a damaged artefact, which then counts as lost or changed."""
        if not isinstance(error, UnreadableArtefact):
            return self.look(thorough=True)
        path, folder = error.path.absolute(), self.folder.absolute()
        name = path.relative_to(folder).as_posix() if folder in path.parents else ""
        maker = self._maker(name)
        if maker:
            self._troubles.setdefault(maker, {})[name] = "cannot be read"
        return bool(maker)

    def why(self, stage: stages.Stage, key: str) -> str:
        """Why a stage is not up to date, in words; "" if it is."""
        receipt = self.receipts.read(stage.name)
        if self.receipts.damaged(stage.name) or self.receipts.files(stage.name) is None:
            return "its receipt is damaged"
        if not receipt:
            return "not run yet"
        if receipt.get("key", receipt.get("began")) != key:
            return OTHER_KEY
        if "key" not in receipt:
            return str(receipt.get(LOST, "was interrupted"))
        anew = [need for need, made in self._made_from(stage).items() if receipt.get("from", {}).get(need) != made]
        if anew:
            return f"{anew[0]} was made anew"
        return next((f"{name} {what}" for name, what in self._troubles.get(stage.name, {}).items()), "")

    def lost(self, stage: stages.Stage, key: str) -> str:
        """Why the images gave no result for a stage, from the present state; "" if that may have changed."""
        receipt = self.receipts.read(stage.name)
        return "" if receipt.get(DIED) or self._other(stage, key) else str(receipt.get(LOST, ""))

    def let_go(self, stage: stages.Stage) -> int:
        """Remove the files of a stage that is up to date, which stays so until another needs them; their bytes.

        Its receipt records it first: a stage whose files were removed on purpose never counts as damaged.
        """
        receipt, files = self.receipts.read(stage.name), self.receipts.files(stage.name) or {}
        own = [n for n in files if stages.covered(n, stage.makes) and (self.folder / n).exists()]
        size = sum((self.folder / n).stat().st_size for n in own)
        self.receipts.write(stage.name, {**receipt, _LET_GO: True})
        stages.take_away(self.folder, own)
        self.receipts.write_files(stage.name, {n: e for n, e in files.items() if n not in set(own)})
        return size

    def is_let_go(self, stage: stages.Stage) -> bool:
        """Whether the files of a stage were removed by ``let_go``."""
        return bool(self.receipts.read(stage.name).get(_LET_GO))

    def refuse(self, stage: stages.Stage) -> None:
        """Raise InputError for files that a stage did not make in the place of its artefacts."""
        ledger = self.receipts.files(stage.name)
        if ledger is None:  # damaged: existing files are put aside
            return
        there = (n for n in self._there(stage) if n not in ledger)
        if found := [n for n in there if not stages.covered(n, stage.scratch) and not is_temporary(n)]:
            raise InputError(
                f"{self.folder}: {some(found, _SHOWN)} lie where stage {stage.name} writes its results, but no receipt "
                "lists them as made by tiegraph: move them elsewhere, or give another -o folder"
            )

    def recover(self) -> None:
        """Enter the files of an interrupted run into the lists of its stages. The journal stays until a stage begins:
        a worker may still be writing a file that it noted there."""
        claimed: dict[str, set[str]] = {}
        for name in stages.read_journal(self.folder):
            claimed.setdefault(self._maker(name), set()).add(name)
        for stage in self._stages:
            ledger = self.receipts.files(stage.name)
            if claimed.get(stage.name) and ledger is not None:
                there: stages.Ledger = {n: [] for n in _within(self._there(stage), claimed[stage.name])}
                done = "key" in self.receipts.read(stage.name)
                self.receipts.write_files(stage.name, there | ledger if done else ledger | there)

    def begin(self, stage: stages.Stage, key: str) -> list[str]:
        """Keep the finished items of an interrupted run with the same key, remove files made from other sources;
        notes. No worker may be at work. Raises InputError for files that are not ours."""
        self.recover()
        said, names, ledger = [], self._there(stage), self.receipts.files(stage.name)
        if self.receipts.damaged(stage.name):
            said.append(f"{self.receipts.path(stage.name)} could not be read: the stage runs again")
        troubles = self._troubles.pop(stage.name, {})
        if ledger is None:
            place = stages.put_aside(self.folder, names)
            said += [f"the list of what {stage.name} made was damaged: its files are in {place} now"] if place else []
            names, ledger = [], {}
        self.refuse(stage)
        told = some((f"{n} {what}" for n, what in troubles.items()), _SHOWN, joint="; ")
        changed = [n for n, what in troubles.items() if what != "is missing" and stages.covered(n, _tops(stage))]
        theirs = [n for n in changed if stages.trouble(self.folder / n, self._last(n, ledger), thorough=True)]
        place = stages.put_aside(self.folder, [n for n in theirs if os.path.lexists(self.folder / n)])
        stages.take_away(self.folder, set(changed) - set(theirs))
        if troubles:
            said.append(f"{told}: made again" + (f"; the previous files are in {place} now" if place else ""))
        names = [n for n in names if n not in set(changed)]
        if self._other(stage, key) or (troubles and not stage.item):
            if stage.clear is not None:
                stage.clear(self.folder)
            stages.take_away(self.folder, names)
            ledger = {}
        else:
            # An item is missing if one of its files is; it has one of the same name in each folder of its stage.
            tails = {n[len(top) :] for n in troubles for top in stage.makes if stages.covered(n, (top,))} - {""}
            whole = {f"{top}{tail}" for top in stage.makes for tail in tails} & set(ledger)
            stages.take_away(self.folder, [*filter(is_temporary, names), *whole])
            ledger = {n: e for n, e in ledger.items() if n not in whole}
        # In this order: a finished receipt never exists beside a list without its files.
        self.receipts.write(stage.name, {"stage": stage.name, "began": key, "from": self._made_from(stage)})
        self.receipts.write_files(stage.name, {n: e for n, e in ledger.items() if n not in troubles})
        self.end_journal()
        return said

    def finish(self, stage: stages.Stage, key: str, outcome: stages.Outcome, more: dict) -> dict:
        """Remove its scratch files, write the list of the others and then the full receipt."""
        for name in stage.scratch:
            remove(self.folder / name)
        mine = {*(self.receipts.files(stage.name) or {}), *stages.read_journal(self.folder)}
        names = _within(stages.files_below(self.folder, stage.makes, self._apart(stage)), mine)
        files = stages.recorded(self.folder, names)
        shared = stages.recorded(self.folder, [n for n in stage.changes if (self.folder / n).exists()])
        self.receipts.write_files(stage.name, {**files, **shared})
        made = stages.digest_of(files, stage.makes)
        head = {"stage": stage.name, "key": key, "from": self._made_from(stage), "made": made, "version": stage.version}
        receipt = {**head, **more, **dataclasses.asdict(outcome)}
        self.receipts.write(stage.name, receipt)
        self.end_journal()
        return receipt

    def end_journal(self) -> None:
        """Clear the journal: its names are in the lists, and no worker writes."""
        (self.folder / JOURNAL).unlink(missing_ok=True)

    def _there(self, stage: stages.Stage) -> list[str]:
        return stages.files_below(self.folder, _tops(stage), self._apart(stage))

    def _apart(self, stage: stages.Stage) -> list[str]:
        """Artefacts of other stages inside this one's."""
        mine = _tops(stage)
        others = (top for s in self._stages if s is not stage for top in _tops(s))
        return [top for top in others if stages.covered(top, mine) and top not in mine]

    def _differences(self, stage: stages.Stage, thorough: bool) -> Iterable[tuple[str, str]]:
        shared = {n for s in self._stages if self._changed(s) for n in s.changes}
        old = set() if self._changed(stage) else set(stage.changes)
        for name, entry in (self.receipts.files(stage.name) or {}).items():
            known = [] if name in (shared - set(stage.changes)) | old else entry
            if what := stages.trouble(self.folder / name, known, thorough):
                yield name, what

    def _last(self, name: str, ledger: stages.Ledger) -> list:
        """Last known record of a file, by its maker's list or that of a stage that has changed it; [] during that."""
        for stage in (s for s in self._stages if name in s.changes and self._changed(s)):
            done = "key" in self.receipts.read(stage.name)
            ledger = (self.receipts.files(stage.name) or {}) if done else {}
        return ledger.get(name, [])

    def _changed(self, stage: stages.Stage) -> bool:
        """Whether a stage has changed the present files of others: their makers have not made them again since."""
        before, now = self.receipts.read(stage.name).get("from", {}), self._made_from(stage)
        return bool(before) and all(before.get(m) == now.get(m) for m in map(self._maker, stage.changes))

    def _maker(self, name: str) -> str:
        """The stage that makes a file; "" for none."""
        found = [(len(top), s.name) for s in self._stages for top in _tops(s) if stages.covered(name, (top,))]
        return max(found)[1] if found else ""

    def _made_from(self, stage: stages.Stage) -> dict[str, str | None]:
        return {need: self.receipts.read(need).get("made") for need in stage.needs}

    def _other(self, stage: stages.Stage, key: str) -> bool:
        receipt = self.receipts.read(stage.name)
        return receipt.get("key", receipt.get("began")) != key or receipt.get("from") != self._made_from(stage)


def _tops(stage: stages.Stage) -> tuple[str, ...]:
    return (*stage.makes, *stage.scratch)


def _within(names: Iterable[str], claimed: set[str]) -> list[str]:
    return [n for n in names if n in claimed or not claimed.isdisjoint(map(str, PurePosixPath(n).parents))]
