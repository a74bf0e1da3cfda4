"""Folders of the states of unfinished searches: find one, or open one for a search."""

import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from placement_env.search.checkpoint import STATE_SUFFIX, Checkpoint
from toolkit.runtime.cache import code_digest, make_key
from toolkit.runtime.resumable import ShardFolder
from toolkit.runtime.text_values import replace_infinite

NOWHERE = Checkpoint(None)  # keeps nothing


def find_unfinished(folder: Path, question: Mapping[str, object]) -> ShardFolder:
    """Folder of an unfinished search, with its question as JSON values.

    The folder need not exist. The question takes a round through JSON, so that it equals what the
    folder holds: tuples become lists, for example."""
    return ShardFolder(folder, json.loads(json.dumps(replace_infinite(dict(question)))))


@contextmanager
def open_checkpoint(
    folder: Path, question: Mapping[str, object], *, code: str = __name__, overwrite: bool = False
) -> Iterator[Checkpoint]:
    """Yield the checkpoint of a search in a separate folder, removed when the block ends normally.

    Args:
        folder: Folder of the states, made if missing.
        question: Everything that the answer depends on.
        code: Name of the module of the search, whose changed source makes old states void.
        overwrite: Whether an unfinished search with another question may be overwritten.

    Raises FileExistsError if the folder holds an unfinished search with another question and may
    not be overwritten, or if another process is working in it.
    """
    unfinished = find_unfinished(folder, question)
    with unfinished.lock():
        unfinished.open(overwrite)
        yield Checkpoint(folder, depends_on=make_key(unfinished.plan, code_digest(code)))
        # not reached if the block raises an error: then the search can resume
        for path in folder.glob(f"*{STATE_SUFFIX}"):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        unfinished.remove()
