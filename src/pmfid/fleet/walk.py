"""All that lies in the folders of a data set, through links, too, each folder once."""

from __future__ import annotations

import os
from pathlib import Path

#: What a history writes into its folder, at least.
RESULTS = {"work", "periods.parquet", "axes.parquet", "problems.parquet"}


def walk_folder(folder: Path) -> tuple[list[Path], list[Path], list[Path]]:
    """Folders; all else in them, pipes and broken links included; and folders that cannot be listed. The results of a
    history are left out.
    A folder to which several links lead counts once, by the shortest of its names, then the first."""
    folders, others, closed, seen = list[Path](), list[Path](), list[Path](), set[str]()
    waiting = [folder]
    while waiting:
        deeper = list[Path]()
        for one in waiting:
            if (real := os.path.realpath(one)) in seen:
                continue
            seen.add(real)
            try:
                inside = sorted(one.iterdir())
            except OSError:
                closed.append(one)
                continue
            if {path.name for path in inside} >= RESULTS:  # of another history
                continue
            folders.append(one)
            below = [path for path in inside if path.is_dir()]
            deeper += below
            others += [path for path in inside if path not in set(below)]
        waiting = deeper
    return folders, others, closed
