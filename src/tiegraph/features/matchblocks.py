"""Matching and geometric verification of exactly the listed pairs, by blocks of pairs that are matched side by side:
each process has one thread and, for each block, a small database of its own.

The processes are children of this one, or of the workers of a cluster: those read the features while nobody writes,
because a round of blocks is matched before the next is written, and only this process writes the matches of all.

Nearest neighbours or a plug-in (``matchers``) find the matches and COLMAP verifies them; on a GPU, and for guided
matching, COLMAP does both. COLMAP's own threads do not always find the same matches: those that build their search
trees of descriptors at the same moment disturb each other now and then (`benchmarks/sfm/matching_threads.py` counts how
often).
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from tiegraph.child import run_in_child, run_in_children
from tiegraph.errors import ChildDied, InputError, ReconstructionError
from tiegraph.features.matchers import MATCHERS, Features, device, matcher, on_gpu
from tiegraph.features.settings import MatchSettings
from tiegraph.features.tuning import VerificationTuning
from tiegraph.scene.atomic import remove
from tiegraph.scene.colmapdatabase import (
    Rows,
    copy_features,
    feature_counts,
    keep_finished,
    match_counts,
    strike,
    take_matches,
    write_anew,
)
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene

_SEED = 0  # of RANSAC: the same matches give the same inliers
_ALIAS = "tiegraph:"


@dataclass(frozen=True)
class Rules:
    """Rules for matches, and for their verification."""

    settings: MatchSettings = MatchSettings()
    verification: VerificationTuning = VerificationTuning()


@dataclass(frozen=True)
class Side:
    """How many processes match side by side; ``run_map``: map over the workers of a cluster, each of which has one
    (function, items, further arguments: a result an item), None = all on this machine."""

    processes: int = 1
    run_map: Callable[..., list[Any]] | None = None


def cut(pairs: Pairs, size: int) -> list[np.ndarray]:
    """Blocks (B, 2) of scene indices, of ``size`` pairs."""
    index = np.stack([pairs.i, pairs.j], axis=1)
    return np.split(index, np.arange(size, len(index), size)) if len(index) else []


def run_blocks(
    database: Path, blocks: Sequence[np.ndarray], rules: Rules, side: Side, log: Path, on_pairs: Callable[[int], None]
) -> None:
    """Match blocks (B, 2) of scene indices, side by side, and write the results of each into the database.

    ``on_pairs`` gets the number of finished pairs. If a process ends by itself, its unfinished part is tried once
    more, block by block, and omitted if that ends too. Finished blocks stay.
    """
    if not blocks:
        return
    scratch = database.with_name(database.name + ".match")
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir()
    done, left = 0, {str(scratch / f"{k}.db"): block for k, block in enumerate(blocks)}

    def take(message: tuple[str, int]) -> None:
        nonlocal done
        del left[message[0]]
        take_matches(database, Path(message[0]))
        clear(message[0])
        done += message[1]
        on_pairs(done)

    def clear(name: str) -> None:
        for path in scratch.glob(f"{Path(name).stem}.*"):
            path.unlink()

    named = list(left.items())
    try:
        if side.run_map is None:
            count = min(side.processes, len(blocks))
            calls = [(str(database), named[k::count], rules) for k in range(count)]
            run_in_children(match_blocks, calls, log=log, on_message=take, task="match")
        else:
            step = 2 * side.processes  # blocks per worker of a cluster before they are written
            for start in range(0, len(named), step):
                for message in side.run_map(match_block, named[start : start + step], str(database), rules, log):
                    take(message)
    except ChildDied:
        for block in list(left.items()):
            clear(block[0])
            with suppress(ChildDied):
                take(match_block(block, str(database), rules, log))
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def match_block(block: tuple[str, np.ndarray], database: str, rules: Rules, log: Path) -> tuple[str, int]:
    """``match_blocks`` of one block in a child of this process; its name and number of pairs."""
    run_in_child(match_blocks, database, [block], rules, log=log, task="match")
    return block[0], len(block[1])


def match_blocks(
    database: str, blocks: Sequence[tuple[str, np.ndarray]], rules: Rules, send: Callable[[tuple[str, int]], None]
) -> None:
    """Match blocks, each into the database named beside it, and send its name and number of pairs. Runs in a child."""
    pycolmap.logging.minloglevel = 1
    matched = _by_colmap if colmap_matches(rules.settings) else _by_matcher
    for name, block in blocks:
        matched(Path(database), Path(name), block, rules)
        send((name, len(block)))


def colmap_matches(settings: MatchSettings) -> bool:
    """Whether COLMAP finds the matches too, on a GPU and along epipolar lines; else it verifies them."""
    return settings.guided or (settings.engine in MATCHERS and on_gpu())


def _by_colmap(database: Path, target: Path, block: np.ndarray, rules: Rules) -> None:
    """Match and verify a block (B, 2) by COLMAP's matcher, in a database that has the features of its images."""
    matching, verification = colmap_options(rules)
    pair_list = target.with_suffix(".txt")
    pair_list.write_text("".join(f"{_alias(a)} {_alias(b)}\n" for a, b in block), encoding="utf-8")
    copy_features(database, target, np.unique(block), _ALIAS)
    pycolmap.match_image_pairs(
        target,
        matching_options=matching,
        pairing_options=pycolmap.ImportedPairingOptions(match_list_path=pair_list, block_size=len(block)),
        verification_options=verification,
        device=device(),
    )


def _by_matcher(database: Path, target: Path, block: np.ndarray, rules: Rules) -> None:
    """Match a block (B, 2) by the chosen matcher and verify it by COLMAP, pair by pair, into a new database.

    Rows are as COLMAP writes them: a pair of too few matches has none, and is degenerate.
    """
    _, verification = colmap_options(rules)
    match = matcher(rules.settings)
    remove(target)
    with Rows(database) as rows, pycolmap.Database.open(target) as found:
        cameras, names = rows.cameras(), rows.image_names()
        features = {
            k: Features(
                rows.keypoints_of(k, 4).astype(np.float32),
                rows.descriptors_of(k),
                (cameras[k].width, cameras[k].height),
            )
            for k in (np.unique(block) + 1).tolist()
        }
        points = {k: f.keypoints[:, :2].astype(float) for k, f in features.items()}
        for a, b in (block + 1).tolist():
            pairs = match(features[a], features[b], names[a], names[b])
            geometry = pycolmap.TwoViewGeometry()
            if len(pairs) < rules.settings.min_inliers:
                pairs, geometry.config = pairs[:0], int(pycolmap.TwoViewGeometryConfiguration.DEGENERATE)
            else:
                geometry = pycolmap.estimate_two_view_geometry(
                    cameras[a], points[a], cameras[b], points[b], pairs, verification
                )
            found.write_matches(a, b, pairs)
            found.write_two_view_geometry(a, b, geometry)


def colmap_options(rules: Rules) -> tuple[pycolmap.FeatureMatchingOptions, pycolmap.TwoViewGeometryOptions]:
    """COLMAP's options for our rules."""
    settings, tuning = rules.settings, rules.verification
    matching = pycolmap.FeatureMatchingOptions(num_threads=1, use_gpu=on_gpu())
    matching.guided_matching = settings.guided
    matching.skip_image_pairs_in_same_frame = False  # all listed pairs are matched: the network decides
    matching.sift.max_ratio = settings.max_ratio
    verification = pycolmap.TwoViewGeometryOptions(min_num_inliers=settings.min_inliers)
    verification.ransac.max_error = settings.max_error_px
    verification.ransac.random_seed = _SEED
    verification.ransac.min_num_trials = tuning.min_trials
    verification.ransac.min_inlier_ratio = tuning.least_inlier_share
    verification.filter_stationary_matches = settings.stationary
    return matching, verification


def _alias(index: int) -> str:
    """A name without a space, as COLMAP's pair list needs it, of an image of a block's database."""
    return f"{_ALIAS}{index + 1}"


BLOCK_PAIRS = 256  # largest loss of a process in a killed run, and the step of the progress
# Most matches lie in the image border and move alike: a caption or a part of the platform. COLMAP's mappers would
# still use the pair.
_WATERMARK = int(pycolmap.TwoViewGeometryConfiguration.WATERMARK)
_ALONE = Side()

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class MatchReport:
    """Request and result of the matcher."""

    asked: int
    matched: int  # pairs compared, now or in an earlier run
    verified: int
    lost: tuple[tuple[str, str], ...]  # ("image1 image2", reason) of the asked pairs that were not compared
    configurations: dict[str, int]  # matched pairs by COLMAP's kind of two-view geometry
    matches: int  # feature matches before verification, over all pairs
    inliers: int  # verified matches, over all pairs


def match_pairs(
    database: Path,
    scene: Scene,
    pairs: Pairs,
    rules: Rules,
    log: Path,
    on_progress: Progress = lambda done, total: None,
    side: Side = _ALONE,
) -> tuple[Pairs, MatchReport]:
    """Match and verify the kept pairs. Pairs finished in the database are not done again, others in it are deleted.

    Returns the table with ``inliers`` of the kept pairs (0 = compared and not verified, -1 = could not be compared;
    both are dropped for "match") and the report. ``on_progress`` gets the numbers of finished and of all pairs. Raises
    InputError for a database of another scene, ReconstructionError if no pair at all is verified.
    """
    with Rows(database) as rows:
        names = rows.image_names()
    if names != dict(enumerate(scene.names, 1)):
        raise InputError(f"{database} contains other images than the scene: delete it and run the features stage again")
    kept = pairs.kept()
    features = feature_counts(database)
    some = np.array([features.get(k, 0) > 0 for k in range(len(scene))], bool)
    comparable = some[kept.i] & some[kept.j]
    finished = keep_finished(database, kept) & comparable
    todo = kept.where(comparable & ~finished)
    before, total = int(finished.sum()), int(comparable.sum())
    on_progress(before, total)
    blocks = cut(todo, max(1, min(BLOCK_PAIRS, -(-len(todo) // side.processes))))  # one at least for each process
    run_blocks(database, blocks, rules, side, log, lambda more: on_progress(before + more, total))
    strike(database, _WATERMARK)
    write_anew(database)
    matches, inliers, config = match_counts(database, kept)
    report = _report(scene, kept, matches, inliers, config, features)
    _check_verified(report, rules.settings)
    of_all, asked = pairs.inliers.copy(), pairs.dropped == 0
    of_all[asked] = inliers
    return pairs.with_(inliers=of_all).drop(asked & (of_all <= 0), "match"), report


def _report(
    scene: Scene, kept: Pairs, matches: np.ndarray, inliers: np.ndarray, config: np.ndarray, features: dict[int, int]
) -> MatchReport:
    """``matches``, ``inliers``, ``config`` (K,) of the kept pairs as of ``match_counts``."""
    matched = inliers >= 0
    lost = []
    for k in np.flatnonzero(~matched):
        empty = [scene.names[m] for m in (kept.i[k], kept.j[k]) if features.get(int(m), 0) == 0]
        reason = f"no features in {' and '.join(empty)}" if empty else "COLMAP gave no result: see the log"
        lost.append((f"{scene.names[kept.i[k]]} {scene.names[kept.j[k]]}", reason))
    kinds = pycolmap.TwoViewGeometryConfiguration.__members__
    codes = {int(value): name.lower() for name, value in kinds.items()}
    found, number = np.unique(config[matched], return_counts=True)
    return MatchReport(
        asked=len(kept),
        matched=int(matched.sum()),
        verified=int((inliers > 0).sum()),
        lost=tuple(lost),
        configurations={codes.get(int(c), str(c)): int(n) for c, n in zip(found, number)},
        matches=int(matches[matched].clip(0).sum()),
        inliers=int(inliers[matched].sum()),
    )


def _check_verified(report: MatchReport, settings: MatchSettings) -> None:
    if report.verified:
        return
    if report.asked == 0:
        raise ReconstructionError(
            "no pair verified: the pair list is empty. Loosen the network or design settings, or give a pair file"
        )
    why = f"; {report.lost[0][0]}: {report.lost[0][1]}" if report.lost else ""
    raise ReconstructionError(
        f"no pair verified: {report.asked} asked, {report.matched} compared, {report.matches} feature matches, and no "
        f"pair has {settings.min_inliers} of them that agree on one geometry{why}. Check that the images overlap and "
        "are not masked away, then try a lower match.min_inliers or other pair sources"
    )
